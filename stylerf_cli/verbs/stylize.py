"""`stylerf stylize WORK --style IMAGE`: the scene, or with --region a part of it, in a painting's strokes; or, with
--method palettenerf, the scene in other colors of its own palette."""

import re
import shlex
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from schemas.errors import ArtifactDamaged, ArtifactStale, UsageError
from stages.configs.decompose import METHOD, DecomposeConfig, PaletteFieldConfig
from stages.configs.region import RegionConfig
from stages.configs.stylize import StylizeConfig
from stages.configs.views import file_of

NAME = "stylize"
HELP = "stylize the whole scene or a region of it, or change its palette"
CONFIG = StylizeConfig
CONFIGS = (StylizeConfig, RegionConfig, PaletteFieldConfig)
WITHIN = "refnpr"  # the method that stylizes a region as it does a scene; else a region's look is LAENeRF's
LONGEST_NAME = 60  # of a painting: what is made with it adds to it


def options_for(argv: list[str]) -> type:
    """The options of a region, and of a palette of the whole scene, are others than those of a painting."""
    given = [(flag, value) for one in argv for flag, equals, value in [one.partition("=")] if equals] + [
        *pairwise(argv)
    ]
    method = next((value for flag, value in given if flag == "--method"), "")
    if any(one.partition("=")[0] == "--region" for one in argv):
        if method not in ("", WITHIN):
            raise UsageError(
                f"--method {method} is for the whole scene; a --region takes --method {WITHIN} (after a stylized view) "
                "or none (LAENeRF)"
            )
        return StylizeConfig if method else RegionConfig
    return PaletteFieldConfig if method == METHOD else StylizeConfig


def add_arguments(parser) -> None:
    """WORK, --of, --region."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument(
        "--of",
        metavar="FIELD",
        help="field to stylize (default: the fitted one; of a region the one it was selected in)",
    )
    parser.add_argument(
        "--region",
        metavar="REGION",
        help="recolor (--recolor) or stylize a region alone (with --method refnpr: after stylized views of it); "
        "`stylerf stylize --region NAME --help` tells its options, `stylerf stylize --method palettenerf --help` those "
        "of a palette of the whole scene",
    )


def run(args, session) -> dict:
    """The stylized field's, or the edit's, place and figures."""
    if isinstance(session.config, RegionConfig):
        return _region(args, session)
    return _palette(args, session) if isinstance(session.config, PaletteFieldConfig) else _whole(args, session)


def _whole(args, session) -> dict:
    from stages import stylize
    from stages.artifacts import references
    from stages.artifacts.scene import load_scene
    from stages.pipeline.local_edit import region_of
    from stages.pipeline.prerequisites import ensure_deformed, ensure_field, scene_of_work, teaching_pictures

    # Refused before hours of upstream work, not after them.
    config, name = _pinned_whole(session.config)
    scene, more = scene_of_work(session), {}
    if config.method == "refnpr":
        references.checked(load_scene(scene), config)
    if args.region is None:
        field = ensure_field(session, scene, args.of)
    else:
        region = region_of(session, args.region)
        field = _field_of(region, args, session)
        more, name = {"region": region}, f"{region.name}-{name}"
        if config.match in ("after", "both"):
            raise UsageError(f"--match {config.match} maps every pixel; of a region colors are matched before, or not")
    scene = teaching_pictures(session, field)
    if config.method == "desrf":
        field = ensure_deformed(session, scene, field)
    name = f"{name}-{config.method}"
    tell_replaced(session, "field", name, config)
    made = session.run(stylize.SPEC, stylize.run, {"scene": scene, "field": field, **more}, config, name)
    figures = made.manifest.figures
    result = {"field": made.path, "name": made.name, "figures": figures, "seconds": made.manifest.seconds}
    words = (
        f"field {made.name}: {figures['steps']} style steps over {figures['views']} views in "
        f"{figures['train_seconds']:.0f} s, features {figures['features']['name']}"
    )
    return session.emit(result, [words, f"  {made.path}"])


def _pinned_whole(config: StylizeConfig) -> tuple[StylizeConfig, str]:
    """The options with the digests of the files that they name, which can be read; and the name of the painting."""
    from schemas.canonical_json import file_sha256
    from stages.artifacts.references import digest_of
    from stages.artifacts.style_images import read_painting
    from stages.weights.resolve import chosen

    pairs = [file_of(text) for text in config.reference]
    config = replace(config, references_digest=digest_of(config.reference), **chosen(config.features),
                     reference=tuple(f"{view}={file.resolve()}" for view, file in pairs))  # fmt: skip
    if not config.style:
        return config, name_of(pairs[0][1])
    style = painting_of(config.style)
    read_painting(style)
    return replace(config, style=str(style.resolve()), style_digest=file_sha256(style)), name_of(style)


def _palette(args, session) -> dict:
    from stages.pipeline.prerequisites import (
        ensure_field,
        palette_changed,
        palette_learned,
        pictures_of,
        scene_of_work,
        teaching_pictures,
    )

    config = session.config
    field = ensure_field(session, scene_of_work(session), args.of)
    if field.manifest.stage in ("decompose", "recolor"):
        if config.learning != DecomposeConfig():
            raise UsageError(f"field {field.name} has its palette already; options of learning one mean nothing here")
        if not config.changes:
            raise UsageError(f"field {field.name} has its palette already; change it by --palette I=#rrggbb")
        made = palette_changed(session, pictures_of(session, field), field, config.changes)
    else:
        scene = teaching_pictures(session, field)
        made = palette_learned(session, scene, field, config.learning, config.changes)
    figures, seconds = made.manifest.figures, made.manifest.seconds
    result = {"field": made.path, "name": made.name, "figures": figures, "seconds": seconds}
    return session.emit(result, told_palette(made, "field"))


def _field_of(region, args, session):
    """The field that a region was selected in; UsageError where --of names another."""
    from stages.pipeline.prerequisites import input_of

    own = input_of(session, region, "field", "field")
    if args.of and (field := session.work.find("field", args.of)).digest != own.digest:
        anew = shlex.join(["stylerf", "select", str(session.work.root), "--of", field.name])
        raise UsageError(
            f"--of {field.name}: region {region.name} was selected in field {own.name}; select it anew: {anew}"
        )
    return own


def _region(args, session) -> dict:
    from stages.pipeline.local_edit import learned_edit, region_of

    region = region_of(session, args.region)
    if args.of:
        _field_of(region, args, session)
    config, name = pinned(session.config, region.name)
    if not config.changes:
        tell_replaced(session, "edit", name, config)
    made = learned_edit(session, region, config.learning, config.changes, name, f"{name}-changed")
    result = {"edit": made.path, "name": made.name, "figures": made.manifest.figures, "seconds": made.manifest.seconds}
    return session.emit(result, told_palette(made))


def pinned(config: RegionConfig, region: str) -> tuple[RegionConfig, str]:
    """The options with the painting's digest, checked before any work is done, and the name of the edit."""
    from schemas.canonical_json import file_sha256
    from stages import edit_learn
    from stages.weights.resolve import chosen

    if not config.style:
        return config, f"{region}-recolor"
    style = painting_of(config.style)
    pinned_files = {"style": str(style.resolve()), "style_digest": file_sha256(style)}
    config = replace(config, **pinned_files, **chosen(config.features))
    edit_learn.cropped(config.learning)
    return config, f"{region}-{name_of(style)}"


def told_palette(made, kind: str = "edit") -> list[str]:
    """An edit, or a field with a palette, in words: its palette, color by color."""
    from stages.artifacts.edit import told_colors

    colors = told_colors(made)
    lines = [
        f"  {one['index']}  {one['now']}  {one['share']:6.1%}  {one['name']}"
        + (f" (was {one['learned']})" if one["now"] != one["learned"] else "")
        for one in colors
    ]
    return [f"{kind} {made.name}: a palette of {len(colors)} colors", *lines, f"  {made.path}"]


def painting_of(text: str) -> Path:
    """The painting's file; BadInput where there is none."""
    from schemas.errors import BadInput

    if not Path(text).is_file():
        raise BadInput(f"--style {text}: there is no such image")
    return Path(text)


def name_of(style: Path) -> str:
    """The painting's file name as an artifact's name may be written, cut short where it is long; by its content where
    nothing is left of that."""
    from schemas.canonical_json import file_sha256

    name = re.sub(r"[^A-Za-z0-9._+-]+", "_", style.stem).strip("._+-")
    if 0 < len(name) <= LONGEST_NAME:
        return name
    return f"{name[: LONGEST_NAME - 7] or 'style'}-{file_sha256(style)[:6]}"


def tell_replaced(session, kind: str, name: str, config) -> None:
    """Says that what stands under the name to be written was made after another painting."""
    standing = next((one for one in session.work.artifacts(kind) if one.name == (session.name or name)), None)
    if standing is None:
        return
    with suppress(ArtifactDamaged, ArtifactStale):  # an unreadable one is replaced without regret
        before = standing.manifest.config
        pairs = [(before.get(key), getattr(config, key, "")) for key in ("style_digest", "references_digest")]
        if any(old and old != new for old, new in pairs):
            session.say(f"{kind} {standing.name} is of another painting and is replaced; --name NAME keeps both")
