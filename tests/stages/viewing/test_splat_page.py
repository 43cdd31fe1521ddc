"""Scenes as HTML files: the splats that viser draws are those of the PLY, and the file opens without a server."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from schemas.splat_ply import StoredSplats, read_splat_ply
from stages.viewing.splat_page import gaussians, write_page
from tests.stages import splat_scene
from tests.stages.report.browser import CHROMIUM, Browser
from tests.stages.viewing.tab import SOFTWARE_GL, Tab, until


def some(count: int = 20) -> StoredSplats:
    chance = np.random.default_rng(0)
    return StoredSplats(
        *(chance.normal(size=size).astype(np.float32) for size in ((count, 3), (count, 3), (count, 4), (count,))),
        chance.normal(size=(count, 4, 3)).astype(np.float32),
    )


def test_covariances_and_colors_are_those_of_the_splats():
    stored = some()
    made = gaussians(stored)
    order = [int(np.abs(stored.centers - center).sum(1).argmin()) for center in made["centers"]]
    assert sorted(order) == list(range(20))
    turns = Rotation.from_quat(stored.quaternions[order][:, [1, 2, 3, 0]]).as_matrix()
    squares = np.exp(2 * stored.log_scales[order])
    expected = np.einsum("nij,nj,nkj->nik", turns, squares, turns)
    np.testing.assert_allclose(made["covariances"], expected, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(made["rgbs"], np.clip(0.5 + 0.28209479 * stored.harmonics[order, 0], 0, 1), atol=1e-6)
    np.testing.assert_allclose(made["opacities"][:, 0], 1 / (1 + np.exp(-stored.logits[order])), rtol=1e-5)


def test_of_too_many_splats_the_most_visible_stay():
    stored = some(6)
    stored.log_scales[:] = np.arange(6)[:, None] * 0.5
    stored.logits[:] = [9, 9, 9, 9, 9, -9]
    made = gaussians(stored, most=2)
    np.testing.assert_array_equal(made["centers"], stored.centers[[4, 3]])


def test_a_far_background_looks_the_same_within_what_viser_draws():
    stored = some(6)
    directions = stored.centers / np.linalg.norm(stored.centers, axis=1, keepdims=True)
    away = np.float32([1, 300, 2e3, 3e4, 1e5, 4e5])[:, None]
    stored.centers[:] = directions * away
    stored.log_scales[:] = np.log(0.1 * away)
    stored.logits[:] = 9
    made = gaussians(stored)
    order = np.argsort(np.linalg.norm(made["centers"], axis=1), kind="stable")
    distances = np.linalg.norm(made["centers"], axis=1)[order]
    np.testing.assert_allclose(made["centers"][order] / distances[:, None], directions, atol=1e-5)
    np.testing.assert_allclose(distances[:2], [1, 300], rtol=1e-5)
    assert distances[-1] < 1000 and (np.diff(distances) > 0).all()
    sizes = np.sqrt(made["covariances"][order][:, range(3), range(3)])
    np.testing.assert_allclose(sizes / distances[:, None], 0.1, rtol=1e-4)
    assert made["covariances"].max() < np.finfo(np.float16).max


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (Debian: apt-get install chromium)")
def test_the_page_opens_without_a_server(tmp_path):
    pytest.importorskip("viser")
    ply = splat_scene.write_ply(tmp_path / "ball.ply", splat_scene.ball())
    assert len(read_splat_ply(ply).centers) == 1500
    camera = SimpleNamespace(position=(0.0, -3.0, 0.0), look_at=(0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0), fov=0.9)
    page = write_page(ply, tmp_path / "view" / "ball.html", camera, np.array([0.0, 0.0, 1.0]))
    browser = Browser(tmp_path / "profile", SOFTWARE_GL)
    try:
        browser.go(page.as_uri(), 500, 400)
        tab = Tab(browser)
        assert until(lambda: browser.evaluate("Boolean(document.querySelector('canvas'))"))
        # The ball stands in the middle, the background at the rims.
        assert until(lambda: np.abs(tab.view().mean((0, 1)) - tab.picture()[-20:, :100].mean((0, 1))).max() > 25)
        assert tab.errors == []
    finally:
        browser.close()
