"""The saved page and the server, in a real browser without network."""

import io
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, sync_playwright

from doughdata.dataset import open_dataset
from doughdata.view.html import page_text, save_page
from doughdata.view.panels import COLOURS
from doughdata.view.projection import View
from doughdata.view.scene_data import load_scene
from doughdata.view.serve import DatasetServer
from tests.closed_form import cut_ring
from tests.dataset_helpers import new_writer, write_examples
from tests.integration.conftest import FRAMES, command

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
FLAGS += ["--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run", "--disable-sync"]
FLAGS += ["--disable-background-networking", "--disable-component-update"]
BORDER = 4  # [px], where the frame of the focus is drawn
PATIENCE = 120_000  # [ms]; software rendering starves where other work holds the cores
LAYERS = ("particles", "mesh", "tools", "depth", "graph")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium with a software renderer; `scripts/browser.sh` installs it."""
    path = next(filter(None, map(shutil.which, NAMES)), None)
    assert path, "no Chromium: run `bash scripts/browser.sh`"
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=path, headless=True, args=FLAGS)
        yield chromium
        chromium.close()


class Opened:
    """A page with everything it says and asks for."""

    def __init__(self, browser: Browser, url: str, *, offline: bool, **context: Any) -> None:
        size = {"width": 900, "height": 700}
        self.context = browser.new_context(viewport=size, offline=offline, **context)
        self.page = self.context.new_page()
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda m: m.type == "error" and self.errors.append(m.text))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(url)

    def picture(self) -> np.ndarray:
        """The canvas as it is shown without its border, (rows, columns, 3), 0..255."""
        from PIL import Image

        self.page.wait_for_timeout(150)  # two pictures of the browser
        png = self.page.locator("canvas").first.screenshot(timeout=PATIENCE)
        whole = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
        return whole[BORDER:-BORDER, BORDER:-BORDER]

    def go(self, frame: int) -> None:
        """Move the slider as a user does, then wait for the page to say so."""
        self.page.locator("#frame").fill(str(frame))
        self.page.wait_for_selector(f"html[data-frame='{frame}']")

    def layers(self, *wanted: str) -> None:
        """Show these layers and no others."""
        for layer in LAYERS:
            box = self.page.locator(f"#show-{layer}")
            if box.is_enabled():
                box.set_checked(layer in wanted)


@pytest.fixture
def opened(browser: Browser, tmp_path: Path) -> Iterator[Any]:
    """Opens pages from their text; at the end no page has complained or asked for anything."""
    pages: list[Opened] = []

    def open_page(text: str, **context: Any) -> Opened:
        file = tmp_path / f"page{len(pages)}.html"
        file.write_text(text, encoding="utf-8")
        page = Opened(browser, file.as_uri(), offline=True, **context)
        pages.append(page)
        page.page.wait_for_selector("html[data-ready=yes]")
        return page

    yield open_page
    for page in pages:
        page.context.close()
        assert page.errors == []
        assert len(page.requests) == 1  # the file itself


def example_text(tmp_path: Path, **options: Any) -> str:
    """The page of the closed-form ring."""
    write_examples(new_writer(tmp_path / "d"), **options)
    return page_text(load_scene(open_dataset(tmp_path / "d"), 0))


def test_the_slider_moves_the_scene(opened: Any, tiny_dataset: Path) -> None:
    """Key frames look different, the same key frame looks the same, and the texts follow."""
    data = load_scene(open_dataset(tiny_dataset), 1)
    assert data.topology is not None
    page = opened(page_text(data))
    first = page.picture()
    page.go(FRAMES - 1)
    last = page.picture()
    assert (np.abs(first - last).max(axis=2) > 30).mean() > 0.02
    genus = data.topology.frames[-1].genus
    assert page.page.locator("#now-c").inner_text() == str(len(genus))
    assert page.page.locator("#now-g").inner_text() == ", ".join(map(str, genus))
    page.go(0)
    assert np.array_equal(page.picture(), first)


def test_every_layer_shows_and_hides(opened: Any, tiny_dataset: Path) -> None:
    """Each layer of a full scene adds something to the picture and takes it away again."""
    page = opened(page_text(load_scene(open_dataset(tiny_dataset), 0)))
    page.go(5)
    page.layers()
    empty = page.picture()
    for layer in LAYERS:
        page.layers(layer)
        assert (page.picture() != empty).any(), layer
    page.layers()
    assert np.array_equal(page.picture(), empty)


def test_the_browser_has_the_positions_of_the_dataset(opened: Any, tiny_dataset: Path) -> None:
    """Particles, mesh and depth points unpacked by the page are the dataset's, within 5 um."""
    data = load_scene(open_dataset(tiny_dataset), 2)
    assert data.meshes is not None
    page = opened(page_text(data))
    unpack = "f => { const s = window.doughPage.store; return Array.from(%s) }"
    for frame in (0, FRAMES // 2, FRAMES - 1):
        shown = page.page.evaluate(unpack % "s.metres(s.particleSteps(f))", frame)
        apart = np.array(shown).reshape(-1, 3) - data.particles.positions[frame]
        assert np.abs(apart).max() < 5.1e-6
        shown = page.page.evaluate(unpack % "s.mesh(f).vertices", frame)
        vertices = np.concatenate([mesh.vertices for mesh in data.meshes(frame)])
        assert np.abs(np.array(shown).reshape(-1, 3) - vertices).max() < 5.1e-6


def test_depth_points_lie_on_table_dough_and_tools(opened: Any, tmp_path: Path) -> None:
    """Seen by a noise-free camera, the cubes' points lie on their surfaces or on the table."""
    page = opened(example_text(tmp_path))
    points = page.page.evaluate("() => Array.from(window.doughPage.store.cloud(0).points)")
    heights = np.array(points).reshape(-1, 3)[:, 2]
    assert len(heights) > 50
    top = cut_ring().particles.positions[0, :, 2].max() + cut_ring().particles.spacing / 2
    assert np.minimum(np.abs(heights), np.abs(heights - top)).max() < 2e-3


def test_dough_is_drawn_where_it_lies(opened: Any, tmp_path: Path) -> None:
    """From above, each component's pixels span what a pinhole camera gives for its particles.

    The camera is turned by 0.8 rad, so that no mirror picture would pass.
    """
    page = opened(example_text(tmp_path))
    page.layers("particles")
    page.page.locator("#stage").press("t")
    for _ in range(8):
        page.page.locator("#stage").press("Shift+ArrowLeft")
    page.go(2)
    picture = page.picture()
    eye = page.page.evaluate("() => window.doughPage.stage.camera.eye")
    example, (height, width) = cut_ring(), np.add(picture.shape[:2], 2 * BORDER)
    focal = height / 2 / np.tan(np.radians(14.0))
    labels = example.topology.frames[2].labels
    axes = View(azimuth=-np.pi / 2 - 0.8, elevation=np.pi / 2).axes
    for component in (0, 1):
        points = example.particles.positions[2][labels == component]
        right, up, towards = axes @ (points - eye).T
        depth = -towards
        across = right / depth * focal + width / 2 - BORDER
        down = -up / depth * focal + height / 2 - BORDER
        ball = 0.62 * example.particles.spacing / depth.min() * focal
        rows, columns = np.nonzero(hue_of(picture) == component)
        for pixels, wanted in ((columns, across), (rows, down)):
            assert pixels.min() == pytest.approx(wanted.min() - ball, abs=0.35 * ball + 3)
            assert pixels.max() == pytest.approx(wanted.max() + ball, abs=0.35 * ball + 3)


def hue_of(picture: np.ndarray) -> np.ndarray:
    """The component whose colour a strongly coloured pixel has, -1 elsewhere."""
    bright = picture / np.maximum(picture.max(axis=2, keepdims=True), 1)
    hues = COLOURS / COLOURS.max(axis=1, keepdims=True)
    apart = np.abs(bright[:, :, None] - hues).sum(axis=3)
    return np.where(np.ptp(picture, axis=2) > 60, apart.argmin(axis=2), -1)


def test_events_and_doubts_are_on_the_time_line(opened: Any, tmp_path: Path) -> None:
    """Events tell kind, components and margin and lead to their frame; doubts are hatched."""
    write_examples(new_writer(tmp_path / "d"))
    data = load_scene(open_dataset(tmp_path / "d"), 0)
    assert data.topology is not None
    one, two, three = data.topology.frames
    frames = (one, replace(two, ambiguous_reason="a neck near its threshold"), three)
    page = opened(page_text(replace(data, topology=replace(data.topology, frames=frames))))
    badge, tip = page.page.locator(".event"), page.page.locator("#tip")
    assert badge.count() == 2
    badge.nth(1).hover()
    assert "split: components 0 \u2192 0, 1, margin 0.75" in tip.inner_text()
    badge.nth(1).click()
    page.page.wait_for_selector("html[data-frame='2']")
    page.page.locator(".doubt").hover()
    assert "a neck near its threshold" in tip.inner_text()
    page.go(1)
    assert "a neck near its threshold" in page.page.locator("#now-doubt").inner_text()
    assert page.page.locator(".run").all_inner_texts() == [
        "c 1 \u00b7 g 1", "c 1 \u00b7 g 0", "c 2 \u00b7 g 0, 0",
    ]  # fmt: skip


@pytest.mark.parametrize("layers", [("sim",), ("sim", "topology")])
def test_a_page_says_what_is_missing(layers: tuple[str, ...], opened: Any, tmp_path: Path) -> None:
    """Without later layers the particles are there, and the page names what makes the rest."""
    page = opened(example_text(tmp_path, layers=layers))
    told = page.page.locator("#missing").inner_text()
    for layer in {"topology", "mesh", "depth"} - set(layers):
        assert layer in told
    assert "doughdata generate --stages mesh" in told
    assert page.page.locator("#show-mesh").is_disabled()
    assert page.page.locator("#show-graph").is_disabled() == ("topology" not in layers)
    assert (hue_of(page.picture()) == 0).mean() > 0.01


def test_hostile_names_are_shown_as_text(opened: Any, tmp_path: Path) -> None:
    """Markup in a name is read, not run."""
    write_examples(new_writer(tmp_path / "d"))
    data = load_scene(open_dataset(tmp_path / "d"), 0)
    name = "</script><script>window.broken = 1</script><img src=x onerror='window.broken = 1'>"
    page = opened(page_text(replace(data, scene=replace(data.scene, scene_id=name))))
    assert page.page.locator("#title").inner_text() == name
    assert name in page.page.title()
    assert page.page.evaluate("() => window.broken === undefined")


def test_mouse_and_keys_move_camera_and_time(opened: Any, tmp_path: Path) -> None:
    """Dragging, zooming and keys change the picture, reset brings it back, play goes on."""
    page = opened(example_text(tmp_path))
    stage, start = page.page.locator("#stage"), page.picture()
    box = stage.bounding_box()
    middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.page.mouse.move(*middle)
    page.page.mouse.down()
    page.page.mouse.move(middle[0] + 90, middle[1] - 40)
    page.page.mouse.up()
    turned = page.picture()
    assert (turned != start).any()
    page.page.mouse.wheel(0, -300)
    assert (page.picture() != turned).any()
    stage.press("r")
    assert np.array_equal(page.picture(), start)
    stage.press("End")
    page.page.wait_for_selector("html[data-frame='2']")
    stage.press("ArrowLeft")
    page.page.wait_for_selector("html[data-frame='1']")
    page.page.keyboard.press(" ")
    page.page.wait_for_selector("html:not([data-frame='1'])")


def test_light_and_dark_differ(opened: Any, tmp_path: Path) -> None:
    """The page follows the system's theme, stage included, and its button turns it round."""
    text = example_text(tmp_path)
    light, dark = (opened(text, color_scheme=scheme) for scheme in ("light", "dark"))
    assert light.picture()[0, 0].min() > 200
    assert dark.picture()[0, 0].max() < 60
    dark.page.locator("#theme").click()
    assert np.array_equal(dark.picture(), light.picture())


def test_the_command_saves_a_page(tiny_dataset: Path, tmp_path: Path) -> None:
    """`view --save X.html` prints the path of a page equal to the library's."""
    done = command(
        "view", "--scene", 2, "--save", "ring.html", "--dataset", tiny_dataset, cwd=tmp_path
    )
    saved = tmp_path / "ring.html"
    assert done.stdout.strip() == str(saved)
    other = save_page(open_dataset(tiny_dataset), tmp_path / "other.html", scene=2)
    assert saved.read_bytes() == other.read_bytes()


BAD = {
    "neither": ((), "--save X.html or --serve"),
    "both": (("--serve", "--save", "x.png"), "--save X.html or --serve"),
    "several": (("--scene", 0, "--scene", 1, "--save", "x.html"), "one scene at a time"),
    "no such scene": (("--scene", 9, "--save", "x.html"), "no scene 9"),
    "sensor": (("--sensor", "lidar", "--save", "x.html"), "no depth of sensor 'lidar'"),
    "host": (("--serve", "--host", "192.0.2.1"), "cannot serve on host"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_usage_of_view(what: str, tiny_dataset: Path, tmp_path: Path) -> None:
    """What cannot be shown is told in one line, exit code 2, and nothing is left behind."""
    arguments, message = BAD[what]
    done = command("view", *arguments, "--dataset", tiny_dataset, cwd=tmp_path, code=2)
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_the_served_dataset_moves(browser: Browser, tiny_dataset: Path) -> None:
    """The browser's picture follows scene and key frame, and nothing is asked from outside."""
    server = DatasetServer(open_dataset(tiny_dataset), port=18080)
    threading.Thread(target=server.run, daemon=True).start()
    try:
        page = Opened(browser, server.url, offline=False)
        page.page.get_by_text("0 \u00b7 two-rolls").or_(
            page.page.get_by_label("scene")
        ).first.wait_for()
        page.page.get_by_text("c = 2, g = 0, 0").wait_for()
        page.page.wait_for_timeout(1500)
        first = page.picture()
        server.show(frame=FRAMES - 1)
        page.page.get_by_text("c = 1, g = 0").wait_for()
        page.page.wait_for_timeout(1000)
        assert (np.abs(page.picture() - first).max(axis=2) > 30).mean() > 0.005
        server.show(scene=2)
        page.page.get_by_text("c = 1, g = 1").wait_for()
        page.context.close()
        assert page.errors == []
        local = (server.url, "blob:", "data:", server.url.replace("http", "ws"))
        assert [url for url in page.requests if not url.startswith(local)] == []
    finally:
        server.stop()


def test_serving_ends_cleanly_and_finds_a_port(tiny_dataset: Path) -> None:
    """A taken port gives the next free one, the URL answers, Ctrl-C ends with one line and 0."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        process = subprocess.Popen(
            [Path(sys.executable).with_name("doughdata"), "view", "--serve", "--dataset",
             tiny_dataset, "--port", str(port)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            # A shell starts background jobs with SIGINT ignored; a terminal does not.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )  # fmt: skip
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            found = re.match(r"http://127\.0\.0\.1:(\d+) \(port \d+ was in use\)", line)
            assert found, line
            assert int(found[1]) != port
            with urllib.request.urlopen(found[0].split()[0]) as answer:
                assert b"<html" in answer.read()
            process.send_signal(signal.SIGINT)
            rest, error = process.communicate(timeout=60)
        finally:
            process.kill()
    assert (process.returncode, error) == (0, "")
    assert rest.strip() == "stopped"
