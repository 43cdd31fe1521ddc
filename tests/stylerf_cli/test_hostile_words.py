"""Names from files and folders reach a terminal as text alone: nothing in them moves the cursor or begins a line."""

import errno
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from schemas.canonical_json import file_sha256
from stylerf.kernels import kernel_cache_dir
from stylerf_cli import exit_codes, output
from stylerf_cli.main import main
from stylerf_cli.progress import Bars
from tests.conftest import REPOSITORY

# Color and title of a terminal, C1's own beginning of them, going back in a line, a new line, text turned round.
HOSTILE = "a\x1b[31m\x1b]0;x\x07\x9b1A\rb\nfield fox: sound\u202egnp.\u2028\ud800"
ESCAPED = r"a\x1b[31m\x1b]0;x\x07\x9b1A\rb\nfield fox: sound\u202egnp.\u2028\ud800"


def test_lines_on_stdout(capsys):
    output.write_lines([f"view {HOSTILE}", "next"])
    assert capsys.readouterr().out == f"view {ESCAPED}\nnext\n"


def test_faults_and_progress_on_stderr(capsys):
    output.write_fault(f"stylerf: error: {HOSTILE.replace(chr(10), ' ')}")
    reported = capsys.readouterr().err
    assert "\x1b" not in reported and "\u202e" not in reported and "\r" not in reported
    stream = io.StringIO()
    Bars(stream).say(HOSTILE)
    assert stream.getvalue() == ESCAPED + "\n"
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    times = iter(range(0, 1000, 3))
    bars = Bars(terminal, lambda: float(next(times)))
    bars.start(HOSTILE, 10)
    bars.update(1, HOSTILE)
    bars.finish()
    assert "\x1b[31m" not in terminal.getvalue() and "\n" not in terminal.getvalue()[:-1]


def test_json_is_ascii(capsys):
    output.print_json({"name": HOSTILE})
    reported = capsys.readouterr().out
    assert reported.isascii() and reported.count("\n") == 1 and json.loads(reported)["name"] == HOSTILE


def test_a_usage_fault_shows_what_was_typed_escaped(capsys):
    assert main([f"sh{HOSTILE}"]) == 2
    reported = capsys.readouterr().err
    assert reported.count("\n") == 1 and "\x1b" not in reported and "\u202e" not in reported


@pytest.mark.parametrize("folder", ["a\x1b[2Jb", "line\nfield fox: sound", "turned\u202egnp", b"caf\xe9"])
def test_folders_with_hostile_names_are_shown_in_one_line(tmp_path, folder):
    path = os.path.join(os.fsencode(tmp_path), os.fsencode(folder))
    os.mkdir(path)
    done = subprocess.run(
        [sys.executable, "-m", "stylerf_cli.main", "show", path], capture_output=True, check=False, cwd=REPOSITORY
    )
    assert done.returncode == 3 and done.stdout == b""
    assert (
        done.stderr.count(b"\n") == 1
        and not set(done.stderr) & {0x1B, 0x0D, 0xE9}
        and b"\xe2\x80\xae" not in done.stderr
    )


@pytest.mark.parametrize(
    ("shell", "codes"),
    [
        ("{} show nowhere <&-", {3}),
        ("{} show nowhere <&- >&- 2>&-", {3}),
        ("{} show nowhere >&-", {3}),
        ("{} --version >&-", {0}),
        ("{} --help | head -c 1 >/dev/null; exit ${{PIPESTATUS[0]}}", {0}),
        ("NO_COLOR=1 COLUMNS=0 {} --help >/dev/null", {0}),
        ("PYTHONIOENCODING=ascii LC_ALL=C {} show $'n\\u00f6\\u4e2d'", {3}),
        ("LC_ALL=POSIX PYTHONUTF8=0 PYTHONCOERCECLOCALE=0 {} show $'n\\xf6\\xff'", {3}),
        ("mkdir gone && cd gone && rmdir ../gone && {} show .", {3}),
        ("mkdir gone && cd gone && rmdir ../gone && {} import photos work", {3, 5}),
        ("TMPDIR=/nowhere {} show nowhere", {3}),
    ],
)
def test_odd_surroundings_end_in_a_documented_code(tmp_path, shell, codes):
    """Closed streams, other encodings, a folder that is gone: no traceback, and it ends."""
    program = f"{sys.executable} -m stylerf_cli.main"
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run(
        ["bash", "-c", shell.format(program)],
        capture_output=True,
        check=False,
        cwd=tmp_path,
        timeout=60,
        env=environment,
    )
    assert done.returncode in codes, done.stderr
    assert b"Traceback" not in done.stderr and b"crash" not in done.stderr and done.stderr.count(b"\n") <= 1, (
        done.stderr
    )


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("arguments", "codes"),
    [
        (["show", ""], {3}),
        (["show", "--", "-x"], {3}),
        (["show", "/dev/null"], {3}),
        (["import", "/dev/null", "work"], {3}),
        (["import", "", "work"], {2, 3}),
        (["show", "x" * 5000], {3}),
        (["import", "x" * 5000, "work"], {3}),
        (["import", "photos", "x" * 5000], {3, 5}),
        (["show", "nowhere", "--config", "/dev/zero"], {2}),
        (["show", "nowhere", "--config", "."], {2}),
        (["show", "nowhere", "--config", "pipe"], {2}),
        (["show", "nowhere", "--config", "lists.toml"], {2}),
        (["show", "nowhere", "--config", "keys.toml"], {2}),
    ],
)
def test_odd_arguments_end_in_a_documented_code(tmp_path, monkeypatch, capsys, arguments, codes):
    monkeypatch.chdir(tmp_path)
    Path("photos").mkdir()
    os.mkfifo("pipe")
    Path("lists.toml").write_text("a=" + "[" * 100_000)
    Path("keys.toml").write_text("a." * 100_000 + "b=1")
    assert main(arguments) in codes
    err = capsys.readouterr().err
    assert "Traceback" not in err and "crash" not in err and err.count("\n") <= 1, err


def test_an_unforeseen_fault_keeps_its_traceback_somewhere(tmp_path, monkeypatch):
    """Even without a folder for temporary files, a current folder, and versions that can be asked for."""
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    monkeypatch.setattr(exit_codes.tempfile, "gettempdir", lambda: (_ for _ in ()).throw(FileNotFoundError(2, "none")))
    monkeypatch.setattr("stages.run.runner.versions", lambda: 1 / 0)
    kept = io.StringIO()
    monkeypatch.setattr(sys, "stderr", kept)
    code, line = exit_codes.code_and_line(KeyError("who"), ["fit", "w"], None)
    assert code == 1 and "unexpected KeyError" in line and "KeyError: 'who'" in kept.getvalue()
    code, line = exit_codes.code_and_line(KeyError("who"), ["fit", "w"], tmp_path)
    log = next(tmp_path.glob("stylerf-crash-*.log"))
    assert str(log) in line and "KeyError: 'who'" in log.read_text() and "ZeroDivisionError" not in line


@pytest.mark.parametrize("arguments", [["doctor", "--quiet"], ["show", "nowhere"]])
def test_a_user_whom_the_system_does_not_know_may_run_it(tmp_path, arguments):
    """As in a container that is started with a bare uid: no entry in passwd, no $HOME."""
    code = (
        "import pwd, sys\n"
        "def unknown(uid): raise KeyError(uid)\n"
        "pwd.getpwuid = unknown\n"
        f"from stylerf_cli.main import main; sys.exit(main({arguments!r}))"
    )
    nameless = {key: value for key, value in os.environ.items() if key not in ("HOME", "USER", "LOGNAME", "USERNAME")}
    kernels = {"NUMBA_CACHE_DIR": str(kernel_cache_dir())}  # else doctor would compile them again
    environment = nameless | {"PYTHONPATH": str(REPOSITORY), "STYLERF_CACHE": str(tmp_path)} | kernels
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path, env=environment
    )
    assert done.returncode in (0, 3, 4) and "unexpected" not in done.stderr, done.stderr


@pytest.mark.parametrize("name", ["pipe", "zero", "folder"])
def test_what_is_no_regular_file_has_no_digest(tmp_path, name):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError) as caught:
        file_sha256(tmp_path / name)
    code, line = exit_codes.code_and_line(caught.value, ["render", "w"], tmp_path)
    assert code == 3 and name in line and not list(tmp_path.glob("*.log"))


def test_a_path_of_an_unknown_user_is_reported(tmp_path):
    with pytest.raises(RuntimeError) as caught:
        Path("~nobody-is-called-so/x").expanduser()
    assert exit_codes.code_and_line(caught.value, ["eval", "w"], tmp_path)[0] == 3
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.ENAMETOOLONG, "File name too long", "x" * 5000),
        UnicodeEncodeError("utf-8", "a\ud800", 1, 2, "surrogates not allowed"),
        ValueError("embedded null byte"),
        OSError(errno.ELOOP, "Too many levels of symbolic links", "a"),
    ],
)
def test_paths_that_the_system_does_not_take_are_bad_input(tmp_path, error):
    code, line = exit_codes.code_and_line(error, ["import", "p", "w"], tmp_path)
    assert code == 3 and len(line) < 400 and not list(tmp_path.iterdir())
