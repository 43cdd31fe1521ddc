"""Runs: what they say, how they end, and that stopping is Ctrl-C."""

import sys
import threading
from functools import partial
from types import SimpleNamespace

from stages.viewing.commands import as_text
from stages.viewing.page import Page
from stages.viewing.runs import Run, Runs

TALK = "print('one'); print('two')"
WAIT = """
import time
try:
    print('ready', flush=True)
    time.sleep(60)
except KeyboardInterrupt:
    print('saved', flush=True)
    raise SystemExit(130)
"""


def started(code: str, *common: str):
    said, ended = [], threading.Event()
    run = Run(["-c", code], common, lambda run: said.append(run.last), lambda run: ended.set(), [sys.executable])
    return run, said, ended


def test_lines_and_exit_code_are_kept():
    run, said, ended = started(TALK + "; import sys; print(sys.argv[1]); sys.exit(3)", "--threads")
    assert ended.wait(30) and run.wait() == 3
    assert list(run.lines) == said == ["one", "two", "--threads"]


def test_stopping_interrupts_and_waits_for_what_is_saved():
    ready = threading.Event()
    ended = threading.Event()
    run = Run(["-c", WAIT], (), lambda run: ready.set(), lambda run: ended.set(), [sys.executable])
    assert ready.wait(30)
    run.stop()
    assert run.wait() == 130 and ended.wait(5)
    assert run.last == "saved" and run.stopped
    run.stop()  # harmless


def test_the_script_of_a_session_has_the_options_that_its_runs_had(monkeypatch):
    echo = partial(Run, program=[sys.executable, "-c", "import sys; print(sys.argv[1:])"])
    monkeypatch.setattr("stages.viewing.runs.Run", echo)
    runs = Runs(("--seed", "7", "--device", "cpu"))
    run = runs.start(["fit", "w"])
    assert run.wait() == 0 and run.last == "['fit', 'w', '--seed', '7', '--device', 'cpu']"
    assert as_text(runs.whole(["fit", "w"])) in runs.script().splitlines()
    assert runs.script().count("stylerf fit w --seed 7 --device cpu") == 1


def test_errors_of_the_page_leave_a_run_its_end(monkeypatch):
    monkeypatch.setattr("stages.viewing.runs.Run", partial(Run, program=[sys.executable, "-c", TALK]))
    ended = []

    def changed() -> None:
        if runs.present is not None and runs.present.lines:
            raise OSError("gone")

    runs = Runs(changed=changed)
    run = runs.start(["fit"], ended.append)
    assert run.wait() == 0 and ended == [run]
    assert {"one", "two", "the page could not show this run: gone"} == set(run.lines)
    assert runs.start(["fit"]).wait() == 0


def test_one_list_that_fails_leaves_the_others_up_to_date():
    messages, listed = [], []
    page = SimpleNamespace(desk=SimpleNamespace(runs=Runs()), status=SimpleNamespace(), _complaint="")
    page.tell = lambda text, failed: messages.append(text)
    page.rest = [lambda: 1 / 0, lambda: listed.append(1)]
    for _ in range(2):
        Page.changed(page)
    assert messages == ["division by zero"] and listed == [1, 1]
