"""The viewer in headless Chromium: a picture appears, a click selects, nothing is reported in the console.

With STYLERF_SCREENSHOTS=FOLDER the page is also saved as a PNG, to look at.
"""

import base64
import io
import os
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
from tests.stages.report.browser import CHROMIUM, Browser
from tests.stages.viewing.room import furnished

WIDTH, HEIGHT = 900, 600
SOFTWARE_GL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
in_browser = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (Debian: apt-get install chromium)")


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    pytest.importorskip("viser")
    work = furnished(tmp_path_factory.mktemp("viewed") / "work")
    made = Viewer(work.root, ViewConfig(port=0, open=False, size=96), 1, "plain")
    yield made
    made.close()


class Tab:
    """A page of the viewer."""

    def __init__(self, browser: Browser) -> None:
        self.browser = browser

    def picture(self) -> np.ndarray:
        taken = base64.b64decode(self.browser.send("Page.captureScreenshot")["data"])
        return np.array(Image.open(io.BytesIO(taken)).convert("RGB"))

    def canvas(self) -> dict:
        return self.browser.evaluate(
            "(() => { const r = document.querySelector('canvas').getBoundingClientRect();"
            "return {x: r.x, y: r.y, width: r.width, height: r.height} })()"
        )

    def view(self) -> np.ndarray:
        """The middle of the canvas, which no panel covers."""
        box = self.canvas()
        x, y, w, h = (round(box[key]) for key in ("x", "y", "width", "height"))
        return self.picture()[y + h // 3 : y + 2 * h // 3, x + w // 3 : x + 2 * w // 3]

    def press(self, x: float, y: float, to: tuple[float, float] | None = None, modifiers: int = 0) -> None:
        """Click, or drag to another place, both in pixels of the page."""
        at = {"button": "left", "clickCount": 1, "modifiers": modifiers}
        self.browser.send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, modifiers=modifiers)
        self.browser.send("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **at)
        for step in range(1, 6) if to else ():
            dx, dy = x + (to[0] - x) * step / 5, y + (to[1] - y) * step / 5
            self.browser.send("Input.dispatchMouseEvent", type="mouseMoved", x=dx, y=dy, buttons=1, modifiers=modifiers)
            time.sleep(0.03)
        end = to or (x, y)
        self.browser.send("Input.dispatchMouseEvent", type="mouseReleased", x=end[0], y=end[1], **at)

    def words(self) -> str:
        return self.browser.evaluate("document.body.innerText")

    def choose(self, text: str) -> None:
        """Click what shows exactly this text."""
        place = self.browser.evaluate(
            "(() => { const e = [...document.querySelectorAll('button, [role=tab], [role=option]')]"
            f".filter(e => e.textContent.trim() == {text!r} && e.offsetParent).pop();"
            "if (!e) return null; e.scrollIntoView({block: 'center'}); const r = e.getBoundingClientRect();"
            "return [r.x + r.width / 2, r.y + r.height / 2] })()"
        )
        assert place, f"{text} is not on the page:\n{self.words()}"
        self.press(*place)


def until(found, seconds: float = 20.0):
    """Wait for a condition; return what it returned last."""
    end = time.monotonic() + seconds
    while not (value := found()) and time.monotonic() < end:
        time.sleep(0.1)
    return value


@pytest.fixture(scope="module")
def tab(viewer, tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"), SOFTWARE_GL)
    browser.go(viewer.url, WIDTH, HEIGHT)
    opened = Tab(browser)
    assert until(lambda: browser.evaluate("Boolean(document.querySelector('canvas'))") and "Field" in opened.words())
    yield opened
    if screenshots := os.environ.get("STYLERF_SCREENSHOTS"):
        Image.fromarray(opened.picture()).save(Path(screenshots, "viewer.png"))
    browser.close()


@in_browser
def test_a_picture_appears_and_moves_with_the_camera(viewer, tab):
    desk = viewer.desk
    page = next(iter(desk.painter._pages))
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
    assert tab.browser.errors == []


@in_browser
def test_a_click_on_the_page_selects_what_it_shows(viewer, tab):
    tab.choose("Select")
    assert until(lambda: "nothing is selected" in tab.words())
    viewer.page.controls["pointer"].value = "click"
    box = tab.canvas()
    page = next(iter(viewer.desk.painter._pages))
    tab.press(box["x"] + box["width"] * 0.4, box["y"] + box["height"] * 0.5)
    assert until(lambda: viewer.desk.selected_cells > 0), tab.words()
    assert until(lambda: f"{viewer.desk.selected_cells} cells selected" in tab.words())
    assert until(lambda: "stylerf select" in tab.words())
    assert until(lambda: viewer.desk.painter.exact(page) is not None)
    tab.choose("Undo")
    assert until(lambda: "nothing is selected" in tab.words())
    assert tab.browser.errors == []


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
    with pytest.raises(OutOfResources, match=f"--port {port} cannot be served"):
        Viewer(tmp_path / "work", ViewConfig(port=port, open=False), 1)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ArtifactStale, match="no scene"):
        Viewer(tmp_path / "empty", ViewConfig(port=0, open=False), 1)
    Viewer(tmp_path / "work", ViewConfig(port=0, open=False), 1).close()  # the failed one has let go of the folder
