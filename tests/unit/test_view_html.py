"""The page as a file: its texts are data, its policy holds, its data are the dataset's."""

import json
import re
from base64 import b64encode
from dataclasses import replace
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from doughdata.dataset import open_dataset
from doughdata.view.html import page_text, save_page
from doughdata.view.scene_data import SceneData, load_scene
from doughschemas import BadInputError
from tests.closed_form import cut_ring
from tests.dataset_helpers import new_writer, write_examples
from tests.unit.test_view_packing import unpacked

HOSTILE = "</script><script>alert(1)</script>{{script}}<img src=x onerror=alert(2)>&amp;\u2028"


class Elements(HTMLParser):
    """Start tags with attributes, and the text inside the elements that have text alone."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.texts: dict[str, str] = {}
        self._inside = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list) -> None:
        """Note the element."""
        self.tags.append((tag, dict(attrs)))
        self._inside = dict(attrs).get("id") or tag

    def handle_data(self, data: str) -> None:
        """Add to the text of the element around."""
        self.texts[self._inside] = self.texts.get(self._inside, "") + data

    def handle_endtag(self, tag: str) -> None:  # noqa: ARG002  (the parser's own signature)
        """What follows is outside."""
        self._inside = ""


@pytest.fixture
def data(tmp_path: Path) -> SceneData:
    """The closed-form ring that is cut, with all layers."""
    write_examples(new_writer(tmp_path / "d"))
    return load_scene(open_dataset(tmp_path / "d"), 0)


def test_the_data_of_the_page_are_those_of_the_dataset(data: SceneData) -> None:
    """Positions come back within 5 um, labels, faces, graph, depth and tools exactly."""
    elements, example = Elements(page_text(data)), cut_ring()
    header = json.loads(elements.texts["header-data"])
    arrays = unpacked(header["arrays"], elements.texts["packed-data"])
    low, step = np.array(header["box"]["low"]), header["box"]["step"]
    assert step <= 10e-6
    shape = example.particles.positions.shape
    positions = low + step * arrays["positions"].reshape(shape).astype(float)
    assert np.abs(positions - example.particles.positions).max() <= step / 2 + 1e-9
    frames = example.topology.frames
    assert np.array_equal(arrays["labels"], [frame.labels for frame in frames])
    assert header["genus"] == [list(frame.genus) for frame in frames]
    meshes = [mesh for frame in example.meshes for mesh in frame.meshes]
    assert np.array_equal(arrays["mesh_faces"], np.concatenate([mesh.faces for mesh in meshes]))
    assert [tuple(n) for frame in header["meshes"] for n in frame] == [
        (len(mesh.vertices), len(mesh.faces)) for mesh in meshes
    ]
    edges = np.concatenate([frame.graph.edges for frame in frames])
    assert np.array_equal(arrays["graph_edges"], edges)
    assert [event["kind"] for event in header["events"]] == ["self_split", "split"]
    windows = header["depth"]["windows"]
    assert sum(w["width"] * w["height"] for w in windows) == len(arrays["depth"])
    assert np.isin(arrays["depth"], example.depth.depth).all()


def test_texts_of_a_dataset_are_never_markup(data: SceneData) -> None:
    """A name full of markup adds no element, reaches title and data as it is, and hides nothing."""
    plain = Elements(page_text(data))
    scene = replace(data.scene, scene_id=HOSTILE, family=HOSTILE)
    assert data.topology is not None
    frames = tuple(replace(f, ambiguous_reason=HOSTILE) for f in data.topology.frames)
    topology = replace(data.topology, frames=frames)
    page = page_text(
        replace(data, scene=scene, topology=topology, missing={"mesh": HOSTILE}, sensor=HOSTILE)
    )
    hostile = Elements(page)
    assert [tag for tag, _ in hostile.tags] == [tag for tag, _ in plain.tags]
    header = json.loads(hostile.texts["header-data"])
    assert header["scene"]["id"] == header["ambiguous"][0] == header["missing"]["mesh"] == HOSTILE
    assert HOSTILE in hostile.texts["title"]
    assert hostile.texts["packed-data"] == plain.texts["packed-data"]


def test_the_policy_admits_the_page_alone(data: SceneData) -> None:
    """Script and style have the hashes that the policy names; no address outside is in the page."""
    page = page_text(data)
    elements = Elements(page)
    policy = next(a["content"] for _, a in elements.tags if a.get("http-equiv"))
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    for name in ("script", "style"):
        inner = re.findall(rf"<{name}>(.*?)</{name}>", page, re.DOTALL)
        assert len(inner) == 1
        digest = b64encode(sha256(inner[0].encode()).digest()).decode()
        assert rules[f"{name}-src"] == f"'sha256-{digest}'"
    links = [a for _, a in elements.tags if "src" in a or "href" in a]
    assert [a["href"] for a in links] == ["data:,"]
    assert not re.search(
        r"https?://|@import|url\(", page.replace(elements.texts["packed-data"], "")
    )


def test_equal_scenes_give_equal_pages(data: SceneData) -> None:
    """The same scene is the same file: nothing of the day or the machine is in it."""
    assert page_text(data) == page_text(data)


def test_an_infinite_margin_is_left_out(data: SceneData) -> None:
    """JSON has no infinity, so that an event without a finite margin has none on the page."""
    assert data.topology is not None
    events = (replace(data.topology.events[0], margin=float("inf")),)
    page = page_text(replace(data, topology=replace(data.topology, events=events)))
    header = json.loads(Elements(page).texts["header-data"])
    assert [event["margin"] for event in header["events"]] == [None]


def test_wrong_targets_are_refused(tmp_path: Path) -> None:
    """Another ending, or a folder where the file should go, is told; nothing is written."""
    write_examples(new_writer(tmp_path / "d"), layers=("sim",))
    dataset = open_dataset(tmp_path / "d")
    with pytest.raises(BadInputError, match=r"saved as \.html"):
        save_page(dataset, tmp_path / "scene.htm")
    (tmp_path / "taken.html").mkdir()
    with pytest.raises(BadInputError, match="cannot write"):
        save_page(dataset, tmp_path / "taken.html")
    assert save_page(dataset, tmp_path / "ok.html").stat().st_size > 0
