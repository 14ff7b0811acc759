"""Versions and JSON schemas of the format."""

import json
import warnings

import jsonschema
import pytest

from doughdata import registry
from doughdata.dataset import open_dataset
from doughdata.dataset.documents import dump_document, load_document
from doughdata.scenes import scene_to_json
from doughschemas import (
    SCHEMA_VERSION,
    DamagedDatasetError,
    MissingLayerError,
    UnknownNameError,
    VersionError,
)
from doughschemas.json_schemas import JSON_SCHEMAS, read_json_schema
from doughschemas.migrate import check_version, migration_path
from tests.dataset_helpers import LAYERS, new_writer, write_examples


def test_own_version_is_read_without_a_word():
    """The current version needs no migration and warns of nothing."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert check_version(SCHEMA_VERSION, what="here")
    assert migration_path(SCHEMA_VERSION) == []


def test_newer_major_is_refused_by_name():
    """The message names the dataset, both versions and what to do."""
    with pytest.raises(VersionError, match=r"here has schema version 2\.0.*1\.x.*upgrade"):
        check_version("2.0", what="here")
    with pytest.raises(VersionError, match="must be like"):
        check_version("one", what="here")
    with pytest.raises(VersionError, match=r"no migration from schema version 0\.9"):
        migration_path("0.9")


def test_newer_minor_warns():
    """A newer minor version is read, with a warning."""
    with pytest.warns(UserWarning, match=r"1\.99, newer than"):
        assert check_version("1.99", what="here")


def test_version_of_a_dataset_is_checked_when_it_is_opened(tmp_path):
    """Opening a dataset of a newer major version fails; of a newer minor version it warns."""
    uri = write_examples(new_writer(tmp_path / "d"), layers=LAYERS[:1]).uri
    path = tmp_path / "d/meta/info.json"
    info = json.loads(path.read_text())
    path.write_bytes(dump_document({**info, "schema_version": "2.0"}))
    with pytest.raises(VersionError, match=r"2\.0"):
        open_dataset(uri)
    path.write_bytes(dump_document({**info, "schema_version": "1.7", "news": 1}))
    with pytest.warns(UserWarning, match=r"1\.7"):
        dataset = open_dataset(uri)
    assert dataset.read_particles(0).positions.shape[0] == 3
    with pytest.raises(MissingLayerError, match="--stages topology"):
        dataset.read_topology(0)


def test_json_schemas_are_valid_and_strict():
    """Every schema is one of draft 2020-12, and refuses an empty document."""
    for name in JSON_SCHEMAS:
        schema = read_json_schema(name)
        jsonschema.Draft202012Validator.check_schema(schema)
        assert not jsonschema.Draft202012Validator(schema).is_valid({})
    with pytest.raises(UnknownNameError, match="commit"):
        read_json_schema("comit")


@pytest.mark.parametrize("family", ["rolls", "doughnut"])
def test_sampled_scenes_fit_the_scene_schema(family):
    """What `doughdata scenes show` prints is valid; a misspelt field is not."""
    validator = jsonschema.Draft202012Validator(read_json_schema("scene"))
    for number in range(5):
        scene = registry.load("scenes", family)().sample(seed=3, number=number, split="test")
        data = json.loads(json.dumps(scene_to_json(scene)))
        validator.validate(data)
        assert not validator.is_valid({**data, "bodys": []})


def test_documents_refuse_any_change():
    """A document with one changed value, or cut short, does not load."""
    data = dump_document({"a": 1, "b": ["x", None]})
    assert load_document(data, name="d") == json.loads(data)
    for damaged in (data.replace(b'"x"', b'"y"'), data[:-9], b"[]", b"\xff"):
        with pytest.raises(DamagedDatasetError, match=r"^d: "):
            load_document(damaged, name="d")
