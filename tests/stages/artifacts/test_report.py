"""Reports as other code reads them, of this schema and of older ones."""

import json
import shutil
from pathlib import Path

import pytest

from schemas.errors import ArtifactDamaged
from schemas.work_folder import WorkFolder
from stages.artifacts.report import read_report
from tests.resealing import reseal

SAMPLES = Path(__file__).parents[2] / "schemas" / "samples"
METRIC = {"key": "depth_share", "label": "Depth compared", "unit": "share", "better": "higher", "protocol": "p",
          "digits": 4, "mean": 0.5, "count": 2, "left_out": 0, "reference": {}}  # fmt: skip


def report_of_schema_2(root: Path, content: dict):
    """The stored sample of schema 2 with another report.json."""
    folder = root / "report" / "old"
    shutil.copytree(SAMPLES / "report-2", folder)
    (folder / "report.json").write_text(json.dumps(content))
    reseal(folder)
    return WorkFolder(root).get("report", "old")


def test_figures_of_schema_2_are_read_as_metrics(tmp_path):
    report = read_report(report_of_schema_2(tmp_path, {"figures": [METRIC], "painting": "a.png", "stylised": True}))
    assert report["metrics"] == [METRIC | {"unit": "fraction"}]
    assert report["style_image"] == "a.png" and report["stylized"] is True and "figures" not in report


@pytest.mark.parametrize("changed", [{"mean": "high"}, {"count": -1}, {"label": 3}, {"reference": []}, {"digits": 99}])
def test_a_metric_of_the_wrong_kind_is_damage(tmp_path, changed):
    with pytest.raises(ArtifactDamaged, match=next(iter(changed))):
        read_report(report_of_schema_2(tmp_path, {"figures": [METRIC | changed]}))
