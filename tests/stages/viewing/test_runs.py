"""Runs: what they say, how they end, and that stopping is Ctrl-C."""

import sys
import threading

from stages.viewing.runs import Run

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
