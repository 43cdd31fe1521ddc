"""Commands as text and as scripts."""

import shlex

from stages.viewing.commands import as_text, command, script_of, wrapped


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
