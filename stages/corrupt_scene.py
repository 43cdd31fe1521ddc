"""Make a scene with one fault: training views are corrupted, test views stay as they are.

The source scene is in another work folder, so the options hold its path and digest, as those of an import do.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from skimage.transform import resize

from schemas.errors import ArtifactStale, BadInput
from schemas.images import to_uint8, write_png
from schemas.scene import Bounds, Scene, View, as_matrix, write_scene
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.scene import SceneData, load_scene
from stages.configs.faults import FAULTS, MADE, CorruptSceneConfig
from stages.run.progress import Context
from stages.run.runner import Spec
from stylerf.corruption import capture, photos
from stylerf.geometry.cameras import Camera
from stylerf.geometry.scene_normalization import depths_of_box
from stylerf.procedural.still_life import dome_cameras
from stylerf.procedural.variants import HardStillLife
from stylerf.srgb import exposed


def _outside(config: CorruptSceneConfig) -> dict[str, str]:
    if not config.source:
        return {}
    scene = Artifact(Path(config.source))
    scene.verify()
    return {"source_digest": scene.digest}


SPEC = Spec(stage="corrupt_scene", verb="stress", revision=1, writes="scene", outside=_outside)
STILL_LIFE_BOX = ((-1.25,) * 3, (1.25,) * 3)
Photo = Callable[[], np.ndarray]


@dataclass(frozen=True, eq=False)
class Shot:
    """A view whose photo, [h, w, 3 or 4] float32, is made on demand."""

    camera: Camera
    split: str
    photo: Photo
    source: str = ""


@dataclass(frozen=True, eq=False)
class Capture:
    """Views and their arrangement. figures: the effect of the fault as numbers."""

    shots: list[Shot]
    layout: str
    reason: str
    bounds: Bounds
    background: str
    scene_from_source: np.ndarray
    figures: dict


def run(inputs: dict[str, Artifact], config: CorruptSceneConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write scene.json and images/; return the figures, including the effect of the fault."""
    generator = np.random.default_rng([context.seed, 20])
    made = FAULTS[config.fault].of == MADE
    found = _still_life(config, context.seed) if made else _corrupted(config, generator)
    views = []
    context.progress.start(f"fault {config.fault}", len(found.shots), "photo")
    for index, shot in enumerate(found.shots):
        image = f"images/{index:03d}.png"
        write_png(partial.path / image, to_uint8(shot.photo()))
        views.append(_view(shot, image))
        context.progress.update(index + 1)
    context.progress.finish()
    write_scene(
        partial.path,
        Scene(
            views=tuple(views),
            layout=found.layout,
            layout_reason=found.reason,
            bounds=found.bounds,
            background=found.background,
            scene_from_source=as_matrix(found.scene_from_source),
        ),
    )
    splits = [view.split for view in views]
    return {"fault": config.fault, "train": splits.count("train"), "test": splits.count("test"), **found.figures}


def _view(shot: Shot, image: str) -> View:
    camera = shot.camera
    return View(
        name=camera.name, image=image, split=shot.split, width=camera.width, height=camera.height,
        fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy,
        world_from_camera=as_matrix(camera.world_from_camera), source=shot.source,
    )  # fmt: skip


def _still_life(config: CorruptSceneConfig, seed: int) -> Capture:
    life = HardStillLife(config.fault, seed)
    shots = [
        Shot(camera, split, partial(_rendered, life, camera), f"still life: {config.fault}")
        for split, count, turn in (("train", config.views, seed), ("test", config.tests, seed + 1000))
        for camera in dome_cameras(count, config.side, split, turn)
    ]
    near, far = depths_of_box([shot.camera for shot in shots], np.array(STILL_LIFE_BOX))
    bounds = Bounds(STILL_LIFE_BOX, float(near), float(far))
    return Capture(shots, "object", "by construction", bounds, "alpha", np.eye(4), {})


def _rendered(life: HardStillLife, camera: Camera) -> np.ndarray:
    return life.render(camera).rgba


def _corrupted(config: CorruptSceneConfig, generator: np.random.Generator) -> Capture:
    data = source_scene(config)
    train, tests = data.splits["train"], _few(data.splits["test"], config.tests)
    if not tests:
        raise BadInput(f"{data.folder}: the scene has no test views to measure with; import it with --test-every 8")
    poses = np.array([data.cameras[i].world_from_camera for i in train])
    train, figures = _chosen(config, train, poses, generator)
    poses = np.array([data.cameras[i].world_from_camera for i in train])
    if config.fault == "pose-noise":
        noisy = capture.noisy_poses(poses, config.amount, config.amount / 100, generator)
        moved = np.linalg.norm(noisy[:, :3, 3] - poses[:, :3, 3], axis=1)
        poses, figures = noisy, figures | {"moved_rms": float(np.sqrt(np.square(moved).mean()))}
    change = _change_of(config, len(train), generator, figures)
    shots = [
        Shot(_camera(data, i, config.side, pose), "train", _photo(data, i, config.side, change, place), f"view {i}")
        for place, (i, pose) in enumerate(zip(train, poses, strict=True))
    ]
    shots += [
        Shot(_camera(data, i, config.side), "test", _photo(data, i, config.side), f"view {i}") for i in tests
    ]  # fmt: skip
    return Capture(
        shots, data.layout, data.scene.layout_reason, _bounds(data, config), data.background,
        np.array(data.scene.scene_from_source), figures,
    )  # fmt: skip


def source_scene(config: CorruptSceneConfig) -> SceneData:
    """Load the scene to corrupt; ArtifactStale if it is not the one that was chosen."""
    artifact = Artifact(Path(config.source))
    if artifact.digest != config.source_digest:
        raise ArtifactStale(f"{config.source} was rebuilt during the run; rerun `stylerf stress`")
    return load_scene(artifact)


def _few(tests: list[int], count: int) -> list[int]:
    """Return at most `count` of the test views, evenly spread."""
    places = np.linspace(0, len(tests) - 1, min(count, len(tests))).round().astype(int)
    return [tests[i] for i in np.unique(places)]


def _chosen(
    config: CorruptSceneConfig, train: list[int], poses: np.ndarray, generator: np.random.Generator
) -> tuple[list[int], dict]:
    """Return the training views that the fault leaves, and figures."""
    if config.fault.startswith("views-"):
        count = int(config.amount)
        if len(train) <= count:
            raise BadInput(f"{config.source} has only {len(train)} training views; this fault needs more than {count}")
        kept = capture.spread_views(poses[:, :3, 3], count, generator)
    elif config.fault == "hidden":
        kept = capture.one_sided(poses, config.amount, generator)
    else:
        return train, {}
    return [train[i] for i in kept], {"left_out": len(train) - len(kept)}


def _change_of(
    config: CorruptSceneConfig, count: int, generator: np.random.Generator, figures: dict
) -> Callable[[np.ndarray, int], np.ndarray]:
    """Return the function from a photo and its index among the training views to the corrupted photo."""
    if config.fault == "exposure":
        stops = photos.exposure_stops(count, config.amount, generator)
        figures["stops"] = [round(float(one), 4) for one in stops]
        return lambda photo, place: exposed(photo, float(stops[place]))
    if config.fault == "blur":
        return lambda photo, place: photos.blurred(photo, config.amount * max(photo.shape[:2]))
    if config.fault == "jpeg":
        return lambda photo, place: photos.through_jpeg(photo, int(config.amount))
    return lambda photo, place: photo


def _camera(data: SceneData, index: int, side: int, pose: np.ndarray | None = None) -> Camera:
    camera = data.cameras[index]
    camera = camera.scaled(min(1.0, side / max(camera.width, camera.height)))
    return camera if pose is None else replace(camera, world_from_camera=pose)


def _photo(data: SceneData, index: int, side: int, change=lambda photo, place: photo, place: int = 0) -> Photo:
    camera = _camera(data, index, side)

    def made() -> np.ndarray:
        return change(averaged(data.images(index), camera.height, camera.width), place)

    return made


def averaged(photo: np.ndarray, height: int, width: int) -> np.ndarray:
    """Resize a photo [h, w, 3 or 4], straight alpha, weighting colors by alpha."""
    if photo.shape[:2] == (height, width):
        return photo
    if photo.shape[2] == 3:
        return np.clip(resize(photo, (height, width, 3), anti_aliasing=True), 0, 1).astype(np.float32)
    mixed = np.concatenate([photo[..., :3] * photo[..., 3:], photo[..., 3:]], -1)
    mixed = resize(mixed, (height, width, 4), anti_aliasing=True)
    rgb = mixed[..., :3] / np.maximum(mixed[..., 3:], 1e-6)
    return np.clip(np.concatenate([rgb, mixed[..., 3:]], -1), 0, 1).astype(np.float32)


def _bounds(data: SceneData, config: CorruptSceneConfig) -> Bounds:
    """Return the scene's bounds; for the near-plane fault, with a too distant near plane or a cropped box."""
    bounds = data.bounds
    if config.fault != "near-plane":
        return bounds
    if data.layout == "object":  # only the box bounds its rays
        return replace(bounds, aabb=capture.cut_box(bounds.aabb, config.amount))
    poses = np.array([camera.world_from_camera for camera in data.cameras])
    near = capture.late_near(bounds.near, bounds.far, config.amount, capture.median_distance(poses))
    return replace(bounds, near=near)
