"""The stages of an edit as commands."""

import pytest

from schemas.errors import UsageError
from stages.viewing.edit_stages import deform_command, distill_command, extract_command, finetune_command
from tests.stages.viewing.command_lines import config_of


def test_the_stages_of_an_edit_are_commands_that_the_command_line_takes(tmp_path):
    work = tmp_path / "my work"
    args, _ = config_of(extract_command(work, "thing"))
    assert args.region == "thing"
    args, _ = config_of(distill_command(work, "red"))
    assert args.edit == "red"
    args, config = config_of(finetune_command(work, "red", 45))
    assert (args.edit, config.budget) == ("red", "45s")
    args, _ = config_of(deform_command(work, "plain"))
    assert args.of == "plain"
    with pytest.raises(UsageError, match="no region yet"):
        extract_command(work, "")
    with pytest.raises(UsageError, match="no edit yet"):
        distill_command(work, "")
