"""Render a field from the scene's views or along a camera path, as EXR, PNG and video.

Roles of the inputs: `scene`, `field`, and `region.<name>` for every region whose mask is written. What compositors get
beyond plain frames is in stages/compositing: color spaces, deep samples, plates and ST maps.
"""

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

from schemas.deep_exr import write_deep_exr
from schemas.errors import ArtifactDamaged, BadInput, NoVideo, StylerfError
from schemas.exr import write_exr
from schemas.frames import Frame, FrameCamera, Frames, write_frames
from schemas.images import to_uint8, write_png
from schemas.journal import Journal
from schemas.scene import Bounds, LensDistortion, as_matrix
from schemas.video import try_video, write_video
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.camera_files import digest_of_cameras, read_cameras
from stages.artifacts.camera_shots import Shot, shots_along
from stages.artifacts.field import load_field
from stages.artifacts.region import CHANNEL, channels_of, regions_among
from stages.artifacts.scene import SceneData, load_scene
from stages.artifacts.shards import take_frames
from stages.compositing import StMaps, deep_samples, exr_view, map_files, plate_camera, write_st_maps
from stages.configs.render import OWN_VIEWS, RenderConfig
from stages.run.devices import gpu_figures, gpu_of
from stages.run.parallel import in_order
from stages.run.progress import Context, Progress
from stages.run.runner import Spec
from stylerf.errors import InvalidValue
from stylerf.fields.blended_color import BlendedColor
from stylerf.fields.blending import at_strength
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.camera_paths import PATHS
from stylerf.geometry.cameras import Camera
from stylerf.geometry.lens_camera import LensCamera
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.rendering.deep import DeepCollector, DeepView
from stylerf.rendering.view import RenderedView, depth_picture, displacement_picture, render_view

SPEC = Spec(
    stage="render", verb="render", revision=6, writes="frames",
    outside=lambda config: {"path_digest": digest_of_cameras(Path(config.path))} if config.path_digest else {},
)  # fmt: skip
Rendered = tuple[RenderedView, DeepView | None]
Renderer = Callable[[Camera, Mapping[str, np.ndarray]], Rendered]
WRITTEN_AT_ONCE = 2  # frames; each holds its planes in memory until it is on disk


def run(inputs: dict[str, Artifact], config: RenderConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write frames.json, png/, and on request exr/, deep/, st_maps/, masks/, depth/, displacement/ and a video.

    Frames on disk, from an interrupted run or a shard in the work folder, are not rendered again.
    """
    scene = load_scene(inputs["scene"])
    field, background = _field_at_strength(inputs, config.strength)
    threads = set_threads(context.threads)
    shots = shots_of(scene, config)
    if config.path not in (*OWN_VIEWS, *PATHS):
        for remark in read_cameras(Path(config.path), scene).remarks:
            context.progress.say(remark)
    if config.video:
        _check_video(config, shots)
    regions = regions_among(inputs, field.space) if config.shows_regions else {}
    name = inputs["field"].name
    _check_field(name, field, config, regions, context)
    channels = channels_of(regions)
    maps = _st_maps(scene) if config.st_map else {}
    along = Path(config.path).name if context.no_paths else config.path
    attributes = {"field": name, "fieldDigest": inputs["field"].digest, "path": along}
    if config.strength != 1:
        attributes["strength"] = f"{config.strength:g}"
    attributes |= {CHANNEL + channels[name]: f"{name} {regions[name].digest}" for name in channels}
    cells = {name: region.cells for name, region in regions.items()}
    listed = tuple(_frame_of(camera, view, config, maps.get(camera.name)) for camera, view in shots)
    journal = Journal(partial.checkpoint / "frames.jsonl", partial.path)
    taken = {} if context.rebuild or config.frames else take_frames(partial, listed, journal)
    if taken:
        count = sum(map(len, taken.values()))
        context.progress.say(f"reusing {count} of {len(shots)} frames from {', '.join(taken)}")
    context.progress.start("render", len(shots), "frame")
    device = gpu_of(context, field)
    if device and config.deep:
        context.progress.say("--deep: rendering on the CPU, as only the CPU keeps the samples of each ray")
        device = None
    renderer = _gpu_renderer(field, device, scene.cameras[0]) if device else _cpu_renderer(field, config, threads)

    def write(frame: Frame, camera: Camera, rendered: Rendered) -> None:
        _write(partial.path, frame, *rendered, camera, field, background, scene.bounds, config, attributes)

    with nullcontext() if device else compiling_note(context.progress.say):
        _render_missing(
            [(frame, camera) for frame, (camera, _) in zip(listed, shots, strict=True)],
            journal,
            lambda frame: _files_of(frame, config, field, cells),
            lambda frame, camera: render_frame(renderer, frame, camera, cells, name),
            write,
            context.progress,
        )
    context.progress.finish()
    if maps:
        shown = {camera.name for camera, _ in shots}
        used = {index: maps[view.name] for index, view in enumerate(scene.views) if view.name in shown}
        write_st_maps(partial.path, scene, used)
    masks = channels if config.exr else {}
    fps = config.fps if config.video or config.path not in OWN_VIEWS else None
    write_frames(partial.path, Frames(name, along, listed, fps, masks))
    reused = {name for names in taken.values() for name in names}
    return {
        "frames": len(listed),
        "pixels": int(sum(c.width * c.height for c, _ in shots if c.name not in reused)),
        "video": _video(partial.path, [f.png for f in listed], config, context) if config.video else None,
    } | gpu_figures(device)


def _check_video(config: RenderConfig, shots: list[Shot]) -> None:
    """Raise BadInput if the frames cannot be a video, before any is rendered."""
    sizes = sorted({(camera.width, camera.height) for camera, _ in shots})
    if len(sizes) > 1:
        sizes_text = " and ".join(f"{width}x{height}" for width, height in sizes[:: len(sizes) - 1])
        raise BadInput(
            f"--video: frames along {config.path} differ in size ({sizes_text}); render them without --video"
        )
    try_video(*sizes[0], config.fps)


def _check_field(
    name: str, field: RadianceField, config: RenderConfig, regions: Mapping[str, object], context: Context
) -> None:
    """Raise BadInput for what the named field cannot show; report what will be missing."""
    if config.cryptomatte and not regions:
        raise BadInput(
            f"--cryptomatte: no region was selected in the space of field {name}; select one with `stylerf select`"
        )
    if config.deep and isinstance(field.color, BlendedColor):
        raise BadInput(f"--deep: field {name} is a blend, whose samples have no individual colors")
    if config.displacement and field.displacement is None:
        context.progress.say(f"field {name} has no deformation; --displacement writes nothing")
    if config.masks and not regions:
        context.progress.say(f"no region was selected in the space of field {name}; --masks writes nothing")


def _render_missing(
    frames: list[tuple[Frame, Camera]],
    journal: Journal,
    files_of: Callable[[Frame], list[str]],
    render: Callable[[Frame, Camera], Rendered],
    write: Callable[[Frame, Camera, Rendered], None],
    progress: Progress,
) -> None:
    """Render and write the frames whose files the journal does not hold, and record them."""
    recording = threading.Lock()

    def write_and_record(job: tuple[Frame, Camera, Rendered | None]) -> None:
        frame, camera, rendered = job
        if rendered is None:
            return
        write(frame, camera, rendered)
        # Here, in the thread: an interrupted render waits for it and must not lose the frame.
        with recording:
            journal.add(files_of(frame))

    def rendered_frames() -> Iterator[tuple[Frame, Camera, Rendered | None]]:
        for frame, camera in frames:
            with recording:
                held = journal.holds(files_of(frame))
            yield frame, camera, None if held else render(frame, camera)

    # A frame is written while the next one is rendered: codecs use one core, and the disk none.
    for done, _ in enumerate(in_order(write_and_record, rendered_frames(), WRITTEN_AT_ONCE), start=1):
        progress.update(done)


def _field_at_strength(inputs: Mapping[str, Artifact], strength: float) -> tuple[RadianceField, str]:
    """Return the field to render, between its source and itself, and its background."""
    field, background = load_field(inputs["field"])
    if "source" not in inputs:
        return field, background
    source, _ = load_field(inputs["source"])
    try:
        return at_strength(source, field, strength), background
    except InvalidValue as error:
        raise BadInput(
            f"--strength {strength:g} of {inputs['field'].path} from {inputs['source'].name}: {error}"
        ) from error


def _cpu_renderer(field: RadianceField, config: RenderConfig, threads: int) -> Renderer:
    def render(camera: Camera, regions: Mapping[str, np.ndarray]) -> Rendered:
        if not config.deep:
            return render_view(field, camera, threads=threads, regions=regions), None
        deep = DeepCollector(field, camera, config.deep_samples, threads)
        return render_view(field, camera, threads=threads, regions=regions, on_rendered=deep.add), deep.view()

    return render


def _gpu_renderer(field: RadianceField, device: str, camera: Camera) -> Renderer:
    from stylerf.rendering.view_gpu import GpuRenderer

    renderer = GpuRenderer(field, device)
    renderer.choose(camera)  # once for all frames, so that shards and resumed runs make the same decision
    return lambda camera, regions: (renderer.view(camera, regions=regions), None)


def _st_maps(scene: SceneData) -> dict[str, StMaps]:
    """By view's name, for all views of the scene, so that shards number lenses alike."""
    return {scene.views[view].name: maps for view, maps in map_files(scene, range(len(scene.views))).items()}


def pinned(config: RenderConfig) -> RenderConfig:
    """Add the digest of the camera file, so that changes are noticed; set count to 1 for paths of fixed length."""
    if config.path in PATHS:
        return replace(config, path_digest="")
    path = Path(config.path)
    known = config.path in OWN_VIEWS or not path.exists()
    return replace(config, count=1, path_digest="" if known else digest_of_cameras(path))


def shots_of(scene: SceneData, config: RenderConfig) -> list[Shot]:
    """Return the cameras to render, each with the index of the scene's view it repeats, or None."""
    shots = shots_along(scene, config.path, config.count, config.frames)
    if config.plate:  # the views' cameras, but not their pictures
        return [(plate_camera(scene, view).scaled(config.scale), None) for _, view in shots if view is not None]
    return [(camera.scaled(config.scale), view if config.scale == 1 else None) for camera, view in shots]


def _frame_of(camera: Camera, view: int | None, config: RenderConfig, maps: StMaps | None = None) -> Frame:
    name, pose = camera.name, as_matrix(camera.world_from_camera)
    lens = camera.distortion if isinstance(camera, LensCamera) else None
    distortion = (
        LensDistortion(lens.kind, lens.radial, lens.tangential, lens.denominator, lens.others) if lens else None
    )
    entry = FrameCamera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, pose, distortion)
    exr, png = f"exr/{name}.exr" if config.exr else "", f"png/{name}.png"
    undistort, redistort = (maps.undistort, maps.redistort) if maps else ("", "")
    return Frame(name, exr, png, entry, view, undistort, redistort)


def _files_of(frame: Frame, config: RenderConfig, field: RadianceField, regions: Mapping) -> list[str]:
    """Return every file that _write writes for a frame."""
    folders = [f"masks/{region}" for region in regions] if config.masks else []
    folders += ["depth"] if config.depth else []
    folders += ["displacement"] if config.displacement and field.displacement is not None else []
    own = [*filter(None, [frame.exr]), *([f"deep/{frame.name}.exr"] if config.deep else [])]
    return [*own, *(f"{folder}/{frame.name}.png" for folder in folders), frame.png]


def render_frame(renderer: Renderer, frame: Frame, camera: Camera, regions: Mapping, field: str) -> Rendered:
    """Render a frame of the named field; ArtifactDamaged if it has NaN or infinite values."""
    rendered, deep = renderer(camera, regions)
    if not all(np.isfinite(plane).all() for plane in (rendered.rgb, rendered.alpha, rendered.z)):
        raise ArtifactDamaged(
            f"field {field} renders NaN or infinite values in frame {frame.name}, although its parameters are valid; "
            "rebuild it"
        )
    return rendered, deep


def _write(
    folder: Path,
    frame: Frame,
    rendered: RenderedView,
    deep: DeepView | None,
    camera: Camera,
    field: RadianceField,
    background: str,
    bounds: Bounds,
    config: RenderConfig,
    attributes: Mapping[str, str],
) -> None:
    name = frame.name
    if config.exr or deep:
        flat = exr_view(rendered, camera, bounds, attributes, config)
        if config.exr:
            write_exr(folder / frame.exr, flat)
        if deep:
            write_deep_exr(folder / f"deep/{name}.exr", flat, deep_samples(deep, flat))
    if config.masks:
        for region, mask in rendered.masks.items():
            write_png(folder / f"masks/{region}/{name}.png", to_uint8(mask))
    if config.depth:
        write_png(folder / f"depth/{name}.png", depth_picture(rendered.z, rendered.alpha))
    if config.displacement and field.displacement is not None:
        write_png(folder / f"displacement/{name}.png", displacement_picture(field, camera, rendered))
    level = 1.0 if background == "white" else 0.0
    rgb = rendered.rgb + (1 - rendered.alpha[..., None]) * np.float32(level)
    write_png(folder / frame.png, to_uint8(np.clip(rgb, 0, 1)))


def _video(folder: Path, pictures: list[str], config: RenderConfig, context: Context) -> str:
    try:
        path, how = write_video(folder / "video", [folder / p for p in pictures], config.fps)
    except (StylerfError, MemoryError):
        raise
    except Exception as error:
        raise NoVideo(
            f"--video: writing the video failed ({type(error).__name__}: {error}); the frames are kept in {folder}: "
            "run the same command to try again"
        ) from error
    context.progress.say(f"video: {path.name}, written by {how}")
    return path.name
