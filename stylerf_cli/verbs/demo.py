"""`stylerf demo`: the whole path on an embedded scene, with nothing but the install."""

from contextlib import suppress
from pathlib import Path

from schemas.errors import BadInput, UsageError
from schemas.work_folder import WorkFolder
from stages.configs.demo import DemoConfig

NAME = "demo"
HELP = "the whole path on an embedded scene: photos, fit, painting, film, report"
CONFIG = DemoConfig
NAMELESS = "a demo's artifacts have names of their own"
MARGIN = 4  # pixels around the object on the contact sheet


def add_arguments(parser) -> None:
    """WORK."""
    parser.add_argument(
        "work", metavar="WORK", nargs="?", default="stylerf-demo", help="the work folder (default: stylerf-demo)"
    )


def run(args, session) -> dict:
    """Places of the contact sheet, the report and the film."""
    from schemas.canonical_json import file_sha256
    from stages import deform_init, evaluate, nerf_fit, pose_import, render, stylize
    from stages.configs.deform import DeformConfig
    from stages.configs.evaluate import EvaluateConfig
    from stages.configs.fit import FitConfig
    from stages.configs.render import RenderConfig
    from stages.configs.stylize import StylizeConfig
    from stages.pipeline import demo_scene
    from stages.weights.resolve import chosen
    from stylerf_cli.verbs.import_ import config_for

    session.own_verbs = {"import", "fit", "deform", "stylize", "render", "eval"}
    config, work = session.config, session.work
    photos = work.root / "photos"
    refuse_others(work, photos)
    context, features = session.context, chosen("")
    demo_scene.write_demo(
        photos, config.size, config.train_views, config.test_views, context.seed, context.threads, session.progress
    )
    scene = session.run(pose_import.SPEC, pose_import.run, {}, config_for(photos), "main")
    fit = session.run(
        nerf_fit.SPEC, nerf_fit.run, {"scene": scene}, FitConfig(budget=config.fit_budget, buffers=False), "fit"
    )
    painting = photos / demo_scene.PAINTING
    style = StylizeConfig(
        style=str(painting.resolve()),
        style_digest=file_sha256(painting),
        budget=config.style_budget,
        method=config.method,
        # Plain shapes in small photos bear large strokes, and stay recognizable without being held hard.
        coarse=0.5,
        style_scale=2.0,
        color_weight=3.0,
        content_weight=5e-3,
        **features,
    )
    shaped = fit
    if config.method == "desrf":
        options = {"scene": scene, "field": fit}
        shaped = session.run(deform_init.SPEC, deform_init.run, options, DeformConfig(steps=200), "fit-deformed")
    inputs = {"scene": scene, "field": shaped}
    stylized = session.run(stylize.SPEC, stylize.run, inputs, style, f"painting-{config.method}")

    def frames(field, path: str, **options):
        wanted = RenderConfig(path=path, **options)
        return session.run(render.SPEC, render.run, {"scene": scene, "field": field}, wanted, f"{field.name}-{path}")

    fit_test, style_test = frames(fit, "test"), frames(stylized, "test")
    film = frames(stylized, "orbit", count=config.frames, video=True, fps=12.0)
    fit_report = session.run(
        evaluate.SPEC, evaluate.run, {"scene": scene, "field": fit, "frames": fit_test}, EvaluateConfig(), fit.name
    )
    report = session.run(
        evaluate.SPEC,
        evaluate.run,
        {"scene": scene, "field": stylized, "frames": style_test, "base_frames": fit_test, "path_frames": film},
        EvaluateConfig(),
        stylized.name,
    )
    sheet = write_sheet(work.root / "contact-sheet.png", photos, fit_test, style_test)
    result = {
        "sheet": sheet,
        "report": report.path / "report.html",
        "fit_report": fit_report.path / "report.html",
        "film": film.path / film.manifest.figures["video"],
        "psnr": fit_report.manifest.figures["psnr"],
    }
    words = [
        f"held-out views: {result['psnr']:.2f} dB after {config.fit_budget}",
        f"contact sheet: {result['sheet']}",
        f"report:        {result['report']}",
        f"fit report:    {result['fit_report']}",
        f"film:          {result['film']}",
    ]
    return session.emit(result, words)


def refuse_others(work: WorkFolder, photos: Path) -> None:
    """UsageError where there are photos or a scene that the demo would replace and has not made."""
    from stages.pipeline.demo_scene import STAMP
    from stages.readers.digest import digest_of_source

    sources = {"source": str(photos.resolve())}
    if (photos / STAMP).is_file():
        with suppress(BadInput):  # photos that a stopped demo left unfinished
            sources["source_digest"] = digest_of_source(photos)  # they may have been moved
    elif photos.is_dir() and any(photos.iterdir()):
        raise UsageError(f"{photos} is not the demo's, which would write there; give the demo another work folder")
    for scene in work.artifacts("scene"):
        made = scene.manifest
        if made.stage != "distill" and not any(made.config.get(key) == value for key, value in sources.items()):
            raise UsageError(f"{scene.path} is not the demo's, which would replace it; give the demo another folder")


def write_sheet(path: Path, photos: Path, fit, stylized) -> Path:
    """Held-out photos, their renders and the stylized renders one under another, the painting at the side.

    Pictures are cut to what the object fills in any of them.
    """
    import numpy as np

    from schemas.frames import read_frames
    from schemas.images import read_image, to_uint8, write_png
    from stages.pipeline.demo_scene import PAINTING
    from stylerf.rendering.visualization import sheet_of

    shown = read_frames(fit.path).views[:4]
    taken = [read_image(photos / "test" / f"{view.name}.png").pixels for view in shown]
    filled = np.max([photo[..., 3] for photo in taken], 0) > 0
    box = tuple(slice(max(0, at.min() - MARGIN), at.max() + 1 + MARGIN) for at in np.nonzero(filled))
    rows = [[(p[..., :3] * p[..., 3:] + 1 - p[..., 3:])[box] for p in taken]]
    for frames in (fit, stylized):
        rows.append([read_image(frames.file(view.png)).pixels[box] for view in read_frames(frames.path).views[:4]])
    write_png(path, to_uint8(sheet_of(rows, read_image(photos / PAINTING).pixels)))
    return path
