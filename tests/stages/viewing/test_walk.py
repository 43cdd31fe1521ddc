"""A walk through the whole page in headless Chromium, and random clicks and drags, on the demo and on real scenes.

STYLERF_FITTED=FOLDER holds work folders that are fitted already, by the scene's name; others are fitted first.
STYLERF_SCREENSHOTS=FOLDER keeps pictures of the page and viewer.gif, which docs/how-to/view.md shows.
STYLERF_RANDOM_SECONDS says how long clicks and drags go on.
"""

import os
import random
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from schemas.images import to_uint8, write_png
from stages.configs.decompose import PaletteFieldConfig
from stages.configs.fit import FitConfig
from stages.configs.pose_import import ImportOptions
from stages.configs.view import ViewConfig
from stages.pipeline.demo_scene import write_demo
from stages.pipeline.pipeline import Pipeline
from stages.run.progress import Silent
from stages.viewing.half_done import steps_done
from stages.viewing.runs import Runs
from stages.viewing.server import Viewer
from stages.viewing.styles import Wish
from tests.stages.report.browser import CHROMIUM, Browser
from tests.stages.viewing.tab import SOFTWARE_GL, Tab, page_of, until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (Debian: apt-get install chromium)"),
]
WIDTH, HEIGHT = 1100, 640
SIZE = 256  # pixels of the longer side of photos
RANDOM_SECONDS = float(os.environ.get("STYLERF_RANDOM_SECONDS", "600"))
GIF_WIDTH = 640
PATIENCE = 600.0


@pytest.fixture(scope="module", params=["still-life", "lego", "fern", "cup"])
def root(request, tmp_path_factory) -> Path:
    """A work folder with a field `fit`, and painting.png beside it."""
    pytest.importorskip("viser")
    name = request.param
    folder = tmp_path_factory.mktemp("walked") / name
    fitted = Path(os.environ.get("STYLERF_FITTED", ""), name)
    photos = folder.parent / "photos" if name == "still-life" else request.getfixturevalue("data_dir") / name
    if name == "still-life":
        write_demo(photos, 128, 24, 4, 0, 2, Silent())
    write_png(folder.parent / "painting.png", painted())
    if "STYLERF_FITTED" in os.environ and fitted.is_dir():
        shutil.copytree(fitted, folder)
        return folder
    pipeline = Pipeline(folder, threads=2)
    pipeline.import_photos(photos, ImportOptions(max_side=SIZE))
    pipeline.fit(FitConfig(budget="30s", buffers=False))
    return folder


def painted() -> np.ndarray:
    """Blue and orange waves, 256 x 256."""
    y, x = np.mgrid[:256, :256] / 256
    wave = 0.5 + 0.5 * np.sin(40 * (y + 0.1 * np.sin(9 * x)))[..., None]
    return to_uint8(wave * [0.1, 0.2, 0.6] + (1 - wave) * [0.9, 0.6, 0.2])


@pytest.fixture(scope="module")
def walked(root, tmp_path_factory):
    pipeline = Pipeline(root, threads=2)
    small = PaletteFieldConfig(budget="20", refit_steps=20, levels=4, table_bits=12)
    pipeline.decompose(small, of="fit", name="palette")
    viewer = Viewer(root, ViewConfig(port=0, open=False), 2, "fit")
    browser = Browser(tmp_path_factory.mktemp("profile"), SOFTWARE_GL)
    browser.go(viewer.url, WIDTH, HEIGHT)
    tab = Tab(browser)
    assert until(tab.ready)
    yield viewer, tab
    browser.close()
    viewer.close()


def succeeded(runs: Runs) -> None:
    """Wait for the end of the present run, and fail unless it made what it was to make."""
    assert until(lambda: runs.present.code is not None, PATIENCE) and runs.present.code == 0, list(runs.present.lines)


class Film:
    """Pictures of the walk."""

    def __init__(self, folder: Path, scene: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.scene, self.frames = folder, scene, list[Image.Image]()

    def take(self, tab: Tab, name: str = "", shown: int = 1) -> None:
        picture = Image.fromarray(tab.picture())
        if name:
            picture.save(self.folder / f"{self.scene}-{name}.png")
        small = picture.resize((GIF_WIDTH, round(GIF_WIDTH * HEIGHT / WIDTH)), Image.Resampling.LANCZOS)
        self.frames += [small] * shown

    def save(self) -> None:
        first, *others = [one.quantize(64, dither=Image.Dither.NONE) for one in self.frames]
        path = self.folder / "viewer.gif"
        first.save(path, save_all=True, append_images=others, duration=350, loop=0, optimize=True)


@pytest.mark.timeout(3600)
def test_the_whole_walk(root, walked, tmp_path):
    viewer, tab = walked
    desk, runs, controls = viewer.desk, viewer.desk.runs, viewer.page.controls
    film = Film(Path(os.environ.get("STYLERF_SCREENSHOTS", tmp_path)), root.name)
    page = page_of(desk)
    box = tab.canvas()
    middle = (box["x"] + 0.36 * box["width"], box["y"] + 0.5 * box["height"])

    def rest() -> np.ndarray:
        """The exact picture, once nothing changes it any more."""
        seen = None
        while seen is None or seen is not desk.painter.exact(page):
            assert until(lambda: desk.painter.exact(page) is not None, PATIENCE), tab.words()
            seen = desk.painter.exact(page)
            time.sleep(0.4)
        return seen

    def seen_after(action) -> float:
        """Seconds from an action to the next picture that is sent."""
        wanted, sent = desk.painter._pages[page], []
        send, began = wanted.send, time.perf_counter()
        wanted.send = lambda *picture: (send(*picture), sent.append(time.perf_counter()))
        action()
        assert until(lambda: sent, PATIENCE)
        wanted.send = send
        return sent[0] - began

    def ran(button: str) -> None:
        """Press a button that runs a command, and wait for its end."""
        before = runs.present
        tab.choose(button)
        assert until(lambda: runs.present is not before), tab.words()
        succeeded(runs)

    rest()
    assert until(lambda: tab.view().mean() > 40), "a page is dark until it is connected"
    film.take(tab, "1-look", 2)
    for step, way in enumerate((1, 1, -1, -1, -1, 1)):  # there and back: a capture is seen from one side
        pose = desk.painter.pose(page)
        tab.press(*middle, to=(middle[0] + 30 * way, middle[1] + 4 * way))
        assert until(lambda before=pose: desk.painter.pose(page) != before)
        rest()
        if root.name == "still-life":  # whose photos are level
            assert abs(desk.painter.pose(page).matrix[:3, 0] @ viewer.page.up) < 0.05, "a drag keeps the horizon level"
        if step % 2 == 1:
            film.take(tab)

    # Select: what is tinted is what the region's mask shows, and the rest stays as it was.
    before = rest()
    tab.choose("Select")
    controls["pointer"].value = "click"
    tab.press(*middle)
    assert until(lambda: desk.selector.cells > 0, PATIENCE), tab.words()
    assert until(lambda: "stylerf select" in tab.words())
    grown = desk.selector.cells
    controls["tolerance"].value += 6
    assert until(lambda: "--tolerance" in tab.words(), PATIENCE), tab.words()
    assert desk.selector.cells >= grown
    desk.selector.change(iterations=5000)  # a region of a fit as short as this one may grow over everything
    after = rest()
    film.take(tab, "2-selected", 3)
    desk.display.look(plane="mask")
    mask = rest()[..., 0]
    desk.display.look(plane="color")
    changed = np.abs(after.astype(int) - before).max(2)
    assert (mask > 0).any() and changed[mask == 0].max(initial=0) <= 1
    assert (changed[mask > 200] > 12).mean() > 0.9
    runs.start(desk.selector.command("thing"))
    succeeded(runs)
    desk.selector.clear()

    # Recolor: the page's picture is that of the recolored field, and goes back.
    tab.choose("Recolor")
    controls["palette"].value = "palette"
    assert until(lambda: desk.display.field == "palette" and "weight" in tab.words())
    plain = rest()
    color = controls["color 0"]
    print(f"a palette after {seen_after(lambda: setattr(color, 'value', (208, 48, 16))):.3f} s")
    assert np.abs(rest().astype(int) - plain).max() > 40
    assert "--palette" in " ".join(desk.recolorer.command("red"))
    film.take(tab, "3-recolored", 3)
    tab.choose("Reset")
    assert until(lambda: not desk.recolorer.changes.config())
    np.testing.assert_array_equal(rest(), plain)
    controls["palette"].value = "(none)"
    assert until(lambda: not desk.recolorer.palette)

    # Region: its edit is learned, then brought into a field of its own; all else stays nearly as it was.
    desk.display.look(field="fit")
    plain = rest()
    tab.choose("Region")
    ran("1. Extract")
    wish = Wish(str(root.parent / "painting.png"), region="thing", budget="10s", name="painted")
    runs.start(desk.stylizer.command(wish))
    succeeded(runs)
    tab.choose("Recolor")
    before = controls["color 0"]
    controls["palette"].value = "edit painted"
    assert until(lambda: desk.recolorer.palette == "edit painted" and controls["color 0"] is not before)
    previewed = rest()
    film.take(tab, "3-edit", 2)
    assert np.abs(previewed.astype(int) - plain).max(2)[mask == 0].max(initial=0) <= 1
    assert np.abs(previewed.astype(int) - plain).max() > 40
    color = controls["color 0"]
    print(f"a region's palette after {seen_after(lambda: setattr(color, 'value', (48, 208, 16))):.3f} s")
    assert np.abs(rest().astype(int) - previewed).max() > 15
    controls["palette"].value = "(none)"
    assert until(lambda: not desk.recolorer.palette)
    tab.choose("Region")
    assert until(lambda: "--edit painted" in tab.words()), tab.words()
    ran("3. Distill")
    controls["seconds"].value = 5
    assert until(lambda: "--budget 5s" in tab.words()), tab.words()
    ran("4. Fine-tune")
    assert until(lambda: desk.display.field not in ("fit", "palette")), "the new field is shown"
    tuned = rest()
    film.take(tab, "3-region", 3)
    off = np.abs(tuned.astype(int) - plain).max(2)
    assert off[mask > 250].mean() > 4 * off[mask == 0].mean() + 4

    # Stylize: stopped and kept, a field of the steps so far. With a budget of steps, which repeats to the bit.
    tab.choose("Stylize")
    desk.display.look(field="fit")
    wish = Wish(str(root.parent / "painting.png"), budget="400", name="waves")
    plain = rest()
    run = runs.start([*desk.stylizer.command(wish), "--refit-steps", "10"])
    desk.stylizer.watch(run, "waves")
    assert until(lambda: (steps_done(desk.library.work, "waves") or 0) > 0, PATIENCE), list(run.lines)
    assert until(lambda: np.abs(rest().astype(int) - plain).max() > 40, PATIENCE), "it is shown as it trains"
    film.take(tab, "3-in-progress", 2)
    tab.choose("Keep as it is")
    assert until(lambda: runs.present is not run and runs.present.code is not None, PATIENCE), list(runs.present.lines)
    assert runs.present.code == 0 and "--until" in runs.present.arguments, list(runs.present.lines)
    kept = desk.library.work.get("field", "waves").manifest
    assert kept.figures["steps"] == kept.config["until"] < 400
    assert until(lambda: desk.display.field == "waves")
    assert np.abs(rest().astype(int) - plain).max() > 40
    film.take(tab, "3-kept", 2)

    # Two fields side by side, depth, a path.
    tab.choose("Look")
    controls["field"].value, controls["beside"].value = "fit", "waves"
    assert until(lambda: (desk.display.field, desk.display.choice.beside) == ("fit", "waves"))
    rest()
    film.take(tab, "4-beside", 3)
    controls["beside"].value, controls["plane"].value = "(none)", "depth"
    assert until(lambda: (desk.display.choice.beside, desk.display.choice.plane) == ("", "depth"))
    rest()
    film.take(tab, "5-depth", 2)
    controls["plane"].value = "color"
    assert until(lambda: desk.display.choice.plane == "color")
    tab.choose("Paths")
    for _ in range(2):
        tab.choose("Add keyframe here")
        pose = desk.painter.pose(page)
        tab.press(*middle, to=(middle[0] + 60, middle[1]))
        assert until(lambda before=pose: desk.painter.pose(page) != before)
        rest()
    assert until(lambda: len(desk.path.keyframes.poses) == 2)
    desk.path.space(between=2)
    runs.start([*desk.path.command(desk.path.save("walk"), "fit"), "--scale", "0.5", "--no-exr"])
    succeeded(runs)
    frames = desk.library.work.get("frames", "fit-walk")
    assert frames.manifest.figures["frames"] == 3
    tab.choose("Session")
    assert until(lambda: "stylerf render" in tab.words())
    film.take(tab, "6-session", 2)
    assert runs.script().count("\nstylerf ") == 8
    if root.name == "still-life":
        film.save()
    assert tab.errors == []


@pytest.mark.timeout(RANDOM_SECONDS + 300)
def test_random_clicks_and_drags_leave_no_error_and_no_memory(walked):
    import psutil

    viewer, tab = walked
    chance, process, sizes = random.Random(0), psutil.Process(), []
    viewer.page.controls["pointer"].value = "look"
    end = time.monotonic() + RANDOM_SECONDS
    while time.monotonic() < end:
        x, y = chance.uniform(5, WIDTH * 0.6), chance.uniform(5, HEIGHT - 5)
        to = (chance.uniform(5, WIDTH * 0.6), chance.uniform(5, HEIGHT - 5)) if chance.random() < 0.6 else None
        tab.press(x, y, to)
        if chance.random() < 0.1:
            tab.choose(chance.choice(["Look", "Select", "Recolor", "Stylize", "Region", "Paths", "Session"]))
        time.sleep(0.05)
        sizes.append(process.memory_info().rss / 1e6)
    settled = sizes[len(sizes) // 3 :]
    third = len(settled) // 3
    growth = np.median(settled[-third:]) - np.median(settled[:third])
    print(f"{len(sizes)} gestures, {sizes[0]:.0f} to {sizes[-1]:.0f} MB, {growth:+.1f} MB in the last two thirds")
    assert growth < 60
    assert tab.errors == []
