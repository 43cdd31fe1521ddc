"""Notes of an evaluation: warnings, and what was not measured and why."""

from collections.abc import Sequence
from dataclasses import dataclass

from schemas.safe_names import listed
from stages.artifacts.provenance import Made
from stages.evaluation.metrics import Row
from stages.weights.sources import OBTAIN_ST


@dataclass(frozen=True)
class Inputs:
    """The inputs of an evaluation, as far as they determine what can be measured."""

    stylized: bool
    style_image: bool
    st_lpips: bool
    lpips: bool
    perceptual_wanted: bool
    large_enough: bool  # images, for the perceptual networks
    true_depth: bool
    depth_sizes_differ: bool
    base: bool  # the unstylized field
    path: str  # name of the camera path, "" without one
    path_length: int
    gap: int
    field: bool
    edited: bool = False  # a local edit, with its region
    masks: bool = False  # the edit's region is given as mask images of its views
    weights_changed: bool = False  # the edit's palette was changed after its sparsity and TV were measured
    consistency: str = "correct"
    reference: bool = False  # Ref-NPR: a stylized image of a view
    reference_field: bool = False  # Ref-NPR: the field whose renders were the references


def not_measured(have: Inputs) -> list[dict]:
    """List {what, why} for every metric that was not or could not be measured."""
    notes = _style_notes(have) if have.stylized else _fit_notes(have)
    if have.edited and not have.stylized:
        why = "They cover whole views, where the edit counts as an error; background MSE leaves it out."
        notes.append(_note("PSNR, SSIM and LPIPS without the edit", why))
    if have.weights_changed:
        why = "The palette weights were changed after training; only the trained palette reports them."
        notes.append(_note("Palette sparsity and TV", why))
    notes += _consistency_notes(have)
    if not have.field:
        notes.append(_note("Parameters of the field", "Only the frames were given, not the field itself."))
    return notes


def _fit_notes(have: Inputs) -> list[dict]:
    notes = []
    if why := _no_perceptual(have):
        notes.append(_note("LPIPS and ST-LPIPS", why))
    else:
        if not have.lpips:
            notes.append(_note("LPIPS", "Its weights were not found; `stylerf doctor` shows how to get them."))
        if not have.st_lpips:
            notes.append(_note("ST-LPIPS", f"Its weights were not found; get them with: {OBTAIN_ST}"))
    if not have.true_depth:
        notes.append(_note("Depth error", "The scene has no ground-truth depth."))
    elif have.depth_sizes_differ:
        notes.append(_note("Depth error", "The true depth and the frames differ in size; depth cannot be resampled."))
    return notes


def _style_notes(have: Inputs) -> list[dict]:
    notes = [
        _note(
            "PSNR, SSIM and LPIPS against the photos",
            "A stylized render is meant to differ from the photo. Content SSIM shows how much structure it kept.",
        )
    ]
    if not have.style_image:
        notes.append(_note("Distances to the style image", "No style image was found; name one with --style."))
    if not have.base:
        why = "Frames of the unstylized field were not given, so the photos serve as the reference."
        notes.append(_note("Change of depth, and metrics of the unstylized render", why))
    if not have.reference:
        notes.append(_note("Ref-LPIPS", "No stylized image of a view was given; add one with --reference VIEW=FILE."))
    elif why := _no_perceptual(have):
        notes.append(_note("Ref-LPIPS", why))
    if not have.reference_field:
        why = "The field whose renders were the references was not given; name it with --robust-to."
        notes.append(_note("Robustness", why))
    notes.append(
        _note(
            "ArtFID",
            "It needs an Inception network trained on art (art_inception.pth), which no known package provides. The "
            "SIFID-style distance replaces its style term, content SSIM its content term.",
        )
    )
    notes.append(
        _note(
            "Aesthetic quality", "No metric measures it; judge by eye, or collect votes with `stylerf compare --pairs`."
        )
    )
    return notes


def _consistency_notes(have: Inputs) -> list[dict]:
    if not have.path:
        why = "No frames along a camera path were given, and held-out views are too far apart."
        return [_note("Multi-view consistency", why)]
    notes = []
    if have.path_length < 2:
        notes.append(_note("Multi-view consistency", f"The path {have.path} has a single frame."))
    elif have.path_length <= have.gap:
        why = f"The path {have.path} has {have.path_length} frames; pairs {have.gap} apart need {have.gap + 1}."
        notes.append(_note("Long-range consistency", why))
    if have.path_length >= 2 and have.consistency == "correct":
        notes.append(
            _note(
                "Consistency by published protocols",
                "Protocols differ by up to three times; do not compare values across them. --consistency all also "
                "measures by laenerf-script and stylerf-family.",
            )
        )
    if have.path_length >= 2 and have.edited:
        notes += _region_notes(have)
    if have.path_length >= 2 and (why := _no_perceptual(have)):
        notes.append(_note("Consistency by a perceptual distance", why))
    return notes


def _region_notes(have: Inputs) -> list[dict]:
    what = "Consistency within the region"
    if have.masks:
        return [_note(what, "The masks given by --masks are for other views; use --region without --masks.")]
    if have.consistency not in ("correct", "all"):
        return [_note(what, "It needs --consistency correct or all.")]
    return []


def _no_perceptual(have: Inputs) -> str:
    """Return why neither LPIPS nor ST-LPIPS was measured; empty if one was."""
    if not have.perceptual_wanted:
        return "Turned off by --perceptual none."
    if not have.large_enough:
        return "The images are smaller than 64 pixels on a side."
    if not (have.lpips or have.st_lpips):
        return f"Found weights of neither LPIPS nor ST-LPIPS; get the latter with: {OBTAIN_ST}"
    return ""


def _note(what: str, why: str) -> dict:
    return {"what": what, "why": why}


def warnings_of(
    rows: Sequence[Row], pairs: Sequence[Row], stages: Sequence[Made], unmatched: list[str], resized: int
) -> list[str]:
    """Return what a reader must know before trusting a metric."""
    found = []
    incomplete = [row for row in rows if row.get("remark")]
    if incomplete:
        names = listed([str(row["name"]) for row in incomplete])
        found.append(
            f"{len(incomplete)} of {len(rows)} views could not be measured completely ({names}); the means leave out "
            f"the missing values. {incomplete[0]['name']}: {incomplete[0]['remark']}."
        )
    skipped = [row for row in pairs if row.get("remark")]
    if skipped:
        found.append(f"Consistency leaves out {len(skipped)} of {len(pairs)} pairs of frames. {skipped[0]['remark']}.")
    if unmatched:
        found.append(f"{len(unmatched)} frames match no view of the scene and have no photo: {listed(unmatched)}.")
    if resized:
        found.append(f"{resized} photos differ in size from the frames and were resampled to it.")
    for made in stages:
        if made.remark:
            found.append(f"{made.kind} {made.name}: {made.remark}.")
    return found
