"""Reads report artefacts: what report.json tells of a field, as far as anybody else reads it."""

from schemas.errors import ArtefactDamaged
from schemas.reading import read_json
from schemas.store import Artefact
from stages.soundness import sound
from stylerf import checks

DESCRIPTION = "report.json"
MOST = 1e300  # of a figure, which may be of any unit


def read_report(artefact: Artefact) -> dict:
    """report.json; ArtefactDamaged where what it tells is not of the types, or in the ranges, of figures.

    A report of before figures were told has none.
    """
    artefact.check_sizes()
    data = read_json(artefact.file(DESCRIPTION), ArtefactDamaged)
    with sound(artefact.path, "a sound report"):
        told = {"figures": [], "warnings": [], "not_measured": [], "edit": None} | checks.table(data, DESCRIPTION)
        for figure in checks.entry(told, "figures", list):
            _check_figure(figure)
        for key in ("field", "scene"):
            if key in told:
                checks.entry(told, key, str)
        if "view_count" in told:
            checks.integer(told, "view_count", 0, 10**9)
        for text in checks.entry(told, "warnings", list):
            checks.text(text, "warnings")
        checks.entry(told, "not_measured", list)
        if told["edit"] is not None:
            for name in checks.entry(told["edit"], "regions", list):
                checks.text(name, "regions")
        return told


def _check_figure(figure: dict) -> None:
    for key in ("key", "label", "unit", "better", "protocol"):
        checks.entry(figure, key, str)
    checks.integer(figure, "digits", 0, 20)
    for key in ("count", "left_out"):
        checks.integer(figure, key, 0, 10**9)
    checks.number(figure, "mean", -MOST, MOST)
    for name in (reference := checks.entry(figure, "reference", dict)):
        checks.number(reference, name, -MOST, MOST)
