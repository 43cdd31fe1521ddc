"""The viewer in headless Chromium: a picture appears, a click selects, nothing is reported in the console.

With STYLERF_SCREENSHOTS=FOLDER the page is also saved as a PNG, to look at.
"""

import os
import subprocess
import sys
import time
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import pytest
from PIL import Image

from schemas.errors import ArtifactStale, OutOfResources
from stages.configs.view import ViewConfig
from stages.viewing.server import Viewer
from tests.stages import evaluation_fixture as made
from tests.stages import splat_scene
from tests.stages.report.browser import CHROMIUM, Browser
from tests.stages.viewing.room import furnished
from tests.stages.viewing.tab import SOFTWARE_GL, Tab, page_of, until

WIDTH, HEIGHT = 900, 600
SHIFT = 8  # as DevTools counts modifiers
in_browser = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (Debian: apt-get install chromium)")


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    pytest.importorskip("viser")
    work = furnished(tmp_path_factory.mktemp("viewed") / "work")
    made = Viewer(work.root, ViewConfig(port=0, open=False, size=96), 1, "plain")
    yield made
    made.close()


@pytest.fixture(scope="module")
def tab(viewer, tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"), SOFTWARE_GL)
    browser.go(viewer.url, WIDTH, HEIGHT)
    opened = Tab(browser)
    assert until(opened.ready)
    yield opened
    if screenshots := os.environ.get("STYLERF_SCREENSHOTS"):
        Image.fromarray(opened.picture()).save(Path(screenshots, "viewer.png"))
    browser.close()


@in_browser
def test_a_picture_appears_and_moves_with_the_camera(viewer, tab):
    desk = viewer.desk
    page = page_of(desk)
    assert until(lambda: desk.painter.exact(page) is not None)
    exact = desk.painter.exact(page)
    h, w = (side // 3 for side in exact.shape[:2])
    middle = exact[h : 2 * h, w : 2 * w].mean((0, 1))
    assert middle.min() > 50
    assert until(lambda: np.abs(tab.view().mean((0, 1)) - middle).max() < 4), (tab.view().mean((0, 1)), middle)
    before, pose = tab.view(), desk.painter.pose(page)
    box = tab.canvas()
    tab.press(box["x"] + 150, box["y"] + 300, to=(box["x"] + 210, box["y"] + 320))
    assert until(lambda: desk.painter.pose(page) != pose)
    assert until(lambda: desk.painter.exact(page) is not None)
    assert until(lambda: np.abs(tab.view().astype(int) - before).max() > 8)
    assert tab.errors == []


@in_browser
def test_a_click_on_the_page_selects_what_it_shows(viewer, tab):
    tab.choose("Select")
    assert until(lambda: "nothing is selected" in tab.words())
    viewer.page.controls["pointer"].value = "click"
    box = tab.canvas()
    page = page_of(viewer.desk)
    tab.press(box["x"] + box["width"] * 0.4, box["y"] + box["height"] * 0.5)
    assert until(lambda: viewer.desk.selector.cells > 0), tab.words()
    assert until(lambda: f"{viewer.desk.selector.cells} cells selected" in tab.words())
    assert until(lambda: "stylerf select" in tab.words())
    assert until(lambda: viewer.desk.painter.exact(page) is not None)
    tab.choose("Undo")
    assert until(lambda: "nothing is selected" in tab.words())
    assert tab.errors == []


@in_browser
def test_a_drag_with_shift_is_a_stroke_and_one_without_turns_the_camera(viewer, tab):
    desk, history = viewer.desk, viewer.desk.selector.history
    page = page_of(desk)
    box = tab.canvas()
    x, y = box["x"] + box["width"] * 0.35, box["y"] + box["height"] * 0.5
    pose = desk.painter.pose(page)
    for pointer, name in (("click", "at"), ("erase", "avoid")):
        viewer.page.controls["pointer"].value = pointer
        time.sleep(0.5)
        before = len(getattr(history.now, name))
        tab.press(x, y, to=(x + 60, y + 20), modifiers=SHIFT)
        assert until(lambda before=before, name=name: len(getattr(history.now, name)) > before + 1), tab.words()
    seeds = history.now.at
    views = {view.name for view in desk.library.scene.views}
    assert len(seeds) > 2 and {seed.partition(":")[0] for seed in seeds} <= views
    assert desk.painter.pose(page) == pose, "a stroke leaves the camera alone"
    assert "/stroke" not in [handle.name for handle in _drawn(viewer)]
    viewer.page.controls["pointer"].value = "box"
    time.sleep(0.5)
    tab.press(x, y, to=(x + 60, y + 40), modifiers=SHIFT)
    assert until(lambda: history.now.box), tab.words()
    tab.press(x, y, to=(x + 60, y + 20))
    assert until(lambda: desk.painter.pose(page) != pose)
    assert history.now.at == seeds
    viewer.page.controls["pointer"].value = "look"
    desk.selector.clear()
    assert tab.errors == []


@in_browser
def test_exported_splats_are_seen_while_the_camera_moves(viewer, tab):
    desk, work = viewer.desk, viewer.desk.library.work
    ball = splat_scene.ball()
    ball["z"] += 3

    def write(folder):
        splat_scene.write_ply(folder / "splats.ply", ball)

    config = {"kind": "splats", "units": "scene"}
    field = work.get("field", "plain")
    made.commit(work, "export", "plain-splats", "export", {"field": field}, write, config=config)
    page = page_of(desk)
    splats = viewer.page._splats[page]
    viewer.page.show_splats()
    assert until(lambda: splats._node is not None and not splats.shown), "they are hidden while the camera rests"
    seen, begin = [], splats.begin
    splats.begin = lambda: (begin(), seen.append(splats.shown))[0]
    box, pose = tab.canvas(), desk.painter.pose(page)
    for plane, drawn in (("color", True), ("depth", False)):
        desk.display.look(plane=plane)
        assert until(lambda: desk.painter.exact(page) is not None)
        seen.clear()
        tab.press(box["x"] + 150, box["y"] + 300, to=(box["x"] + 190, box["y"] + 310))
        assert until(lambda before=pose: desk.painter.pose(page) != before)
        assert until(lambda: desk.painter.exact(page) is not None and not splats.shown)
        assert any(seen) == drawn, "splats are colors alone"
        pose = desk.painter.pose(page)
    desk.display.look(plane="color")
    viewer.page.show_splats(False)
    seen.clear()
    tab.press(box["x"] + 150, box["y"] + 300, to=(box["x"] + 190, box["y"] + 310))
    assert until(lambda: desk.painter.pose(page) != pose) and not any(seen)
    assert tab.errors == []


@in_browser
def test_a_palette_that_was_opened_elsewhere_shows_its_colors_and_changes(viewer, tab):
    recolorer, controls = viewer.desk.recolorer, viewer.page.controls
    tab.choose("Recolor")
    recolorer.open("palette")
    viewer.page.changed()
    assert until(lambda: "bias" in tab.words()), tab.words()
    assert controls["palette"].value == "palette"
    controls["color 0"].value = (10, 20, 240)
    assert until(lambda: recolorer.changes.colors == {0: "#0a14f0"})
    assert until(lambda: "--palette '0=#0a14f0'" in tab.words()), tab.words()
    tab.choose("Reset")
    assert until(lambda: not recolorer.changes.config() and controls["color 0"].value != (10, 20, 240))
    controls["palette"].value = "(none)"
    assert until(lambda: "bias" not in tab.words())
    assert recolorer.palette == "" and tab.errors == []


def _drawn(viewer):
    """What is drawn in the scenes of its pages."""
    pages = viewer._server.get_clients().values()
    return [one for page in pages for one in page.scene._handle_from_node_name.values()]


def test_the_page_is_served_before_torch_is_imported():
    pytest.importorskip("viser")
    code = "import sys, viser, stages.viewing.server, stages.viewing.page; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=120).returncode == 0


def test_only_the_viewers_own_pages_are_served(viewer):
    assert urlopen(viewer.url, timeout=20).status == 200
    for path in ("/../../pyproject.toml", "/scene/wall/scene.json", "/%2e%2e/x"):
        with pytest.raises(HTTPError, match="404"):
            urlopen(viewer.url + path, timeout=20)
    with pytest.raises(HTTPError, match="403"):
        urlopen(Request(viewer.url, headers={"Host": "evil.example"}), timeout=20)


def test_a_second_viewer_is_told_who_holds_the_folder(viewer):
    root = viewer.desk.library.work.root
    with pytest.raises(OutOfResources, match=f"being shown by another process .{os.getpid()}"):
        Viewer(root, ViewConfig(port=0, open=False), 1)


def test_a_port_in_use_and_an_empty_folder_are_reported(viewer, tmp_path):
    furnished(tmp_path / "work")
    port = int(viewer.url.rpartition(":")[2])
    with pytest.raises(OutOfResources, match=f"--port {port} is not available"):
        Viewer(tmp_path / "work", ViewConfig(port=port, open=False), 1)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ArtifactStale, match="no scene"):
        Viewer(tmp_path / "empty", ViewConfig(port=0, open=False), 1)
    Viewer(tmp_path / "work", ViewConfig(port=0, open=False), 1).close()  # the failed one has let go of the folder
