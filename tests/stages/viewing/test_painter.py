"""The painter: small pictures while the camera moves, the renderer's own when it rests, nothing that nobody wants."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from stages.viewing import painter as painting
from stages.viewing import pictures
from stages.viewing.cameras import Pose
from stages.viewing.library import Library
from stages.viewing.painter import Painter
from stages.viewing.shown import Shown, picture_of
from stylerf.fields.marching import ScratchArena
from stylerf.fields.palette_edits import PaletteEdits, Recoloring
from stylerf.rendering.view import render_view
from tests.stages.viewing.room import furnished

EXACT_PIXELS = 60 * 45


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return Library(furnished(tmp_path_factory.mktemp("viewed") / "work").root)


class Board:
    """What a page was sent."""

    def __init__(self):
        self.sent, self.done = [], threading.Event()

    def __call__(self, picture, exact, stride):
        self.sent.append((picture, exact, stride))
        if exact:
            self.done.set()


@pytest.fixture
def painter():
    made = Painter(1, EXACT_PIXELS, 12.0)
    made.start()
    yield made
    made.stop()


def pose(x: float = 0.0) -> Pose:
    return Pose((1.0, 0.0, 0.0, 0.0), (x, 0.0, 0.0), 0.76, 4 / 3)


def test_a_picture_at_rest_is_the_renderers_own(library, painter):
    board, source = Board(), library.source("plain")
    painter.open(0, board)
    painter.show(Shown(source))
    painter.move(0, pose())
    assert board.done.wait(60)
    picture = board.sent[-1][0]
    seen = render_view(source.field, pose().camera(EXACT_PIXELS), threads=1)
    wanted = (np.clip(seen.rgb, 0, 1) * 255 + 0.5).astype(np.uint8)
    assert seen.alpha.max() > 0.5
    np.testing.assert_array_equal(picture, wanted)
    assert not board.sent[0][1], "the first picture is not the exact one"
    time.sleep(0.05)
    np.testing.assert_array_equal(painter.exact(0), picture)
    painter.move(0, pose(0.1))
    assert painter.exact(0) is None


def test_either_side_of_the_wipe_is_its_field(library, painter):
    board, left, right = Board(), library.source("plain"), library.source("palette")
    painter.open(0, board)
    painter.move(0, pose())
    painter.show(Shown(left, right, 0.5))
    assert board.done.wait(60)
    camera = pose().camera(EXACT_PIXELS)
    both = [(np.clip(render_view(s.field, camera, threads=1).rgb, 0, 1) * 255 + 0.5) for s in (left, right)]
    one, two = (picture.astype(np.uint8) for picture in both)
    middle, picture = camera.width // 2, board.sent[-1][0]
    assert not np.array_equal(one[:, middle + 1 :], two[:, middle + 1 :])
    np.testing.assert_array_equal(picture[:, :middle], one[:, :middle])
    np.testing.assert_array_equal(picture[:, middle + 1 :], two[:, middle + 1 :])


@pytest.mark.parametrize("side_by_side", [False, True])
def test_another_palette_is_shown_at_once_nearly_right_then_exactly(library, painter, side_by_side):
    board, palette = Board(), library.source("palette")
    other = library.source("plain") if side_by_side else None
    color = palette.field.color.edited(Recoloring(PaletteEdits({0: (0.1, 0.2, 0.9)}, {1: 0.2})))
    changed = replace(palette, field=replace(palette.field, color=color))
    painter.open(0, board)
    painter.move(0, pose())
    painter.show(Shown(palette, other))
    assert board.done.wait(60)
    first = board.sent[-1][0]
    for source in (changed, palette):  # there, and back from the exact picture of the change
        board.sent.clear()
        board.done.clear()
        painter.show(Shown(source, other))
        assert board.done.wait(60)
        (quick, *state), (exact, *_) = board.sent
        assert state == [False, 1], "nothing coarse between the two"
        assert np.abs(quick.astype(int) - exact).max() <= 6
        if source is changed:
            assert np.abs(exact.astype(int) - first).max() > 40
        seen = render_view(source.field, pose().camera(EXACT_PIXELS), threads=1)
        wanted = (np.clip(seen.rgb, 0, 1) * 255 + 0.5).astype(np.uint8)
        left = slice(0, wanted.shape[1] // 2 if side_by_side else None)
        np.testing.assert_array_equal(exact[:, left], wanted[:, left])
    board.sent.clear()
    board.done.clear()
    painter.show(Shown(library.source("plain"), other))
    assert board.done.wait(60)
    assert np.abs(board.sent[-1][0].astype(int) - first).max() > 10, "another field is not a change of the palette"


def test_what_a_page_draws_itself_is_painted_at_rest_alone(library, painter):
    board = Board()
    painter.open(0, board)
    painter.show(Shown(library.source("plain")))
    painter.move(0, pose())
    assert board.done.wait(60)
    board.sent.clear()
    board.done.clear()
    for x in (0.1, 0.2):
        painter.move(0, pose(x), drawn=True)
    assert board.done.wait(60)
    assert {picture.shape for picture, _, _ in board.sent} == {board.sent[-1][0].shape}
    assert [exact for _, exact, _ in board.sent] == [False] * (len(board.sent) - 1) + [True]


def test_a_moving_picture_is_nearly_the_exact_one(library):
    shown, camera = Shown(library.source("plain")), pose().camera(1200)
    pixels = np.arange(camera.width * camera.height)
    moving, exact = (
        picture_of(shown, camera, pictures.render(camera, shown, pixels, 1, ScratchArena(), quality).reshape(30, 40, 6))
        for quality in (painting.MOVING, pictures.EXACT)
    )
    off = np.abs(moving.astype(int) - exact)
    assert exact.any() and off.max() > 0 and np.sqrt(np.square(off).mean()) < 6


def test_of_a_large_picture_a_grid_is_recolored(library, monkeypatch):
    monkeypatch.setattr(pictures, "MOST_MIXTURES", 1000)
    palette, camera = library.source("palette"), pose().camera(EXACT_PIXELS)
    shown, pixels = Shown(palette), np.arange(camera.width * camera.height)
    mixtures = pictures.Mixtures.room_for(camera, shown)
    out = pictures.render(camera, shown, pixels, 1, ScratchArena(), mixtures=mixtures)
    painted = pictures.Painted(pose(), shown, camera, out.reshape(camera.height, camera.width, 6), mixtures)
    picture = painted.recolored(Shown(palette))
    assert mixtures.stride == 2 and picture.shape == (23, 30, 3)
    np.testing.assert_array_equal(picture, picture_of(shown, camera, painted.out)[::2, ::2])
    thinner = painted.recolored(Shown(palette), 2)
    np.testing.assert_array_equal(thinner, picture[::2, ::2])


def test_a_closed_page_is_sent_nothing(library, painter):
    board = Board()
    painter.open(0, board)
    painter.close(0)
    painter.show(Shown(library.source("plain")))
    painter.move(0, pose())
    time.sleep(0.3)
    assert board.sent == [] and painter.pose(0) is None


def test_an_error_is_reported_and_the_next_picture_painted(library):
    errors, board = [], Board()
    painter = Painter(1, EXACT_PIXELS, 12.0, failed=errors.append)
    painter.start()

    def broken(picture, exact, stride):
        raise OSError("the page is gone")

    painter.open(0, broken)
    painter.move(0, pose())
    painter.show(Shown(library.source("plain")))
    painter.open(1, board)
    painter.move(1, pose())
    painter.show(Shown(library.source("plain")))
    assert board.done.wait(60)
    painter.stop()
    assert errors and "gone" in str(errors[0])


def test_marked_cells_are_tinted_and_planes_show_what_they_name(library):
    source, camera = library.source("plain"), pose().camera(800)
    seen = render_view(source.field, camera, threads=1, regions={"all": np.ones((4, 4, 4), bool)})
    out = np.dstack([seen.rgb, seen.alpha, seen.ray_distance, seen.masks["all"]])
    plain, tinted = (picture_of(Shown(source, marked=m), camera, out) for m in (None, np.ones((4, 4, 4), bool)))
    full = seen.alpha > 0.99
    assert full.any()
    expected = plain[full] * 0.45 + 0.55 * 255 * np.array([1.0, 0.1, 0.8])
    assert np.abs(tinted[full] - expected).max() < 3
    alpha = picture_of(Shown(source, plane="alpha"), camera, out)
    np.testing.assert_array_equal(alpha[..., 0], (seen.alpha * 255 + 0.5).astype(np.uint8))
    assert picture_of(Shown(source, plane="depth"), camera, out)[full].any()
    assert not picture_of(Shown(source, plane="displacement"), camera, out).any()
