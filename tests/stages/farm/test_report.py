"""The report over a table, from manifests and reports made by hand."""

import json

import pytest

from schemas.work_folder import WorkFolder
from stages.farm.report import written_report
from stages.farm.table import read_table
from stylerf_cli.verbs.farm import build
from tests.stages import comparison_fixture as runs
from tests.stages import evaluation_fixture as made

EDIT = {"at": ["#0:1,1"], "recolor": True}


def test_edits_are_ranked_among_themselves_with_spread_over_seeds(tmp_path):
    table = tmp_path / "table.yaml"
    names = {"red": {**EDIT, "palette": ["0=#ff0000"]}, "blue": {**EDIT, "palette": ["0=#0000ff"]}}
    (tmp_path / "photos").mkdir()
    table.write_text(json.dumps({"scenes": {"room": "photos"}, "edits": names, "seeds": [0, 1]}))
    work = WorkFolder(tmp_path / "table" / "room")
    scene = made.make_scene(work, [0.0], depth=False)
    for seed in (0, 1):
        base = runs.fit(work, scene, f"fit-s{seed}", 10.0, 25.0)
        for name, bleeding in (("red", 0.1), ("blue", 0.3)):
            metrics = {"change_lab": 9.0, "background_ratio": 1.0, "bleeding": bleeding + 0.02 * seed}
            edit = runs.edited(work, scene, base, f"edit-{name}-s{seed}", (1.0, 2.0, 3.0, 4.0), {})
            runs.report(work, edit, metrics, {"regions": [edit.name]}, f"against field fit-s{seed}")

    written = written_report(read_table(table, build))

    cells = {cell["method"]: cell for cell in written["edits"]["cells"]}
    assert cells["red"]["values"]["bleeding"] == pytest.approx({"mean": 0.11, "spread": 0.02 / 2**0.5, "count": 2})
    ranks = {(one["method"], one["column"]): one["rank"] for one in written["edits"]["standings"]}
    assert (ranks["red", "bleeding"], ranks["blue", "bleeding"]) == (1, 2)
    assert ("red", "change_lab") not in ranks  # neither end is better
    assert not written["cells"]
    page = written["page"].read_text()
    assert "Ranks of edits" in page and "Ranks of methods" not in page
    rows = [row.split(",")[:4] for row in written["table"].read_text().splitlines()[1:]]
    assert sorted(rows) == [["room", "", "blue", "2"], ["room", "", "red", "2"]]
