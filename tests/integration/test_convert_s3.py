"""Recordings converted into a bucket, against a real S3 server."""

import numpy as np
import pytest

from doughdata.dataset import open_dataset, validate
from doughdata.dataset.store import store_of
from doughdata.recordings.errors import RecordingError
from doughdata.recordings.mcap import Mcap
from doughdata.recordings.options import ProcessingConfig
from doughschemas import DatasetError
from tests.object_store import BUCKET, environment, object_store, set_environment
from tests.recordings_made import Recording, rolls_picture, write_mcap


def test_a_recording_into_a_bucket(tmp_path):
    """A bucket gets what a disk gets; the same again and another one do what they do on a disk.

    A refusal leaves nothing there, and a place with something else is not touched.
    """
    first = write_mcap(tmp_path / "a.mcap")
    other = write_mcap(tmp_path / "b.mcap", Recording(pictures=[rolls_picture(gap=0.02)]))
    bad = write_mcap(tmp_path / "c.mcap", Recording(info=False))
    one = write_mcap(tmp_path / "e.mcap", Recording(pictures=[rolls_picture(count=1)]))
    rolls = ProcessingConfig(expect="rolls")
    with object_store() as endpoint, set_environment(**environment(endpoint)):
        there, empty = f"s3://{BUCKET}/real", f"s3://{BUCKET}/none"
        assert Mcap().convert(first, there, processing=rolls).scenes == (0,)
        assert Mcap().convert(first, there, processing=rolls).scenes == (0,)
        assert Mcap().convert(other, there, processing=rolls).scenes == (1,)
        for path in (bad, one):
            with pytest.raises(RecordingError):
                Mcap().convert(path, empty, processing=rolls)
        store_of(f"s3://{BUCKET}/mine").create("thesis.txt", b"mine")
        with pytest.raises(DatasetError, match=r"thesis\.txt"):
            Mcap().convert(first, f"s3://{BUCKET}/mine", processing=rolls)
        assert store_of(empty).names("") == []
        assert validate(there, deep=True).problems == ()
        far = open_dataset(there)
        Mcap().convert(first, str(tmp_path / "d"), processing=rolls)
        near = open_dataset(tmp_path / "d")
        assert far.scene_indices == [0, 1]
        for frame in range(3):
            a, b = (dataset.frame(scene=0, frame=frame) for dataset in (far, near))
            assert np.array_equal(a.color(), b.color())
            for name in ("depth", "segments"):
                x, y = (getattr(f.depth("recorded"), name) for f in (a, b))
                assert np.array_equal(x, y)
