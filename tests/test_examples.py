"""The example programs run."""

import runpy
from pathlib import Path

from schemas.work_folder import WorkFolder
from stages.artifacts.report import read_report
from stages.pipeline.demo_scene import PAINTING, write_demo
from stages.run.progress import Silent
from tests.conftest import REPOSITORY


def test_the_pipeline_example_makes_field_film_and_report(tmp_path):
    write_demo(tmp_path / "photos", 32, 10, 2, 0, 1, Silent())
    main = runpy.run_path(str(REPOSITORY / "examples" / "pipeline.py"))["main"]
    arguments = (str(tmp_path / "photos"), str(tmp_path / "photos" / PAINTING), str(tmp_path / "work"), "60", "4")
    report = Path(main(*arguments))
    work = WorkFolder(tmp_path / "work")
    assert report.is_file() and report.parent.parent.parent == work.root
    assert {(one.kind, one.name) for one in work.artifacts()} == {
        ("scene", "main"),
        ("field", "fit"),
        ("field", "painting-arf"),
        ("frames", "painting-arf-orbit"),
        ("frames", "painting-arf-test"),
        ("frames", "fit-test"),
        ("report", "painting-arf"),
    }
    content = read_report(work.get("report", "painting-arf"))
    assert content["stylized"] and {"nnfm", "short_rmse"} <= {figure["key"] for figure in content["metrics"]}
    before = {one.path: one.digest for one in work.artifacts()}
    assert Path(main(*arguments)) == report  # a rerun reuses everything
    assert {one.path: one.digest for one in work.artifacts()} == before
