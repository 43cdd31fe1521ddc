"""Scenes with a fault: what is damaged, what is not, what they tell of where they come from."""

import numpy as np
import pytest
from skimage.measure import block_reduce

from schemas.errors import ArtifactStale, BadInput
from schemas.work_folder import WorkFolder
from stages import corrupt_scene
from stages.artifacts.scene import load_scene
from stages.configs.faults import ALL_FAULTS, FAULTS, MADE, SCENE, CorruptSceneConfig
from stages.run.progress import Context
from stages.run.runner import execute
from stylerf.corruption import photos
from stylerf.srgb import exposed
from tests.stages.stress_fixture import SIZE, TRAIN, make_capture, photo_of


@pytest.fixture
def source(tmp_path):
    return make_capture(WorkFolder(tmp_path / "work"))


def damaged(source, tmp_path, fault: str, seed=0, **more):
    given = {"amount": FAULTS[fault].amount, "side": SIZE, "views": 4, "tests": 2}
    if FAULTS[fault].of == SCENE:
        given |= {"source": str(source.path), "source_digest": source.digest}
    config = CorruptSceneConfig(fault=fault, **{**given, **more})
    place = WorkFolder(tmp_path / f"{fault}-{seed}-{len(list(tmp_path.iterdir()))}")
    made, _ = execute(corrupt_scene.SPEC, corrupt_scene.run, place, "main", {}, config, Context(seed=seed))
    return made, load_scene(made)


def names(data, split: str) -> list[str]:
    return [data.views[i].name for i in data.splits[split]]


@pytest.mark.parametrize("fault", [one.name for one in ALL_FAULTS if one.of == SCENE])
def test_test_views_have_no_fault_and_the_scene_tells_where_it_comes_from(source, tmp_path, fault):
    made, data = damaged(source, tmp_path, fault)
    before = load_scene(source)
    by_name = {view.name: i for i, view in enumerate(before.views)}
    assert names(data, "test") == ["test_000", "test_002"]  # two of three, evenly
    for i in data.splits["test"]:
        old = by_name[data.views[i].name]
        np.testing.assert_array_equal(data.images(i), before.images(old))
        np.testing.assert_array_equal(data.cameras[i].world_from_camera, before.cameras[old].world_from_camera)
    reported = made.manifest
    assert (
        reported.stage == "corrupt_scene"
        and reported.config["source_digest"] == source.digest
        and reported.inputs == []
    )
    assert reported.figures["fault"] == fault and reported.figures["train"] == len(data.splits["train"])
    made.verify()


def test_nothing_but_the_seed_is_nothing(source, tmp_path):
    _, data = damaged(source, tmp_path, "seeds")
    for i in data.splits["train"]:
        np.testing.assert_array_equal(data.images(i), photo_of(i).astype(np.float32) / np.float32(255))
    assert data.bounds == load_scene(source).bounds and len(data.splits["train"]) == TRAIN


def test_photos_are_damaged_as_their_faults_say(source, tmp_path):
    clean = [photo_of(i).astype(np.float32) / 255 for i in range(TRAIN)]
    made, data = damaged(source, tmp_path, "exposure")
    stops = made.manifest.figures["stops"]
    assert len(stops) == TRAIN and abs(stops[0]) == 0.75
    for i, one in enumerate(stops):
        np.testing.assert_allclose(data.images(i), exposed(clean[i], one), atol=0.6 / 255)
    _, data = damaged(source, tmp_path, "jpeg")
    np.testing.assert_allclose(data.images(3), photos.through_jpeg(clean[3], 10), atol=0.6 / 255)
    _, data = damaged(source, tmp_path, "blur", amount=0.05)
    np.testing.assert_allclose(data.images(3), photos.blurred(clean[3], 0.05 * SIZE), atol=0.6 / 255)


def test_poses_are_off_by_chance_and_the_same_for_the_same_seed(source, tmp_path):
    before = load_scene(source)
    (one, a), (_, b), (_, c) = (damaged(source, tmp_path, "pose-noise", seed) for seed in (1, 1, 2))
    moved = [
        np.linalg.norm(x.center - y.center) for x, y in zip(a.cameras[:TRAIN], before.cameras[:TRAIN], strict=True)
    ]
    assert one.manifest.figures["moved_rms"] == pytest.approx(np.sqrt(np.square(moved).mean()))
    assert 0.3 < np.sqrt(np.square(moved).mean()) / (np.sqrt(3) * 0.005 * 4.03) < 2
    np.testing.assert_array_equal(a.cameras[0].world_from_camera, b.cameras[0].world_from_camera)
    assert not np.allclose(a.cameras[0].world_from_camera, c.cameras[0].world_from_camera)


def test_fewer_views_and_views_of_one_side(source, tmp_path):
    _, three = damaged(source, tmp_path, "views-3")
    _, other = damaged(source, tmp_path, "views-3", 5)
    assert len(three.splits["train"]) == 3 and names(three, "train") != names(other, "train")
    made, half = damaged(source, tmp_path, "hidden")
    assert len(half.splits["train"]) == TRAIN // 2 and made.manifest.figures["left_out"] == TRAIN // 2
    few = make_capture(WorkFolder(tmp_path / "few"), train=8)
    with pytest.raises(BadInput, match="8 training views"):
        damaged(few, tmp_path, "views-8")


def test_the_near_plane_of_a_capture_and_the_box_of_an_object(source, tmp_path):
    _, data = damaged(source, tmp_path, "near-plane")
    assert data.bounds.aabb == ((-1, -1, -1), (1, 1, 0)) and data.bounds.near == 0.5
    capture = make_capture(WorkFolder(tmp_path / "room"), "unbounded")
    _, data = damaged(capture, tmp_path, "near-plane")
    assert data.bounds.aabb == ((-1, -1, -1), (1, 1, 1))
    assert data.bounds.near == pytest.approx(0.5 * 4.03, rel=0.02)  # half of the dome's radius


def test_large_photos_are_averaged_with_their_cameras(source, tmp_path):
    _, data = damaged(source, tmp_path, "seeds", side=SIZE // 2)
    camera, before = data.cameras[0], load_scene(source).cameras[0]
    assert (camera.width, camera.fx) == (SIZE // 2, before.fx / 2)
    clean = photo_of(0).astype(np.float64) / 255
    mixed = block_reduce(np.dstack([clean[..., :3] * clean[..., 3:], clean[..., 3]]), (2, 2, 1), np.mean)
    small = data.images(0)
    inside = mixed[..., 3] == 1
    inside[:3] = inside[-3:] = inside[:, :3] = inside[:, -3:] = False
    np.testing.assert_allclose(small[inside][:, :3], mixed[inside][:, :3], atol=0.03)  # two filters of like width
    colors = small[small[..., 3] > 0.1][:, :3]
    assert colors.min() > 0.2  # what is transparent has not darkened the rim


@pytest.mark.parametrize("fault", [one.name for one in ALL_FAULTS if one.of == MADE])
def test_made_scenes_are_objects_in_their_box(source, tmp_path, fault):
    made, data = damaged(source, tmp_path, fault)
    assert len(data.splits["train"]) == 4 and len(data.splits["test"]) == 2 and data.layout == "object"
    assert made.manifest.config["source"] == "" and data.channels(0) == 4
    photo = data.images(0)
    assert 0.05 < (photo[..., 3] > 0.5).mean() < 0.9
    for camera in data.cameras:
        depth = camera.project(np.array(np.meshgrid(*[[-1.25, 1.25]] * 3)).reshape(3, -1).T)[1]
        assert data.bounds.near <= depth.min() + 1e-6 and depth.max() - 1e-6 <= data.bounds.far


def test_what_cannot_be_damaged_is_refused(source, tmp_path):
    untested = make_capture(WorkFolder(tmp_path / "untested"), tests=0)
    with pytest.raises(BadInput, match="--test-every"):
        damaged(untested, tmp_path, "seeds")
    config = CorruptSceneConfig(source=str(source.path), source_digest="another")
    with pytest.raises(ArtifactStale, match="was rebuilt during the run"):
        corrupt_scene.source_scene(config)
