"""What has to be said beside the figures: warnings, what was not measured and why, and the charts."""

from collections.abc import Sequence
from dataclasses import dataclass

from schemas.safe_names import listed
from schemas.work_folder import Artifact
from stages.artifacts.provenance import Made, fields_behind
from stages.evaluation.metrics import Row, is_number
from stages.report.charts import Chart, bar_chart, curve_chart, pairs_chart
from stages.weights.sources import OBTAIN_ST

BAR_FIGURES = {False: ("psnr", "PSNR", "dB"), True: ("nnfm", "NNFM distance to {style_words}", "")}


@dataclass(frozen=True)
class Presence:
    """What an evaluation had at hand, and what it met on the way."""

    stylized: bool
    painting: bool
    tolerant: bool  # ST-LPIPS
    lpips: bool
    perceptual_wanted: bool
    large_enough: bool  # images for the perceptual networks
    true_depth: bool
    depth_sizes_differ: bool
    base: bool
    path: str  # name of the camera path, "" without one
    path_length: int
    gap: int
    field: bool
    edited: bool = False  # a local edit, with its region
    masks: bool = False  # the edit's region is told by pictures of its views
    weights_changed: bool = False  # of the edit's palette, since its sparsity and TV were told
    consistency: str = "correct"
    reference: bool = False  # Ref-NPR's: a stylized picture of a view
    twin: bool = False  # a field whose renders were references


def not_measured(have: Presence) -> list[dict]:
    """What and why, for every figure that this evaluation knows and could not or did not measure."""
    notes = _style_notes(have) if have.stylized else _fit_notes(have)
    if have.edited and not have.stylized:
        why = "They are of whole views, where the edit counts as an error; background MSE leaves it out."
        notes.append(_note("PSNR, SSIM and LPIPS without the edit", why))
    if have.weights_changed:
        why = "The palette's weights were changed after they were learned; what was learned tells of its own."
        notes.append(_note("Palette sparsity and TV", why))
    notes += _consistency_notes(have)
    if not have.field:
        notes.append(_note("Parameters of the field", "The field itself was not given, only its frames."))
    return notes


def _fit_notes(have: Presence) -> list[dict]:
    notes = []
    if why := _blind(have):
        notes.append(_note("LPIPS and ST-LPIPS", why))
    else:
        if not have.lpips:
            notes.append(_note("LPIPS", "Its trained weights were not found; `stylerf doctor` tells how to get them."))
        if not have.tolerant:
            notes.append(_note("ST-LPIPS", f"Its weights were not found; get them with: {OBTAIN_ST}"))
    if not have.true_depth:
        notes.append(_note("Depth error", "The scene has no true depth: photos do not tell it."))
    elif have.depth_sizes_differ:
        notes.append(_note("Depth error", "The true depth has another size than the frames, and must not be scaled."))
    return notes


def _style_notes(have: Presence) -> list[dict]:
    notes = [
        _note(
            "PSNR, SSIM and LPIPS against the photos",
            "A stylized render is meant to differ from the photo. Content SSIM tells how much structure it kept.",
        )
    ]
    if not have.painting:
        notes.append(_note("Distances to the painting", "No painting was found; give it with --style."))
    if not have.base:
        why = "The unstylized field's frames of the same views were not given, so the photos stand in as reference."
        notes.append(_note("Change of depth, and figures of the unstylized render", why))
    if not have.reference:
        notes.append(_note("Ref-LPIPS", "No stylized picture of a view was given; give it with --reference VIEW=FILE."))
    elif why := _blind(have):
        notes.append(_note("Ref-LPIPS", why))
    if not have.twin:
        why = "No field was named whose renders were this one's references; name it with --robust-to."
        notes.append(_note("Robustness", why))
    notes.append(
        _note(
            "ArtFID",
            "Its weights are missing: an Inception network trained on paintings (art_inception.pth), which no package "
            "known here carries. The SIFID-style distance stands in for its style part, content SSIM for its other.",
        )
    )
    notes.append(_note("How beautiful it is", "No figure tells; look at the pictures."))
    return notes


def _consistency_notes(have: Presence) -> list[dict]:
    if not have.path:
        why = "No frames of a camera path were given, and held-out views lie too far apart."
        return [_note("Consistency between views", why)]
    notes = []
    if have.path_length < 2:
        notes.append(_note("Consistency between views", f"The path {have.path} has a single frame."))
    elif have.path_length <= have.gap:
        why = f"The path {have.path} has {have.path_length} frames; pairs {have.gap} apart need {have.gap + 1}."
        notes.append(_note("Consistency, long range", why))
    if have.path_length >= 2 and have.consistency == "correct":
        notes.append(
            _note(
                "Consistency by published protocols",
                "Papers measure otherwise and differ among themselves by three times: figures of two protocols must "
                "not be put side by side. --consistency all measures by laenerf-script and stylerf-family too.",
            )
        )
    if have.path_length >= 2 and have.edited:
        notes += _region_notes(have)
    if have.path_length >= 2 and (why := _blind(have)):
        notes.append(_note("Consistency by a perceptual distance", why))
    return notes


def _region_notes(have: Presence) -> list[dict]:
    what = "Consistency within the region"
    if have.masks:
        return [_note(what, "Masks given by --masks are of other views; name the region by --region alone.")]
    if have.consistency not in ("correct", "all"):
        return [_note(what, "It is measured by --consistency correct or all.")]
    return []


def _blind(have: Presence) -> str:
    """Why nothing is measured by LPIPS or ST-LPIPS, empty where something is."""
    if not have.perceptual_wanted:
        return "Turned off by --perceptual none."
    if not have.large_enough:
        return "The images are smaller than 64 pixels on a side."
    if not (have.lpips or have.tolerant):
        return f"Neither weights of LPIPS nor of ST-LPIPS were found; get the latter with: {OBTAIN_ST}"
    return ""


def _note(what: str, why: str) -> dict:
    return {"what": what, "why": why}


def warnings_of(
    rows: Sequence[Row], pairs: Sequence[Row], stages: Sequence[Made], unmatched: Sequence[str], resized: int
) -> list[str]:
    """What a reader must know before believing a figure, in words."""
    found = []
    remarked = [row for row in rows if row.get("remark")]
    if remarked:
        names = listed([str(row["name"]) for row in remarked])
        found.append(
            f"{len(remarked)} of {len(rows)} views could not be measured in full ({names}); the means leave out what "
            f"is missing. {remarked[0]['name']}: {remarked[0]['remark']}."
        )
    spoiled_pairs = [row for row in pairs if row.get("remark")]
    if spoiled_pairs:
        found.append(
            f"{len(spoiled_pairs)} of {len(pairs)} pairs of frames were left out of the consistency figures. "
            f"{spoiled_pairs[0]['remark']}."
        )
    if unmatched:
        found.append(f"{len(unmatched)} frames repeat no view of the scene; no photo to compare: {listed(unmatched)}.")
    if resized:
        found.append(f"{resized} photos have another size than the frames and were resampled to it before comparing.")
    for made in stages:
        if made.remark:
            found.append(f"{made.kind} {made.name}: {made.remark}.")
    return found


def curve_of(field: Artifact | None) -> dict | None:
    """{"of": name, "points": [{seconds, psnr, held_out, ...}]} of this field, or of the nearest one it was made from.

    held_out: false where those views are trained on by then, or it is not known.
    """
    for artifact in [field, *fields_behind(field)] if field is not None else []:
        points = artifact.manifest.figures.get("curve")
        usable = points if isinstance(points, list) else []
        usable = [{**point, "held_out": point.get("held_out") is True} for point in usable if _is_point(point)]
        if len(usable) > 1:
            return {"of": artifact.name, "points": sorted(usable, key=lambda point: point["seconds"])}
    return None


def _is_point(point: object) -> bool:
    return isinstance(point, dict) and is_number(point.get("seconds")) and is_number(point.get("psnr"))


def draw_charts(
    stylized: bool, rows: Sequence[Row], pairs: Sequence[Row], curve: dict | None, gap: int, style_words: str
) -> list[Chart]:
    """Bars of the leading figure, quality against seconds, consistency along the path: what there is data for."""
    charts = []
    key, title, unit = BAR_FIGURES[stylized]
    title = title.format(style_words=style_words)
    if any(is_number(row.get(key)) for row in rows):
        labels = [str(row["name"]) for row in rows]
        values = [float(row[key]) if is_number(row.get(key)) else None for row in rows]
        charts.append(bar_chart(f"{key}_views", title, unit, labels, values))
    if curve:
        charts.append(curve_chart("quality_seconds", f"Quality against time: fit of {curve['of']}", curve["points"]))
    series = {}
    for label, words in (("short", "1 frame apart"), ("long", f"{gap} frames apart")):
        points = [
            (float(row["frame"]), float(row[f"{label}_rmse"])) for row in pairs if is_number(row.get(f"{label}_rmse"))
        ]
        if len(points) > 1:
            series[words] = points
    if series:
        charts.append(pairs_chart("consistency_pairs", "RMSE between warped views", series))
    return charts
