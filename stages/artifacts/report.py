"""Read report artifacts: the parts of report.json that other code uses."""

from schemas.safe_reading import sound
from schemas.work_folder import Artifact
from stylerf import validation

DESCRIPTION = "report.json"
LARGEST = 1e300  # of a metric, whatever its unit


def read_report(artifact: Artifact) -> dict:
    """Read report.json; reports older than the list of metrics get an empty one.

    Raises ArtifactDamaged if types or ranges are wrong.
    """
    artifact.check_sizes()
    data = artifact.json(DESCRIPTION)
    with sound(artifact.path, "a valid report"):
        report = {"metrics": [], "warnings": [], "not_measured": [], "edit": None} | validation.table(data, DESCRIPTION)
        for metric in validation.entry(report, "metrics", list):
            _check_metric(metric)
        for key in ("field", "scene"):
            if key in report:
                validation.entry(report, key, str)
        if "view_count" in report:
            validation.integer(report, "view_count", 0, 10**9)
        for text in validation.entry(report, "warnings", list):
            validation.text(text, "warnings")
        validation.entry(report, "not_measured", list)
        if report["edit"] is not None:
            for name in validation.entry(report["edit"], "regions", list):
                validation.text(name, "regions")
        return report


def _check_metric(metric: dict) -> None:
    for key in ("key", "label", "unit", "better", "protocol"):
        validation.entry(metric, key, str)
    validation.integer(metric, "digits", 0, 20)
    for key in ("count", "left_out"):
        validation.integer(metric, key, 0, 10**9)
    validation.number(metric, "mean", -LARGEST, LARGEST)
    for name in (reference := validation.entry(metric, "reference", dict)):
        validation.number(reference, name, -LARGEST, LARGEST)
