"""Cameras of an object that stand elsewhere, reported by what their masks keep."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from schemas.images import to_uint8, write_png
from stages.sfm import quality, silhouettes
from stages.sfm.photo_copies import MASKS, Copy
from tests.stages.photo_room import look_at

WIDTH, HEIGHT, FOCAL, COUNT = 200, 150, 220.0, 12
BOX = np.array([0.5, 0.15, 0.25])  # half sides: from another side it looks different


@pytest.fixture
def model() -> pycolmap.Reconstruction:
    """Twelve cameras around a box with 600 points on its faces, each seen by three of them."""
    made = pycolmap.Reconstruction()
    made.add_camera_with_trivial_rig(
        pycolmap.Camera(
            camera_id=1, model="SIMPLE_PINHOLE", width=WIDTH, height=HEIGHT, params=[FOCAL, WIDTH / 2, HEIGHT / 2]
        )
    )
    for index, camera_from_world in enumerate(around()):
        image = pycolmap.Image(name=name_of(index), camera_id=1, image_id=index + 1)
        image.points2D = [pycolmap.Point2D(np.zeros(2)) for _ in range(600)]
        made.add_image_with_trivial_frame(image, pycolmap.Rigid3d(camera_from_world[:3]))
    for number, xyz in enumerate(on_the_box()):
        track = pycolmap.Track()
        for image in {number % COUNT, (number + 1) % COUNT, (number + 5) % COUNT}:
            track.add_element(image + 1, number)
        made.add_point3D(xyz, track)
    return made


def name_of(index: int) -> str:
    return f"{index:05d}.jpg"


def around() -> list[np.ndarray]:
    """camera_from_world of each: at unequal angles and heights, so that no two see the box alike."""
    angles = np.linspace(0, 2 * np.pi, COUNT, endpoint=False)
    eyes = [(2.0 * np.cos(a), 2.0 * np.sin(a), 0.3 + 0.1 * k) for k, a in enumerate(angles)]
    return [np.linalg.inv(look_at(eye, (0, 0, 0), "c", WIDTH, HEIGHT, FOCAL).world_from_camera) for eye in eyes]


def on_the_box() -> np.ndarray:
    random = np.random.default_rng(0)
    points = random.uniform(-1, 1, (600, 3))
    faces = random.integers(0, 3, 600)
    points[np.arange(600), faces] = np.sign(points[np.arange(600), faces])
    return points * BOX


def outlines() -> dict[str, np.ndarray]:
    """The silhouette of the box for each camera: the convex hull of its projected corners, by half planes."""
    corners = np.stack(np.meshgrid(*[[-1, 1]] * 3), -1).reshape(-1, 3) * BOX
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    found = {}
    for index, camera_from_world in enumerate(around()):
        local = corners @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
        flat = local[:, :2] / local[:, 2:] * FOCAL + (WIDTH / 2, HEIGHT / 2)
        inside = np.ones((HEIGHT, WIDTH), bool)
        for a in flat:
            for b in flat:
                side = (b - a)[0] * (flat - a)[:, 1] - (b - a)[1] * (flat - a)[:, 0]
                if not np.array_equal(a, b) and (side >= -1e-9).all():
                    inside &= (b - a)[0] * (y - a[1]) - (b - a)[1] * (x - a[0]) >= 0
        found[name_of(index)] = inside
    return found


def test_cameras_that_stand_right_see_next_to_nothing_outside(model):
    assert max(silhouettes.outside(model, outlines()).values()) < 0.01
    assert silhouettes.refuted(model, outlines()) == []


def test_a_camera_that_stands_elsewhere_is_refuted_and_taken_out(model):
    wrong = model.images[4]  # as if a quarter of a turn further on
    wrong.frame.set_cam_from_world(1, pycolmap.Rigid3d(around()[6][:3]))
    shares = silhouettes.outside(model, outlines())
    assert shares.pop(name_of(3)) > 0.15 and max(shares.values()) < 0.01
    names = silhouettes.refuted(model, outlines())
    assert names == [name_of(3)]
    silhouettes.without(model, names)
    assert sorted(model.reg_image_ids()) == [1, 2, 3, *range(5, 13)]
    assert all(element.image_id != 4 for point in model.points3D.values() for element in point.track.elements)


def test_outlines_a_few_pixels_too_tight_refute_nobody(model):
    tight = {name: mask & np.roll(mask, 2, 0) & np.roll(mask, 2, 1) for name, mask in outlines().items()}
    assert silhouettes.refuted(model, tight) == []


def test_points_beyond_the_picture_tell_nothing(model):
    """A close-up: it shows a part of the object, all of it kept."""
    model.cameras[1].params = [8 * FOCAL, WIDTH / 2, HEIGHT / 2]
    full = {name: np.ones((HEIGHT, WIDTH), bool) for name in outlines()}
    assert set(silhouettes.outside(model, full).values()) == {0.0}


def copied(folder: Path, masks: dict[str, np.ndarray]) -> list[Copy]:
    for name, mask in masks.items():
        write_png(folder / MASKS / f"{name}.png", to_uint8(mask.astype(np.float32)))
    return [
        Copy("p.png", (WIDTH, HEIGHT), name, (WIDTH, HEIGHT), "unknown", 0.0, name, not mask.all())
        for name, mask in masks.items()
    ]


def test_masks_cut_an_object_out_or_hide_parts_of_a_room(tmp_path):
    masks = outlines()
    found = silhouettes.of_object(tmp_path, copied(tmp_path, masks))
    assert all(np.array_equal(found[name], masks[name]) for name in masks)
    random = np.random.default_rng(0)
    for name in masks:  # passers-by, then a lens hood, the same for all
        left = random.integers(0, 150)
        masks[name] = np.ones((HEIGHT, WIDTH), bool)
        masks[name][60:, left : left + 30] = False
    assert silhouettes.of_object(tmp_path, copied(tmp_path, masks)) == {}
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    hood = (x - 100) ** 2 + (y - 75) ** 2 < 70**2
    assert silhouettes.of_object(tmp_path, copied(tmp_path, dict.fromkeys(masks, hood))) == {}
    assert silhouettes.of_object(tmp_path, copied(tmp_path, dict.fromkeys(masks, np.ones_like(hood)))) == {}


def test_many_refuted_cameras_refuse_the_poses():
    reported = {
        "photos": 20,
        "registered": 20,
        "points": 900,
        "error_px": 0.4,
        "track_length": 4.0,
        "parallax_deg": 20.0,
    }
    reported |= {"agreement": 1.0, "pairs_checked": 28, "flat_share": 0.0, "turned_share": 0.0, "models": (20,)}
    for share, refused in ((0.0, False), (0.2, False), (0.25, True)):
        line = quality.verdict(quality.Quality(**reported, refined=False, refuted_share=share))[0]
        assert ("contradict the silhouettes: for 25% of the placed photos" in line) == refused and bool(line) == refused
