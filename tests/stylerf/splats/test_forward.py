"""Pictures of splats against the closed form of a single one, front-to-back compositing, and a published basis."""

import numpy as np
import pytest
from scipy.special import sph_harm_y

from stylerf.errors import InvalidValue
from stylerf.kernels.cpu.splats import Gaussians
from stylerf.splats.forward import colors, picture
from tests.stages.photo_room import look_at

CAMERA = look_at((3.0, 1.0, 0.5), (0, 0, 0), width=96, height=72, focal=80.0)
C0 = 0.28209479177387814


def splats(centers, scale=0.15, logit=3.0, color=(0.8, 0.4, 0.1), bands=1) -> Gaussians:
    n = len(centers)
    harmonics = np.zeros((n, bands, 3), np.float32)
    harmonics[:, 0] = (np.broadcast_to(color, (n, 3)) - 0.5) / C0
    turns = np.tile(np.float32([1, 0, 0, 0]), (n, 1))
    scales = np.log(np.broadcast_to(scale, (n, 3))).astype(np.float32)
    logits = np.broadcast_to(logit, n).astype(np.float32)
    return Gaussians(np.asarray(centers, np.float32), scales, turns, np.ascontiguousarray(logits), harmonics)


def expected_alpha(center, scales, logit, camera) -> np.ndarray:
    """Zwicker et al. 2001: the projected covariance J W S W^T J^T + 0.3, by numerical derivatives of the projection."""
    pixel, _ = camera.project(np.array([center]))
    step = 1e-5
    moved = [camera.project(np.array([center]) + step * axis)[0][0] for axis in np.eye(3)]
    jacobian = (np.array(moved) - pixel).T / step
    covariance = jacobian @ np.diag(np.square(scales)) @ jacobian.T + 0.3 * np.eye(2)
    rows, columns = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    away = np.stack([columns, rows], -1) - pixel[0]
    exponent = np.einsum("hwi,ij,hwj->hw", away, np.linalg.inv(covariance), away)
    alpha = np.exp(-exponent / 2) / (1 + np.exp(-logit))
    return np.where(alpha > 1 / 255, alpha, 0)


@pytest.mark.parametrize("center, scales", [((0, 0, 0), (0.15, 0.15, 0.15)), ((0.4, -0.6, 0.2), (0.3, 0.05, 0.1))])
def test_a_single_splat_is_the_closed_form(center, scales):
    seen = picture(splats([center], scales, 1.5), CAMERA, near=0.2, threads=2)
    alpha = expected_alpha(np.array(center, float), scales, 1.5, CAMERA)
    assert np.abs(seen[..., 3] - alpha).max() < 5e-3 and alpha.max() > 0.7
    assert np.abs(seen[..., :3] - alpha[..., None] * [0.8, 0.4, 0.1]).max() < 5e-3


def test_near_splats_cover_far_ones_in_any_order():
    toward = CAMERA.center / np.linalg.norm(CAMERA.center)
    both = splats([-0.5 * toward, 0.5 * toward], 0.4, 0.0, [(1.0, 0, 0), (0, 0, 1.0)])
    turned = Gaussians(*(np.ascontiguousarray(values[::-1]) for values in both))
    seen, again = (picture(one, CAMERA, near=0.2, threads=2) for one in (both, turned))
    assert np.array_equal(seen, again)
    middle = seen[36, 48]
    # Opacity 1/2 each: blue in front keeps a half, red behind half of the rest.
    assert middle == pytest.approx([0.25, 0, 0.5, 0.75], abs=0.01)


def test_what_is_behind_or_nearer_than_allowed_is_left_out():
    beyond = CAMERA.center * 1.5
    close = CAMERA.center * 0.98
    assert picture(splats([beyond, close]), CAMERA, near=0.2, threads=1).max() == 0


@pytest.mark.parametrize("bands", [1, 4, 9, 16])
def test_colors_follow_spherical_harmonics(bands):
    """SciPy's complex harmonics; 3D Gaussian splatting leaves the Condon-Shortley phase in."""
    random = np.random.default_rng(bands)
    gaussians = splats(random.normal(size=(20, 3)), bands=bands)._replace(
        harmonics=random.normal(size=(20, bands, 3)).astype(np.float32)
    )
    ways = gaussians.centers - CAMERA.center
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    theta, phi = np.arccos(ways[:, 2]), np.arctan2(ways[:, 1], ways[:, 0])
    total = np.full((20, 3), 0.5)
    for degree in range(int(bands**0.5)):
        for order in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(order), theta, phi)
            real = value.real if order == 0 else np.sqrt(2) * (value.real if order > 0 else value.imag)
            total += real[:, None] * gaussians.harmonics[:, degree * degree + degree + order]
    np.testing.assert_allclose(colors(gaussians, CAMERA), total, atol=1e-5)


def test_bands_of_rows_make_the_same_picture():
    random = np.random.default_rng(3)
    many = splats(random.uniform(-1, 1, (300, 3)), 0.1, 0.5, random.uniform(0, 1, (300, 3)))
    whole = picture(many, CAMERA, near=0.2, threads=2)
    in_bands = picture(many, CAMERA, near=0.2, threads=2, most_bytes=8000)
    np.testing.assert_allclose(in_bands, whole, atol=1e-5)
    with pytest.raises(InvalidValue, match="single row of tiles"):
        picture(many, CAMERA, near=0.2, threads=2, most_bytes=100)
