"""Croissant metadata, judged by MLCommons' own library."""

import json
from hashlib import sha256
from pathlib import Path

import mlcroissant
import pytest

from doughdata.dataset import open_dataset
from doughdata.dataset.split import SplitPlan, resplit
from doughdata.dataset.tables import TABLES
from tests.dataset_helpers import new_writer, write_examples

# mlcroissant calls what rdflib and pandas have deprecated.
pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning:rdflib"),
    pytest.mark.filterwarnings("ignore:The inplace keyword"),
]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both examples, one in `train`, one in `test`."""
    folder = tmp_path_factory.mktemp("croissant")
    write_examples(new_writer(folder / "one", scenes_per_shard=2))
    resplit(folder / "one", folder / "d", SplitPlan(test=0.5))
    return folder / "d"


def plain(value):
    """Values as Python has them: Croissant gives text as bytes, missing numbers as NaN."""
    if isinstance(value, bytes):
        return value.decode()
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    return value


def test_the_validator_accepts_it(dataset: Path) -> None:
    """No error; what is recommended and missing is only what a dataset cannot know of itself."""
    issues = mlcroissant.Dataset(str(dataset / "croissant.json")).metadata.issues
    assert not issues.errors
    assert all("citeAs" in w or "datePublished" in w for w in issues.warnings)


def test_records_are_the_rows_of_the_tables(dataset: Path) -> None:
    """A record set gives every row of its table with equal values."""
    croissant, opened = mlcroissant.Dataset(str(dataset / "croissant.json")), open_dataset(dataset)
    for name in ("scenes", "frames", "tool_poses", "graph_edges", "views"):
        records = list(croissant.records(name))
        rows = opened.table(name).to_pylist()
        assert len(records) == len(rows)
        for record, row in zip(records, rows, strict=True):
            assert {key: plain(record[f"{name}/{key}"]) for key in row} == row


def test_files_are_named_with_their_hashes(dataset: Path) -> None:
    """Each Parquet file stands there with the sha256 that it has, each layer with its arrays."""
    document = json.loads((dataset / "croissant.json").read_text())
    files = {f["@id"]: f for f in document["distribution"]}
    for name in TABLES:
        file = files[f"{name}.parquet"]
        assert file["sha256"] == sha256((dataset / file["contentUrl"]).read_bytes()).hexdigest()
    for layer in open_dataset(dataset).layers:
        assert list(dataset.glob(files[f"{layer}-arrays"]["includes"]))


def test_splits_are_croissant_splits(dataset: Path) -> None:
    """The splits are records of type cr:Split that name the standard ones."""
    records = list(mlcroissant.Dataset(str(dataset / "croissant.json")).records("splits"))
    found = {plain(r["splits/name"]): plain(r["splits/url"]) for r in records}
    assert found == {"train": "cr:TrainingSplit", "test": "cr:TestSplit"}
