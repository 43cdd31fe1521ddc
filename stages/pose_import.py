"""Import: turns photos, with poses in any known format or without, into a scene of undistorted pictures."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from schemas.canonical_json import digest_of, file_sha256
from schemas.errors import BadInput
from schemas.exr import FAR_Z, ExrView, read_depth, write_exr
from schemas.images import to_uint8, write_png
from schemas.safe_names import check_utf8, printable
from schemas.safe_reading import allowance
from schemas.scene import POINTS_FILE, Bounds, Lens, LensDistortion, Scene, Skipped, Truth, View, as_matrix, write_scene
from schemas.tensors import save_tensors
from schemas.work_folder import Artifact, PartialArtifact
from stages.configs.pose_import import FRAMES, ImportConfig
from stages.readers import found_in, read_source, splats
from stages.readers.background import Background, Evidence, evidence_of
from stages.readers.photo_folder import conversion, photos_elsewhere, photos_of, unreadable_beside
from stages.readers.photos import Developer, Sized, present, scale_of, scene_camera, sized
from stages.readers.source import SourceCamera, SourceScene, natural, path_in_source, unused_masks, with_masks
from stages.readers.transforms import lists_of
from stages.readers.video import VIDEOS, clips_of, frames_as_photos
from stages.run.parallel import in_order
from stages.run.progress import Context
from stages.run.runner import Spec
from stages.sfm.reconstruction import reconstructed
from stylerf.errors import InvalidValue
from stylerf.geometry import scene_normalization
from stylerf.geometry.cameras import Camera
from stylerf.geometry.resampling import nearest
from stylerf.geometry.silhouette_bounds import hull_box


def digest_of_source(source: Path, format: str = "auto", images: str = "", cameras: str = "") -> str:
    """Return the SHA-256 of the files with poses and of every photo, mask and known depth, by name in the source. Other
    files are ignored. BadInput if the source cannot be read.
    """
    kind = found_in(source, format).kind
    if kind == "splats":
        files = splats.files_of(source, cameras)
        return digest_of([kind, _content(files.splats), _named(splats.pose_files(files))])
    if kind == "video":
        return digest_of([kind, _named(video_of(source))])
    if kind == "photos":
        photos = photos_of(source, images)
        plain = [SourceCamera(one.stem, path_in_source(one, source), one, np.eye(4)) for one in photos]
        with_theirs = with_masks(plain, source)
        others = [one.name for one in unreadable_beside(photos)]
        return digest_of([kind, others, [_entry(one) for one in with_theirs]])
    scene = read_source(source, format, images)
    poses = _named(scene.files or _files_of_poses(source, kind))
    return digest_of([kind, poses, [_entry(one) for one in scene.cameras]])


def _files_of_poses(source: Path, kind: str) -> list[Path]:
    if kind == "transforms":
        return [path for path, _ in lists_of(source)]
    return [source if source.is_file() else source / "poses_bounds.npy"]


def _named(files: Iterable[Path]) -> list[list[str]]:
    return [[path.name, _content(path)] for path in files]


def _entry(camera: SourceCamera) -> list:
    files = [camera.image, camera.mask, camera.depth, *filter(None, [camera.hides])]
    return [camera.source, *(one and _content(one) for one in files)]


def _content(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}); restore it or its permissions") from error


SPEC = Spec(
    stage="pose_import", verb="import", revision=8, writes="scene",
    outside=lambda config: {
        "source_digest": digest_of_source(Path(config.source), config.format, config.images, config.cameras)
    },
)  # fmt: skip
FEWEST_PHOTOS = 2
DEVELOPING_BYTES = 72  # per pixel: four channels of 4 bytes, at most three copies of them, and the map of its lens


@dataclass(frozen=True, eq=False)
class Frame:
    """The chosen layout, the similarity to scene units that follows from it, and the cameras in them."""

    layout: scene_normalization.Layout
    scene_from_source: np.ndarray
    cameras: list[Camera]
    splits: list[str]


def run(inputs: dict[str, Artifact], config: ImportConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write scene.json and images/, and points.safetensors and truth/ if known; return the figures."""
    return import_scene(_source(config, partial, context), config, partial, context)


def _source(config: ImportConfig, partial: PartialArtifact, context: Context) -> SourceScene:
    source = Path(config.source)
    found = found_in(source, config.format)
    if found.kind == "splats":
        files = splats.files_of(source, config.cameras)
        return splats.rendered(files, partial.checkpoint / "renders", context)
    if found.kind == "video":
        return _of_video(video_of(source), config, partial, context)
    if found.kind == "photos":
        for remark in found.remarks:
            context.progress.say(remark)
        photos = photos_of(source, config.images)
        if others := unreadable_beside(photos):
            kinds = sorted({one.suffix for one in others})
            how = conversion(others[0].parent, kinds[0])
            context.progress.say(f"{len(others)} more photos cannot be read ({', '.join(kinds)}); {how}")
        if not config.images and (elsewhere := photos_elsewhere(source, photos[0].parent)):
            names = ", ".join(printable(str(one.relative_to(source))) for one in elsewhere[:3])
            more = f" and {len(elsewhere) - 3} more" if len(elsewhere) > 3 else ""
            context.progress.say(
                f"not used, outside of {photos[0].parent}: {names}{more}; --images names another folder"
            )
        scene = reconstructed(
            photos, source, partial.checkpoint, context, matching=config.matching, side=config.sfm_side,
            features=config.sfm_features, shared=config.one_camera,
        )  # fmt: skip
        unread = tuple((one.name, "unsupported format; convert it to JPEG or PNG") for one in others)
        return replace(scene, skipped=scene.skipped + unread)
    scene = read_source(source, config.format, config.images)
    also = f" (also found: {', '.join(found.also)}; --format picks another)" if found.also else ""
    context.progress.say(f"found {scene.kind}{also}")
    for remark in scene.remarks:
        context.progress.say(remark)
    return scene


def video_of(source: Path) -> list[Path]:
    """List the clips at `source`; BadInput if there are none, or the name of one is not UTF-8."""
    if clips := clips_of(source):
        for clip in clips:
            check_utf8(clip)
        return clips
    raise BadInput(f"{source} holds no video ({', '.join(VIDEOS)}); give a clip or a folder of clips")


def check_options(config: ImportConfig) -> None:
    """Raise BadInput for options that do not apply to what the source holds."""
    kind = found_in(Path(config.source), config.format).kind
    if kind in ("video", "splats") and config.images:
        raise BadInput(f"--images names a folder of photos; leave it out for {kind}")
    if kind != "splats" and config.cameras:
        raise BadInput(f"--cameras is for splats, and {config.source} holds {kind}; leave it out")
    if kind != "video" and config.frames != FRAMES:
        raise BadInput(f"--frames is for video, and {config.source} holds {kind}; leave it out")


def _of_video(clips: list[Path], config: ImportConfig, partial: PartialArtifact, context: Context) -> SourceScene:
    chosen = frames_as_photos(clips, config.frames, partial.checkpoint / "frames", context)
    scene = reconstructed(
        [photo for photo, _ in chosen], partial.checkpoint / "frames", partial.checkpoint, context,
        matching=config.matching, side=config.sfm_side, features=config.sfm_features, shared=config.one_camera,
        clips=tuple(clip for _, clip in chosen),
    )  # fmt: skip
    return replace(scene, kind="video, by structure from motion")


def import_scene(source: SourceScene, config: ImportConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write the scene from what a reader found or structure from motion reconstructed; return the figures."""
    here, missing = present(source.cameras)
    here, doubled = _without_doubles([replace(one, name=_inside(one.name)) for one in here])
    _report_missing(source, here, missing, context)
    _report_unused_masks(Path(config.source), here, context)
    here = _with_splits(_with_distinct_names(here), config.test_every)
    alike: dict = {}
    photos = [sized(camera, source, alike) for camera in here]
    factors = [scale_of(one.size, config.downscale, config.max_side) for one in photos]
    plain = [scene_camera(one, factor, one.pose) for one, factor in zip(photos, factors, strict=True)]
    background = _develop(photos, plain, config, partial, context)
    try:
        frame = _framed(source, photos, plain, background, config)
        bounds = _bounds(source, frame, background)
    except InvalidValue as error:
        raise BadInput(f"{config.source}: {error}") from error
    context.progress.say(f"layout: {frame.layout.name}, because {frame.layout.reason}")
    depths = _write_truth(partial.path, photos, frame, bounds, context)
    _write_points(partial.path, source, frame.scene_from_source)
    scene = Scene(
        views=tuple(_view(index, *pair) for index, pair in enumerate(zip(photos, frame.cameras, strict=True))),
        layout=frame.layout.name,
        layout_reason=frame.layout.reason,
        bounds=bounds,
        background=background.kind,
        scene_from_source=as_matrix(frame.scene_from_source),
        skipped=tuple(Skipped(printable(one.source), "no such image file") for one in missing)
        + tuple(Skipped(printable(one.source), "listed twice") for one in doubled)
        + tuple(Skipped(printable(name), reason) for name, reason in source.skipped),
        truth=Truth("truth/depth_000.exr" if depths else None),
        sfm=source.sfm,
    )
    write_scene(partial.path, scene)
    return _figures(source, scene, depths)


def _report_missing(source: SourceScene, here: list, missing: list[SourceCamera], context: Context) -> None:
    if missing:
        names = ", ".join(one.source for one in missing[:5]) + (", ..." if len(missing) > 5 else "")
        context.progress.say(f"{len(missing)} of {len(source.cameras)} listed photos have no image file: {names}")
    if len(here) < FEWEST_PHOTOS:
        first = f" (looked for {missing[0].source})" if missing else ""
        raise BadInput(
            f"{len(here)} of {len(source.cameras)} listed photos found{first}; at least {FEWEST_PHOTOS} are needed: "
            "put the photos where the list has them, or name their folder with --images"
        )


def _report_unused_masks(source: Path, here: list[SourceCamera], context: Context) -> None:
    root = source.parent if source.is_file() else source
    if unused := unused_masks(here, root):
        names = ", ".join(printable(path_in_source(one, root)) for one in unused[:3])
        names += ", ..." if len(unused) > 3 else ""
        context.progress.say(
            f"masks not used: {len(unused)} ({sum(bool(one.mask) for one in here)} of {len(here)} photos have one): "
            f"{names}; name a mask after its photo, 001.png for 001.jpg, or give its mask_path"
        )


def _without_doubles(cameras: list[SourceCamera]) -> tuple[list[SourceCamera], list[SourceCamera]]:
    """Split off repeated cameras of a photo: manually merged lists name some photos twice."""
    first: dict[Path, SourceCamera] = {}
    for one in cameras:
        first.setdefault(one.photo.resolve(), one)
    kept = list(first.values())
    return kept, [one for one in cameras if one not in kept]


def _inside(name: str) -> str:
    """Return the name without `..` or control characters: pictures and frames are filed under it."""
    return "/".join(printable(part) for part in Path(name).parts if part not in ("..", "/"))


def _with_distinct_names(cameras: list[SourceCamera]) -> list[SourceCamera]:
    """Give views of one name the suffixes of their photos: IMG_1.JPG and IMG_1.PNG, as some cameras and phones save.

    Raises:
        BadInput: Two views still share a name.
    """
    names = Counter(one.name for one in cameras)
    apart = [one if names[one.name] == 1 else replace(one, name=one.name + one.photo.suffix) for one in cameras]
    first: dict[str, SourceCamera] = {}
    for one in apart:
        if (other := first.setdefault(one.name, one)) is not one:
            raise BadInput(
                f"{other.source} and {one.source} would both be view {one.name}; rename one, on disk and in "
                "the list of poses"
            )
    return apart


def _with_splits(cameras: list[SourceCamera], every: int) -> list[SourceCamera]:
    """Keep the source's split if it has one; otherwise make every `every`-th photo by name a test view."""
    if any(one.split for one in cameras):
        return [replace(one, split=one.split or "train") for one in cameras]
    ordered = sorted(cameras, key=lambda one: natural(one.source))
    return [
        replace(one, split="test" if every and index % every == 0 else "train") for index, one in enumerate(ordered)
    ]


def _develop(
    photos: list[Sized], cameras: list[Camera], config: ImportConfig, partial: PartialArtifact, context
) -> Background:
    """Write images/NNN.png; return what they reveal about the background."""
    developer, background = Developer(), Background(config.background)

    def develop(job: tuple[int, Sized, Camera]) -> Evidence:
        index, one, camera = job
        pixels = developer.picture(one, (camera.width, camera.height))
        found = evidence_of(pixels)
        write_png(partial.path / _image(index), to_uint8(background.shown(pixels)))
        return found

    context.progress.start("import", len(photos), "photo")
    jobs = ((index, *pair) for index, pair in enumerate(zip(photos, cameras, strict=True)))
    # As many at once as fit in memory: decoding is half of the work, compressing most of the rest; codecs use one core.
    takes = DEVELOPING_BYTES * max(one.size[0] * one.size[1] for one in photos)
    at_once = max(1, min(context.threads, allowance() // takes))
    for done, found in enumerate(in_order(develop, jobs, at_once), start=1):
        background.seen(found)
        context.progress.update(done)
    context.progress.finish()
    background.decide()
    if background.remark:
        context.progress.say(background.remark)
    return background


def _framed(source: SourceScene, photos: list[Sized], plain: list[Camera], background: Background, config) -> Frame:
    poses = np.array([one.pose for one in photos])
    near_far = np.array([one.camera.near_far for one in photos]) if photos[0].camera.near_far else None
    points = None if source.points is None else source.points.xyz
    scene_normalization.check_baseline(poses, near_far, points)
    layout = scene_normalization.decided_layout(poses, background.cuts_out)
    if config.layout != "auto":
        layout = scene_normalization.Layout(config.layout, "it was requested")
    if layout.name == "object" and source.keeps_frame and background.kind == "alpha":
        similarity = np.eye(4)
    elif layout.name == "forward":
        near, known = scene_normalization.nearest_depth(poses, near_far, points)
        layout = replace(layout, reason=f"{layout.reason}; nearest depth from {known}")
        similarity = scene_normalization.facing(poses, near)
    else:
        similarity = scene_normalization.centered(poses)
    cameras = [
        replace(camera, world_from_camera=scene_normalization.moved(one.pose, similarity))
        for one, camera in zip(photos, plain, strict=True)
    ]
    return Frame(layout, similarity, cameras, [one.split for one in photos])


def _bounds(source: SourceScene, frame: Frame, background: Background) -> Bounds:
    scale = float(np.cbrt(np.linalg.det(frame.scene_from_source[:3, :3])))
    if frame.layout.name == "unbounded":
        box = np.array([[-1.0] * 3, [1.0] * 3])
        near, far = scene_normalization.UNBOUNDED_NEAR, scene_normalization.UNBOUNDED_FAR
    elif frame.layout.name == "forward":
        depths = [one.near_far[1] for one in source.cameras if one.near_far]
        near, far = 1.0, max(depths) * scale if depths else scene_normalization.UNBOUNDED_FAR
        box = scene_normalization.frustum_box(frame.cameras, near, max(far, 2 * near))
        far = max(far, 2 * near)
    else:
        box = _object_box(frame, background)
        near, far = scene_normalization.depths_of_box(frame.cameras, box)
    (x0, y0, z0), (x1, y1, z1) = np.asarray(box, float).tolist()
    return Bounds(((x0, y0, z0), (x1, y1, z1)), float(near), float(far))


def _object_box(frame: Frame, background: Background) -> np.ndarray:
    poses = np.array([camera.world_from_camera for camera in frame.cameras])
    focus = scene_normalization.focus_of(poses)
    distance = float(np.median(np.linalg.norm(poses[:, :3, 3] - focus, axis=1)))
    if not background.cuts_out:
        return np.stack([focus - distance / 2, focus + distance / 2])
    train = [index for index, split in enumerate(frame.splits) if split == "train"] or range(len(frame.cameras))
    cameras, silhouettes = [frame.cameras[i] for i in train], [background.silhouettes()[i] for i in train]
    return hull_box(cameras, silhouettes, np.stack([focus - distance, focus + distance]))


def _write_truth(folder: Path, photos: list[Sized], frame: Frame, bounds: Bounds, context: Context) -> int:
    """Write known planar depths to truth/, in scene units and at the pictures' size; return how many."""
    scale = float(np.cbrt(np.linalg.det(frame.scene_from_source[:3, :3])))
    written = 0
    for index, (one, camera) in enumerate(zip(photos, frame.cameras, strict=True)):
        if one.camera.depth is None:
            continue
        if not one.camera.distortion.none:
            context.progress.say("known depths are ignored: their photos are distorted")
            return 0
        depth = read_depth(one.camera.depth)
        if depth.shape != one.size[::-1]:
            raise BadInput(
                f"{one.camera.depth} is {depth.shape[1]}x{depth.shape[0]} but its photo is "
                f"{one.size[0]}x{one.size[1]}; make them the same size"
            )
        write_exr(folder / "truth" / f"depth_{index:03d}.exr", _depth_view(depth, scale, camera, bounds))
        written += 1
    return written


def _depth_view(depth: np.ndarray, scale: float, camera: Camera, bounds: Bounds) -> ExrView:
    depth = nearest(depth, (camera.width, camera.height))
    hit = (depth > 0) & (depth < FAR_Z / 10)
    z = np.where(hit, depth * scale, FAR_Z).astype(np.float32)
    return ExrView(
        np.zeros((*z.shape, 3), np.float32), hit.astype(np.float32), z, z / camera.ray_cosines(),
        camera.world_from_camera, (camera.fx, camera.fy, camera.cx, camera.cy), bounds.near, bounds.far,
    )  # fmt: skip


def _write_points(folder: Path, source: SourceScene, scene_from_source: np.ndarray) -> None:
    points = source.points
    if points is None:
        return
    xyz = (points.xyz @ scene_from_source[:3, :3].T + scene_from_source[:3, 3]).astype(np.float32)
    kept = np.isfinite(xyz).all(axis=1)
    tensors = {"xyz": xyz[kept], "rgb": points.rgb[kept], "error": points.error[kept]}
    save_tensors(folder / POINTS_FILE, tensors)


def _image(index: int) -> str:
    return f"images/{index:03d}.png"


def _view(index: int, one: Sized, camera: Camera) -> View:
    return View(
        name=camera.name, image=_image(index), split=one.split, width=camera.width, height=camera.height,
        fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy,
        world_from_camera=as_matrix(camera.world_from_camera), source=one.camera.source, lens=_lens(one),
    )  # fmt: skip


def _lens(one: Sized) -> Lens:
    lens = one.camera.distortion
    stored = LensDistortion(lens.kind, lens.radial, lens.tangential, lens.denominator, lens.others)
    return Lens(*one.size, *one.intrinsics, stored)


def _figures(source: SourceScene, scene: Scene, depths: int) -> dict:
    widths = sorted({(view.width, view.height) for view in scene.views})
    return {
        "format": source.kind,
        "views": len(scene.views),
        "train": len(scene.split("train")),
        "test": len(scene.split("test")),
        "skipped": [one.source for one in scene.skipped],
        "skipped_why": sorted({one.reason for one in scene.skipped}),
        "sizes": [f"{width}x{height}" for width, height in widths],
        "layout": scene.layout,
        "layout_reason": scene.layout_reason,
        "background": scene.background,
        "aabb": scene.bounds.aabb,
        "near": scene.bounds.near,
        "far": scene.bounds.far,
        "points": 0 if source.points is None else len(source.points.xyz),
        "truth_depths": depths,
        "sfm": source.sfm,
        "filter": "Catmull-Rom where undistorted, then area average; sRGB code values times alpha",
    }
