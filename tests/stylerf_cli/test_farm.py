"""`stylerf farm`: a small table from photos to its report, what stands is not run again, what fails is named."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

pytest.importorskip("snakemake", reason="needs the extra `farm`")

from schemas.manifest import MANIFEST
from stylerf_cli.main import main
from tests.farm_table import warming, write_table
from tests.job_server import JobServer

SMALL = {"eval": False, "methods": {"arf": {}}, "render": {"count": 2, "shards": 2}}


@dataclass
class Ran:
    """A command that ended: exit code, the object that it printed, its messages."""

    code: int
    result: dict
    said: str


@dataclass
class Bench:
    """A table and the server of its jobs."""

    table: Path
    server: JobServer

    @property
    def out(self) -> Path:
        return self.table.with_suffix("")

    def farm(self, *flags: str) -> Ran:
        done = subprocess.run(
            [sys.executable, "-m", "stylerf_cli.main", "farm", str(self.table), "--cores", "2", "--json", *flags],
            env=os.environ | self.server.env, capture_output=True, text=True, check=False,
        )  # fmt: skip
        return Ran(done.returncode, json.loads(done.stdout), done.stderr)

    def commands_of(self, *flags: str) -> tuple[Ran, list[list[str]]]:
        """Run it; return what jobs it ran too."""
        before = len(self.server.children())
        ran = self.farm(*flags)
        return ran, [child["argv"] for child in self.server.children()[before:]]


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Two captures, of which the third does not exist, and two paintings; run once."""
    folder = tmp_path_factory.mktemp("farm")
    table = write_table(folder, 2, 2, **SMALL)
    content = json.loads(table.read_text())
    content["scenes"]["bad"] = "nowhere"
    table.write_text(json.dumps(content))
    server = JobServer(folder / "server", warm=warming(folder / "warming")[:4])
    made = Bench(table, server)
    made.first = made.farm()
    yield made
    server.close()


def test_a_bad_scene_stops_only_what_needs_it_and_is_named(bench):
    ran = bench.first
    assert ran.code == 1
    assert [one["key"] for one in ran.result["failed"]] == ["bad/scene/main"]
    assert "nowhere" in ran.result["failed"][0]["why"] and ran.result["failed"][0]["blocked"] == 12
    assert ran.result["finished"] == 26 and "12 wait for them" in ran.result["error"]


def test_what_was_refused_is_not_tried_again(bench):
    tried = [child for child in bench.server.children() if str(bench.table.parent / "nowhere") in child["argv"]]
    assert tried and all(child["code"] == 3 for child in tried)
    assert len(tried) <= 2  # at most once in a run; other tests run it too


def test_shards_are_joined_without_rendering_them_again(bench):
    joined = json.loads((bench.out / "scene0/frames/style0-arf-s0-orbit" / MANIFEST).read_text())
    assert joined["figures"]["frames"] == 2 and joined["figures"]["pixels"] == 0


def test_the_report_shows_every_scene_and_style(bench):
    content = json.loads((bench.out / "report/table.json").read_text())
    assert {(cell["scene"], cell["style"]) for cell in content["cells"]} == {
        (f"scene{scene}", f"style{style}") for scene in (0, 1) for style in (0, 1)
    }
    assert any(gap["what"].startswith("bad") for gap in content["missing"])
    assert (bench.out / "report/table.html").is_file() and (bench.out / "report/compare.html").is_file()


def test_what_stands_is_not_run_again_and_what_is_deleted_is(bench):
    shutil.rmtree(bench.out / "scene0/field/style0-arf-s0")
    ran, commands = bench.commands_of()
    names = [argv[argv.index("--name") + 1] for argv in commands if "--name" in argv]
    assert ran.result["finished"] == 26
    assert names[0] == "style0-arf-s0" and set(names) <= {
        "style0-arf-s0", "style0-arf-s0-orbit", "style0-arf-s0-orbit-0-0", "style0-arf-s0-orbit-1-1",
    }  # fmt: skip


def test_a_second_run_on_the_folder_is_refused(bench):
    from schemas.lock import Lock
    from stages.farm.folder import farm_folder

    lock = Lock(farm_folder(bench.out) / ".run.lock")
    try:
        ran = bench.farm()
    finally:
        lock.release()
    assert ran.code == 5 and "is in use by another `stylerf farm`" in ran.result["error"]


def test_the_plan_runs_nothing(tmp_path, capsys):
    table = write_table(tmp_path, 2, 2, **SMALL)
    assert main(["farm", str(table), "--plan", "--cores", "64", "--json"]) == 0
    plan = json.loads(capsys.readouterr().out)
    assert plan["to_do"] == plan["jobs"] == 26 and plan["plan"]["cores"] == 64
    assert not (tmp_path / "table").exists()


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--seed", "1"], "--seed has no effect here"),
        (["--threads", "1"], "--threads has no effect here"),
        (["--name", "x"], "the table names its artifacts"),
        (["--plan", "--dry-run"], "give one of them"),
        (["--jobs", "5"], "on this machine, give --cores"),
        (["--profile", "nowhere"], "--profile nowhere"),
        (["--plan", "--snakemake=--forceall"], "--plan does not call Snakemake"),
    ],
)
def test_an_option_that_would_do_nothing_is_refused(tmp_path, capsys, flags, said):
    table = write_table(tmp_path, 1, 1, **SMALL)
    assert main(["farm", str(table), *flags]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "table/scene0").exists()


def test_every_fault_of_a_table_is_a_line(tmp_path, capsys):
    table = write_table(tmp_path, 1, 1, seeds_=[1], threads=0)
    assert main(["farm", str(table), "--plan"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2 and all(str(table) in line for line in lines)
