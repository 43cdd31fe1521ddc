"""Bars on a terminal, sparse lines elsewhere, nothing for what is soon over."""

import io

import pytest

from stylerf_cli.progress import Bars, duration


class Terminal(io.StringIO):
    encoding = "utf-8"

    def __init__(self, terminal=True):
        super().__init__()
        self.terminal = terminal

    def isatty(self):
        return self.terminal


class Time:
    now = 100.0

    def __call__(self):
        return self.now


def run(stream, seconds, total=1000.0, per_second=10, note="27.1 dB", unit="step"):
    """A loop of eight updates a second: steps that binary fractions hold exactly."""
    time = Time()
    bars = Bars(stream, time)
    bars.start("fit", total, unit)
    for tick in range(int(seconds * 8) + 1):
        time.now = 100 + tick / 8
        bars.update(tick * per_second / 8, note)
    bars.finish()
    return stream.getvalue()


@pytest.mark.parametrize("terminal", [True, False])
def test_nothing_under_two_seconds(terminal):
    assert run(Terminal(terminal), 1.9) == ""


def test_a_terminal_shows_share_rate_quality_and_time_left():
    text = run(Terminal(), 20)
    frames = text.split("\r\x1b[K")
    assert frames[0] == "" and "\n" not in text[: text.rindex("\r")]
    assert frames[-2] == "fit: █████░░░░░░░░░░░░░░░░░░░  20 %  200/1,000  10/s  27.1 dB  1 min 20 s left"
    assert frames[-1] == "fit: 200 steps in 20 s, 27.1 dB\n"
    assert all(len(frame) < 80 for frame in frames)


def test_elsewhere_there_is_a_plain_line_every_five_seconds():
    lines = run(Terminal(terminal=False), 20).splitlines()
    assert lines[0].startswith("fit:   2 %  20/1,000  10/s  27.1 dB")
    assert len(lines) == 5 and lines[-1] == "fit: 200 steps in 20 s, 27.1 dB"
    assert not any("\r" in line or "█" in line for line in lines)


def test_a_resumed_run_tells_its_own_rate():
    time, stream = Time(), Terminal(terminal=False)
    bars = Bars(stream, time)
    bars.start("fit", 1000)
    for tick in range(31):
        time.now = 100 + tick / 10
        bars.update(900 + tick)
    assert "10/s" in stream.getvalue() and "8.0 s left" in stream.getvalue()


def test_unknown_length_and_budgets_in_seconds():
    assert "200  10/s  27.1 dB  " in run(Terminal(), 20, total=None)
    budget = run(Terminal(), 20, total=60, per_second=1, unit="s")
    assert "33 %  27.1 dB  40 s left" in budget and budget.endswith("fit: 20 s in 20 s, 27.1 dB\n")


def test_a_pause_on_no_budgets_clock_says_nothing_of_the_time_left():
    time, stream = Time(), Terminal(terminal=False)
    bars = Bars(stream, time)
    bars.start("fit", 60, "s")
    for tick in range(31):
        time.now = 100 + tick
        bars.update(tick)
    time.now += 60  # a compile
    bars.update(30)
    assert stream.getvalue().splitlines()[-1].endswith("50 %  1 min 00 s left")


def test_notes_stand_above_the_bar():
    time, stream = Time(), Terminal()
    bars = Bars(stream, time)
    bars.say("first")
    bars.start("fit", 10)
    time.now += 3
    bars.update(1)
    bars.say("second")
    assert stream.getvalue().endswith("\r\x1b[Ksecond\n") and stream.getvalue().startswith("first\n")


class Closed(io.StringIO):
    """A pipe whose reader has gone."""

    attempts = 0

    def write(self, text):
        self.attempts += 1
        raise BrokenPipeError


def test_a_stream_that_nobody_reads_any_more_ends_no_run():
    stream = Closed()
    bars = Bars(stream)
    bars.say("to nobody")
    bars.start("fit", 10)
    bars.update(5)
    bars.finish()
    bars.say("again")
    assert stream.attempts == 1  # and it is not asked again


def test_terminals_without_unicode():
    stream = Terminal()
    stream.encoding = "ascii"
    shown = run(stream, 5)
    assert shown.isascii() and "27.1 dB" in shown and shown.count("\r") > 1


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(-1, "0.0 s"), (0.44, "0.4 s"), (9.96, "10 s"), (59.4, "59 s"), (59.6, "1 min 00 s"), (200, "3 min 20 s"),
     (3599.7, "1 h 00 min"), (7500, "2 h 05 min")],
)  # fmt: skip
def test_durations(seconds, words):
    assert duration(seconds) == words
