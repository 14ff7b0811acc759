"""The card: Hugging Face reads it, its measured parts are fresh, and a user's text stays."""

from pathlib import Path

import pytest
import yaml

from doughdata.dataset import open_dataset, validate
from doughdata.dataset.store import LocalStore
from doughdata.dataset.tables import TABLES, refresh_tables
from tests.dataset_helpers import STAGES, new_writer, write_examples


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Both examples with all layers."""
    write_examples(new_writer(tmp_path / "d"))
    return tmp_path / "d"


def front_matter(dataset: Path) -> dict:
    """The YAML of a card."""
    return yaml.safe_load((dataset / "README.md").read_text().split("---\n")[1])


def test_every_table_opens_by_its_configuration(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`datasets.load_dataset(folder, table)` gives each table with its columns and values, with
    no network."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "cache"))
    import datasets

    datasets.disable_progress_bars()
    opened = open_dataset(dataset)
    for name in TABLES:
        loaded = datasets.load_dataset(str(dataset), name, cache_dir=str(tmp_path / "cache"))
        (rows,) = loaded.values()
        assert rows.to_list() == opened.table(name).to_pylist()


def test_the_card_is_valid_metadata(dataset: Path) -> None:
    """Hugging Face's own reader takes the card; licence, size and configurations are there."""
    from huggingface_hub import DatasetCard

    data = DatasetCard.load(dataset / "README.md", ignore_metadata_errors=False).data.to_dict()
    assert data["license"] == "unknown"
    assert data["size_categories"] == ["n<1K"]
    assert [config["config_name"] for config in data["configs"]] == list(TABLES)
    refresh_tables(LocalStore(dataset), license_name="cc-by-4.0")
    refresh_tables(LocalStore(dataset))
    assert front_matter(dataset)["license"] == "cc-by-4.0"
    assert '"license": "cc-by-4.0"' in (dataset / "croissant.json").read_text()


def test_measured_parts_follow_the_data(dataset: Path) -> None:
    """After more scenes were written, the card tells the new counts and fingerprint."""
    writer = new_writer(dataset)
    writer.plan_family("rolls", split="test", seed=0, count=2)
    for task in writer.tasks("sim"):
        writer.write(task, {}, stage=STAGES["sim"], failed=dict.fromkeys(task.scenes, "exploded"))
    writer.refresh()
    text = (dataset / "README.md").read_text()
    assert "| failures | 2 |" in text
    assert open_dataset(dataset).fingerprint in text
    assert validate(dataset, deep=True).problems == ()


def test_a_users_text_stays(dataset: Path) -> None:
    """What stands outside the marks is kept by every refresh and is no problem; a card without
    marks is not touched at all."""
    card = dataset / "README.md"
    mine = card.read_text().replace("---\n", "---\nlanguage: en\n", 1) + "\nMade in our kitchen.\n"
    card.write_text(mine)
    assert validate(dataset).problems == ()
    refresh_tables(LocalStore(dataset))
    assert card.read_text() == mine
    assert front_matter(dataset)["language"] == "en"
    card.write_text("My own card.\n")
    refresh_tables(LocalStore(dataset))
    assert card.read_text() == "My own card.\n"
    assert validate(dataset).problems == ()


@pytest.mark.parametrize("name", ["README.md", "croissant.json", "meta/stats.json"])
def test_damage_is_found(name: str, dataset: Path) -> None:
    """A flipped bit in what describes the dataset is a problem with the file's name; so is a file
    that is missing; the next refresh mends both."""
    data = (dataset / name).read_bytes()
    place = data.index(b"mean" if name.endswith("stats.json") else b"dough", 200)
    (dataset / name).write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
    assert [problem.file for problem in validate(dataset).problems] == [name]
    (dataset / name).unlink()
    assert [problem.file for problem in validate(dataset).problems] == [name]
    refresh_tables(LocalStore(dataset))
    assert validate(dataset).problems == ()
    assert (dataset / name).read_bytes() == data
