"""Commands as text and as scripts."""

import shlex

from stages.viewing.commands import as_text, command, script_of


def test_commands_are_quoted_for_a_shell():
    arguments = command("select", "my work", None, of="a b", name="")
    assert as_text(arguments) == "stylerf select 'my work' --of 'a b'"
    script = script_of([arguments])
    assert script.startswith("#!/bin/sh\nset -e\n")
    assert shlex.split(script.splitlines()[2]) == ["stylerf", *arguments]
