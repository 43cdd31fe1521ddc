"""Native libraries are kept from writing; whatever breaks that off, the command's last words are heard."""

import os
from threading import Event, Thread

import pytest

from schemas import native_output
from schemas.native_output import native_output_audible, native_output_restored, native_output_silenced


def test_native_output_is_silenced_inside_the_block_only(capfd):
    with native_output_silenced():
        os.write(1, b"one")
        with native_output_silenced():
            os.write(2, b"two")
    os.write(1, b"three")
    os.write(2, b"four")
    assert tuple(capfd.readouterr()) == ("three", "four")


@pytest.mark.parametrize("call", [1, 2, 3])
def test_an_interruption_at_its_beginning_or_end_leaves_no_silence(capfd, monkeypatch, call):
    """As the first, second or third file is closed: when silence has just begun, and while it ends."""
    monkeypatch.setattr(native_output, "_depth", 0)  # and back: an ending process may leave it as it is
    close, left = os.close, [call]

    def closing(number: int) -> None:
        close(number)
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt), native_output_restored():
        patch.setattr(native_output.os, "close", closing)
        with native_output_silenced():
            os.write(2, b"not this")
    os.write(2, b"heard")
    assert capfd.readouterr().err == "heard"


def test_a_thread_that_is_still_at_it_does_not_silence_the_last_words(capfd):
    inside, ended = Event(), Event()

    def work() -> None:
        with native_output_silenced():
            inside.set()
            ended.wait(20)

    with native_output_restored():
        thread = Thread(target=work)
        thread.start()
        assert inside.wait(20)
    os.write(2, b"heard")
    ended.set()
    thread.join()
    os.write(2, b", and later")
    assert capfd.readouterr().err == "heard, and later"


def test_what_the_command_prints_is_heard_while_a_thread_is_silenced(capfd):
    inside, ended = Event(), Event()

    def work() -> None:
        with native_output_silenced():
            inside.set()
            ended.wait(20)

    thread = Thread(target=work)
    thread.start()
    assert inside.wait(20)
    with native_output_audible():
        os.write(2, b"progress")
    os.write(2, b"a codec")
    ended.set()
    thread.join()
    with native_output_audible():  # nobody is silenced
        os.write(2, b", done")
    assert capfd.readouterr().err == "progress, done"
