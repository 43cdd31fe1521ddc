"""Reads report artifacts: what report.json tells of a field, as far as anybody else reads it."""

from schemas.work_folder import Artifact
from stages.artifacts.validity import sound
from stylerf import validation

DESCRIPTION = "report.json"
MOST = 1e300  # of a figure, which may be of any unit


def read_report(artifact: Artifact) -> dict:
    """report.json; ArtifactDamaged where what it tells is not of the types, or in the ranges, of figures.

    A report of before figures were told has none.
    """
    artifact.check_sizes()
    data = artifact.json(DESCRIPTION)
    with sound(artifact.path, "a sound report"):
        told = {"figures": [], "warnings": [], "not_measured": [], "edit": None} | validation.table(data, DESCRIPTION)
        for figure in validation.entry(told, "figures", list):
            _check_figure(figure)
        for key in ("field", "scene"):
            if key in told:
                validation.entry(told, key, str)
        if "view_count" in told:
            validation.integer(told, "view_count", 0, 10**9)
        for text in validation.entry(told, "warnings", list):
            validation.text(text, "warnings")
        validation.entry(told, "not_measured", list)
        if told["edit"] is not None:
            for name in validation.entry(told["edit"], "regions", list):
                validation.text(name, "regions")
        return told


def _check_figure(figure: dict) -> None:
    for key in ("key", "label", "unit", "better", "protocol"):
        validation.entry(figure, key, str)
    validation.integer(figure, "digits", 0, 20)
    for key in ("count", "left_out"):
        validation.integer(figure, key, 0, 10**9)
    validation.number(figure, "mean", -MOST, MOST)
    for name in (reference := validation.entry(figure, "reference", dict)):
        validation.number(reference, name, -MOST, MOST)
