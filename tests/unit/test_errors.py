"""The exception tree."""

import pickle

import pytest

import doughschemas
from doughdata.render._open3d import MissingLibraryError
from doughschemas import DoughError, MissingPackageError, UnknownNameError

ERRORS = [
    UnknownNameError("sensor", "kinetc", ["kinect", "azure"]),
    MissingPackageError("taichi", "sim"),
    MissingLibraryError("libusb is missing"),
    *(
        getattr(doughschemas, name)("what came")
        for name in doughschemas.__all__
        if name.endswith("Error") and name not in ("UnknownNameError", "MissingPackageError")
    ),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_an_error_survives_the_way_out_of_a_worker(error: DoughError) -> None:
    """An error that is pickled in a worker process arrives with its type and message."""
    back = pickle.loads(pickle.dumps(error))
    assert isinstance(back, DoughError)
    assert (type(back), str(back)) == (type(error), str(error))
