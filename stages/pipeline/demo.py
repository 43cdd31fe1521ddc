"""The demo: every stage on a procedural still life, without any input files."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from schemas.errors import BadInput, UsageError
from schemas.work_folder import Artifact, WorkFolder
from stages.configs.demo import DemoConfig
from stages.configs.evaluate import EvaluateConfig
from stages.configs.render import RenderConfig
from stages.pipeline.stage_runner import Request, StageRunner

MARGIN = 4  # pixels around the object on the contact sheet


@dataclass(frozen=True)
class Demo:
    """The demo's results. sheet: the contact sheet, a PNG."""

    sheet: Path
    report: Artifact
    fit_report: Artifact
    video: Artifact


def run_demo(runner: StageRunner, config: DemoConfig, force: bool) -> Demo:
    """Import, fit, stylize, render and evaluate the still life.

    Raises:
        UsageError: the work folder contains photos or a scene that the demo did not create.
    """
    from schemas.canonical_json import file_sha256
    from stages import deform_init, evaluate, nerf_fit, pose_import, render, stylize
    from stages.configs.deform import DeformConfig
    from stages.configs.fit import FitConfig
    from stages.configs.stylize import CONFIGS
    from stages.pipeline import demo_scene
    from stages.pipeline.prerequisites import import_config
    from stages.weights.resolve import chosen

    request = Request(force=force)

    def made(stage: Any, inputs: dict[str, Artifact], options: Any, name: str) -> Artifact:
        return runner.run(stage.SPEC, stage.run, inputs, options, name, request)

    photos = runner.work.root / "photos"
    refuse_others(runner.work, photos)
    features: dict[str, Any] = chosen("")
    threads = runner.context.threads
    demo_scene.write_demo(
        photos, config.size, config.train_views, config.test_views, runner.seed, threads, runner.progress
    )
    scene = made(pose_import, {}, import_config(photos), "main")
    fit = made(nerf_fit, {"scene": scene}, FitConfig(budget=config.fit_budget, buffers=False), "fit")
    style = photos / demo_scene.PAINTING
    look = CONFIGS[config.method](
        style=str(style.resolve()),
        style_digest=file_sha256(style),
        budget=config.style_budget,
        # Plain shapes in small photos take large strokes, and stay recognizable without a strong content loss.
        coarse=0.5,
        style_scale=2.0,
        color_weight=3.0,
        content_weight=5e-3,
        **features,
    )
    start = fit
    if config.method == "desrf":
        start = made(deform_init, {"scene": scene, "field": fit}, DeformConfig(steps=200), "fit-deformed")
    stylized = made(stylize, {"scene": scene, "field": start}, look, f"painting-{config.method}")

    def frames(field: Artifact, path: str, **options: Any) -> Artifact:
        wanted = render.pinned(RenderConfig(path=path, **options))
        return made(render, {"scene": scene, "field": field}, wanted, f"{field.name}-{path}")

    fit_test, style_test = frames(fit, "test"), frames(stylized, "test")
    video = frames(stylized, "orbit", count=config.frames, video=True, fps=12.0)
    inputs = {"scene": scene, "field": fit, "frames": fit_test}
    fit_report = made(evaluate, inputs, evaluate.pinned(EvaluateConfig(), fit), fit.name)
    inputs = {"scene": scene, "field": stylized, "frames": style_test, "base_frames": fit_test, "path_frames": video}
    report = made(evaluate, inputs, evaluate.pinned(EvaluateConfig(), stylized), stylized.name)
    sheet = runner.work.root / "contact-sheet.png"
    _write_sheet(sheet, photos, fit_test, style_test)
    return Demo(sheet, report, fit_report, video)


def refuse_others(work: WorkFolder, photos: Path) -> None:
    """Raise UsageError if the demo would replace photos or a scene that it did not create."""
    from stages.pipeline.demo_scene import STAMP
    from stages.pose_import import digest_of_source

    sources = {"source": str(photos.resolve())}
    if (photos / STAMP).is_file():
        with suppress(BadInput):  # photos of an interrupted demo
            sources["source_digest"] = digest_of_source(photos)  # the folder may have been moved
    elif photos.is_dir() and any(photos.iterdir()):
        raise UsageError(
            f"{photos} was not created by the demo, which would overwrite it; give the demo another work folder"
        )
    for scene in work.artifacts("scene"):
        made = scene.manifest
        if made.stage != "distill" and not any(made.config.get(key) == value for key, value in sources.items()):
            raise UsageError(
                f"{scene.path} was not created by the demo, which would replace it; give the demo another work folder"
            )


def _write_sheet(path: Path, photos: Path, fit: Artifact, stylized: Artifact) -> None:
    """Write rows of held-out photos, renders and stylized renders, cropped to the object, beside the style image."""
    import numpy as np

    from schemas.frames import read_frames
    from schemas.images import read_image, to_uint8, write_png
    from stages.pipeline.demo_scene import PAINTING
    from stylerf.rendering.view import sheet_of

    views = read_frames(fit.path).views[:4]
    taken = [read_image(photos / "test" / f"{view.name}.png").pixels for view in views]
    filled = np.max([photo[..., 3] for photo in taken], 0) > 0
    box = tuple(slice(max(0, at.min() - MARGIN), at.max() + 1 + MARGIN) for at in np.nonzero(filled))
    rows = [[(p[..., :3] * p[..., 3:] + 1 - p[..., 3:])[box] for p in taken]]
    for frames in (fit, stylized):
        rows.append([read_image(frames.file(view.png)).pixels[box] for view in read_frames(frames.path).views[:4]])
    write_png(path, to_uint8(sheet_of(rows, read_image(photos / PAINTING).pixels)))
