"""The front door: exit codes, one line per fault, one JSON object, and an instant --help."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from schemas.errors import ArtifactDamaged, BadInput, OutOfResources, StylerfError
from stylerf.errors import Diverged, InvalidValue
from stylerf_cli.main import main
from stylerf_cli.verbs import VERBS
from tests.stylerf_cli import toy_verb

SHIPPED = dict(VERBS)
REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def toy(monkeypatch):
    monkeypatch.setitem(VERBS, "toy", ("tests.stylerf_cli.toy_verb", "make a toy"))
    yield
    toy_verb.FAULT.clear()


def command(*arguments, **settings):
    """A fresh process, as a user starts it; the toy verb is in its table."""
    code = (
        "import sys; from stylerf_cli.verbs import VERBS\n"
        "VERBS['toy'] = ('tests.stylerf_cli.toy_verb', 'make a toy')\n"
        "from stylerf_cli.main import main; sys.exit(main())"
    )
    line = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, check=False, cwd=REPOSITORY, **settings)


def test_help_is_instant_and_imports_nothing_heavy():
    code = (
        "import sys; from stylerf_cli.main import main; code = main(['--help'])\n"
        "heavy = {'torch', 'numpy', 'numba', 'OpenImageIO', 'OpenEXR', 'pycolmap', 'matplotlib'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else code)"
    )
    times = []
    for _ in range(4):
        start = time.perf_counter()
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=REPOSITORY)
        times.append(time.perf_counter() - start)
        assert done.returncode == 0, done.stderr
    for verb, (_, words) in SHIPPED.items():
        assert verb in done.stdout and words in done.stdout
    # 0.2 s on an idle machine; twice that where other jobs share the cores.
    assert min(times) < 0.4


LIGHT = {verb: {"torch"} for verb in ("compare", "show", "verify")}  # these read artifacts, which takes numpy


@pytest.mark.parametrize("verb", SHIPPED)
def test_every_verb_keeps_the_contract_and_helps_without_torch(verb):
    code = (
        f"import sys; from stylerf_cli.main import main; code = main(['{verb}', '--help-all'])\n"
        f"heavy = {LIGHT.get(verb, {'torch', 'numpy'})} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=REPOSITORY)
    assert done.returncode == 0, done.stderr
    for flag in ("--json", "--seed", "--device", "--quiet", "--config", "--only", "--force", "--name", "--threads"):
        assert flag in done.stdout


@pytest.mark.parametrize("stage", ["pose_import", "nerf_fit", "render", "region_select", "finetune"])
def test_stages_that_can_run_without_torch_start_without_it(stage):
    """It takes more than a second to import."""
    code = (
        f"import sys, stages.{stage}\n"
        "heavy = {'torch', 'scipy.spatial', 'matplotlib'} & set(sys.modules) - ALLOWED\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    ).replace("ALLOWED", "{'scipy.spatial'}" if stage == "region_select" else "set()")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=REPOSITORY)
    assert done.returncode == 0, done.stderr


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("stylerf 0.")


def test_a_verb_runs_and_prints_words(tmp_path, capsys):
    assert main(["toy", str(tmp_path)]) == 0
    assert capsys.readouterr().out.endswith("made fox\n")
    assert main(["toy", str(tmp_path)]) == 0
    assert "is up to date" in capsys.readouterr().err
    assert main(["toy", str(tmp_path), "--force", "--name", "den"]) == 0
    assert "made den" in capsys.readouterr().out
    assert sorted(path.name for path in (tmp_path / "field").glob("[!.]*")) == ["den", "fox"]


def test_json_is_the_only_thing_on_stdout(tmp_path):
    done = command("toy", tmp_path, "--json")
    assert (done.returncode, done.stdout) == (0, '{"name": "fox", "seconds": "inf"}\n')
    assert "noise from a library" in done.stderr and "noise from native code" in done.stderr


def test_json_in_process(tmp_path, capsys):
    assert main(["toy", str(tmp_path), "--json", "--quiet"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == {"name": "fox", "seconds": "inf"} and err == "noise from a library\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "no verb given"),
        (["tyo"], "unknown verb 'tyo'; did you mean 'toy'?"),
        (["--frob"], "--frob"),
        (["toy"], "required: work"),
        (["toy", "w", "--stepz", "3"], "did you mean '--steps'?"),
        (["toy", "w", "--step", "3"], "did you mean '--steps'?"),  # abbreviations are not taken
        (["toy", "w", "--steps", "many"], "whole number"),
        (["toy", "w", "--color", "green"], "green"),
        (["toy", "w", "--steps", "-1"], "steps must not be negative"),
        (["toy", "w", "--name", "../x"], "is not a valid name"),
        (["toy", "w", "--threads", "0"], "at least 1"),
        (["toy", "w", "--seed", "-1"], "--seed is -1; expected 0 to 4294967295"),
        (["toy", "w", "--seed", "4294967296"], "--seed is 4294967296"),
        (["toy", "w", "--config", "absent.toml"], "absent.toml: file not found"),
        *(
            ([verb, *(["w"] if verb != "doctor" else []), "--name", "mine"], "leave it out")
            for verb in ("stress", "compare", "show", "verify", "doctor", "demo")
        ),
    ],
)
def test_usage_faults_end_with_2_and_one_line(arguments, words, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for extra in ([], ["--json"]):
        assert main(arguments + extra) == 2
        out, err = capsys.readouterr()
        assert err.startswith("stylerf: error: ") and err.count("\n") == 1 and words in err
        if extra:
            assert json.loads(out) == {"error": err.removeprefix("stylerf: error: ").strip(), "exit_code": 2}
        else:
            assert out == ""


@pytest.mark.parametrize(
    ("fault", "code", "words"),
    [
        (BadInput("no photos\nin x"), 3, "no photos in x"),
        (ArtifactDamaged("bad"), 4, "bad"),
        (OutOfResources("full"), 5, "full"),
        (StylerfError("other"), 3, "other"),
        (InvalidValue("a NaN pose"), 3, "a NaN pose"),
        (Diverged("loss is NaN"), 1, "loss is NaN; try another --seed"),
        (MemoryError(), 5, "out of memory"),
        (OSError(errno.ENOSPC, "No space left"), 5, "no space left"),
        (KeyboardInterrupt(), 130, "rerun to resume: stylerf toy"),
    ],
)
def test_faults_have_their_exit_code_and_one_line(tmp_path, capsys, fault, code, words):
    toy_verb.FAULT.append(fault)
    assert main(["toy", str(tmp_path), "--json"]) == code
    out, err = capsys.readouterr()
    assert err.count("\n") == 1 and words in err
    assert json.loads(out)["exit_code"] == code and words in json.loads(out)["error"]


def test_an_unexpected_fault_leaves_a_report_in_the_work_folder(tmp_path, capsys):
    fault = ZeroDivisionError("1/0")
    fault.__cause__ = ValueError("p\udcff.png")  # as names of files come that are not UTF-8
    toy_verb.FAULT.append(fault)
    assert main(["toy", str(tmp_path)]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "unexpected ZeroDivisionError" in err
    report = Path(err.strip().rpartition(" ")[2])
    assert report.parent == tmp_path
    text = report.read_text()
    assert "p\\udcff.png" in text and "Traceback" in text and f"stylerf toy {tmp_path}" in text


def test_without_a_work_folder_a_report_goes_to_the_temporary_folder(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    toy_verb.FAULT.append(ZeroDivisionError())
    assert main(["toy", "nowhere"]) == 1
    assert Path(capsys.readouterr().err.strip().rpartition(" ")[2]).parent == tmp_path


def test_a_broken_pipe_inside_a_stage_is_not_taken_for_a_closed_stdout(tmp_path, capsys):
    toy_verb.FAULT.append(BrokenPipeError(errno.EPIPE, "Broken pipe"))
    assert main(["toy", str(tmp_path)]) == 1
    assert "BrokenPipeError" in capsys.readouterr().err


def test_a_reader_that_closes_stdout_is_no_fault(tmp_path):
    for arguments in (["--help"], ["toy", str(tmp_path)], ["toy", str(tmp_path), "--json"]):
        reading, writing = os.pipe()
        os.close(reading)
        code = (
            "import sys; from stylerf_cli.verbs import VERBS\n"
            "VERBS['toy'] = ('tests.stylerf_cli.toy_verb', 'make a toy')\n"
            "from stylerf_cli.main import main; sys.exit(main())"
        )
        line = [sys.executable, "-c", code, *arguments, *([] if arguments == ["--help"] else ["--quiet"])]
        done = subprocess.run(line, stdout=writing, stderr=subprocess.PIPE, text=True, check=False, cwd=REPOSITORY)
        os.close(writing)
        assert done.stderr.replace("noise from a library\nnoise from native code\n", "") == "" and done.returncode == 0


def test_a_fault_keeps_its_exit_code_though_nobody_reads_it(tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    line = [sys.executable, "-m", "stylerf_cli.main", "show", str(tmp_path / "nowhere"), "--json"]
    done = subprocess.run(line, stdout=writing, stderr=subprocess.PIPE, text=True, check=False, cwd=REPOSITORY)
    os.close(writing)
    assert done.returncode == 3 and done.stderr.count("\n") == 1 and "error" in done.stderr


@pytest.mark.parametrize("as_json", [False, True])
def test_a_work_folder_whose_name_is_no_text_is_reported_by_escapes(tmp_path, as_json):
    work = os.fsencode(tmp_path) + b"/caf\xe9"
    assert main(["toy", str(tmp_path / "cafe"), "--quiet"]) == 0
    os.rename(tmp_path / "cafe", work)
    line = [sys.executable, "-m", "stylerf_cli.main", "show", work, *(["--json"] if as_json else [])]
    strict = os.environ | {"PYTHONIOENCODING": "utf-8:strict", "LC_ALL": "C.UTF-8"}
    done = subprocess.run(line, capture_output=True, check=False, cwd=REPOSITORY, env=strict)
    assert done.returncode == 0 and done.stderr == b""
    if as_json:
        assert os.fsencode(json.loads(done.stdout)["path"]) == work  # JSON that any reader takes
    else:
        assert rb"/caf\udce9" in done.stdout and b"\xe9" not in done.stdout


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_termination_end_with_130_and_the_same_command_resumes(tmp_path, number):
    arguments = ["toy", str(tmp_path), "--steps", "24", "--pause", "0.05"]
    code = (
        "import sys; from stylerf_cli.verbs import VERBS\n"
        "VERBS['toy'] = ('tests.stylerf_cli.toy_verb', 'make a toy')\n"
        "from stylerf_cli.main import main; sys.exit(main())"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        cwd=REPOSITORY,
    )  # fmt: skip
    deadline = time.monotonic() + 20
    while not list(tmp_path.rglob("state.safetensors")) and time.monotonic() < deadline:
        time.sleep(0.02)
    requested = time.monotonic()
    child.send_signal(number)
    out, err = child.communicate(timeout=10)
    assert time.monotonic() - requested < 5
    assert (child.returncode, out) == (130, "")
    assert err.splitlines()[-1] == (f"stylerf: error: interrupted; rerun to resume: stylerf {' '.join(arguments)}")
    done = command(*arguments)
    assert done.returncode == 0 and "resuming the interrupted toy of fox" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("where", ["in a constructor", "in a destructor"])
def test_an_interruption_that_leaves_something_half_built_says_one_line(tmp_path, number, where):
    """A destructor may then complain, or the interruption may fall into one, where Python would drop it."""
    (tmp_path / "delicate_verb.py").write_text(
        "import signal, time\n"
        "CONFIG = None\n"
        "def add_arguments(parser): pass\n"
        "class InConstructor:\n"
        "    def __init__(self):\n"
        f"        signal.raise_signal({int(number)})\n"
        "        self.built = True\n"
        "    def __del__(self):\n"
        "        self.built\n"
        "class InDestructor:\n"
        "    def __del__(self):\n"
        f"        signal.raise_signal({int(number)})\n"
        "def run(args, session):\n"
        f"    {'InConstructor()' if where == 'in a constructor' else 'InDestructor()'}\n"
        "    for _ in range(200):\n"
        "        time.sleep(0.05)\n"
    )
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from stylerf_cli.verbs import VERBS\n"
        "VERBS['delicate'] = ('delicate_verb', 'break')\n"
        "from stylerf_cli.main import main; sys.exit(main(['delicate']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=REPOSITORY)
    assert done.returncode == 130, done.stderr
    said = "stylerf: error: interrupted; rerun to resume: stylerf delicate"
    assert done.stderr.splitlines() == [said]
