"""Commands as text and as scripts."""

import shlex

import pytest

from stages.viewing.commands import as_text, command, fenced, script_of, wrapped


def test_commands_are_quoted_for_a_shell():
    arguments = command("select", "my work", None, of="a b", name="")
    assert as_text(arguments) == "stylerf select 'my work' --of 'a b'"
    script = script_of([arguments])
    assert script.startswith("#!/bin/sh\nset -e\n")
    assert shlex.split(script.splitlines()[2]) == ["stylerf", *arguments]


def test_long_commands_wrap_at_options_and_mean_the_same_to_a_shell():
    arguments = ["select", "my work", "--at", "a b:3,4", "--tolerance", "40", "--steps", "2", "--of", "plain"]
    text = wrapped(arguments, 30)
    lines = text.split("\n")
    assert len(lines) > 2 and all(len(line) <= 32 for line in lines)
    assert [line[:4] for line in lines[1:]] == ["  --"] * (len(lines) - 1)
    assert shlex.split(text.replace("\\\n", "")) == ["stylerf", *arguments]


@pytest.mark.parametrize("hostile", ["a\n```\n\n<b>x</b>\n", "a\r````\r<b>x</b>", "````` <b>", "x\u2028```\n~~~<b>"])
def test_no_word_of_a_command_ends_the_block_that_shows_it(hostile):
    first, *lines, last = fenced("sh", wrapped(["stylize", "w", "--style", hostile, "--name", "x"], 1)).split("\n")
    fence = first.removesuffix("sh")
    assert fence == last == "`" * len(fence) and not any(fence in line for line in lines)
    assert [line[:8] for line in lines] == ["stylerf ", "  --styl", "  --name"]
    assert "](" not in fenced("sh", "![](/etc/passwd)")
