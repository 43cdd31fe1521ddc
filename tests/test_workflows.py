"""workflows/ and examples/: the shell parses them, and every verb, flag and option in them exists."""

import argparse
import importlib
import json
import os
import re
import subprocess
import sys

import pytest

from schemas.errors import ArtifactStale
from schemas.work_folder import WorkFolder
from stages.configs.render import RenderConfig
from stylerf_cli.arguments import Parser, add_common, add_config, build_config, read_toml
from stylerf_cli.verbs import VERBS
from tests.conftest import REPOSITORY

SCRIPT = REPOSITORY / "workflows" / "scene.sh"
SETTINGS = REPOSITORY / "examples" / "render.toml"
# Writes down what it is called with, and fails where it is reported to.
STAND_IN = """#!{python}
import json, os, sys
with open(os.environ["CALLS"], "a") as calls:
    calls.write(json.dumps(sys.argv[1:]) + "\\n")
sys.exit(3 if sys.argv[1] == os.environ.get("FAIL_AT") else 0)
"""


def scripted(tmp_path, *given, **settings) -> tuple[int, list[list[str]]]:
    """Exit code of the workflow and the commands it ran, with a stand-in for the program."""
    stand_in, calls = tmp_path / "stylerf", tmp_path / "calls"
    stand_in.write_text(STAND_IN.format(python=sys.executable))
    stand_in.chmod(0o755)
    env = {**os.environ, "STYLERF": str(stand_in), "CALLS": str(calls), **settings}
    done = subprocess.run(["sh", str(SCRIPT), *given], env=env, check=False, capture_output=True, cwd=tmp_path)
    return done.returncode, [json.loads(line) for line in calls.read_text().splitlines()] if calls.exists() else []


def test_the_shell_parses_it():
    subprocess.run(["sh", "-n", str(SCRIPT)], check=True)
    assert os.access(SCRIPT, os.X_OK) and "\nset -eu\n" in SCRIPT.read_text()


def test_every_command_is_one_that_its_verb_takes(tmp_path):
    code, calls = scripted(
        tmp_path, "some photos", "my art/starry-night.v2.jpg", "work", "60s", OPTIONS="--seed 7 --quiet"
    )
    assert code == 0
    assert [call[0] for call in calls] == ["import", "fit", "eval", "stylize", "render", "eval", "verify"]
    for verb, *rest in calls:
        module = importlib.import_module(VERBS[verb][0])
        parser = Parser(prog=verb)
        module.add_arguments(parser)
        if module.CONFIG is not None:
            add_config(parser, module.CONFIG)
        add_common(parser)
        args = parser.parse_args(rest)
        assert args.seed == 7 and args.quiet
        if module.CONFIG is not None and verb != "render":
            build_config(module.CONFIG, args, {}, "")
    assert calls[0][1:3] == ["some photos", "work"] and calls[1][1:4] == ["work", "--budget", "60s"]
    # The painting's stem and the method.
    assert calls[4][3] == calls[5][3] == "starry-night.v2-arf"


@pytest.mark.parametrize(
    ("file", "name"), [("my night.jpg", "my_night-arf"), ("été/Übung 3.PNG", "bung_3-arf"), ("星.jpg", r"\d+-arf")]
)
def test_the_field_gets_a_name_that_an_artifact_can_have(tmp_path, file, name):
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text("a painting")
    code, calls = scripted(tmp_path, "photos", file, "work")
    requested = [call[call.index(flag) + 1] for call, flag in zip(calls[3:6], ("--name", "--of", "--of"), strict=True)]
    assert code == 0 and len(set(requested)) == 1 and re.fullmatch(name, requested[0])
    with pytest.raises(ArtifactStale):  # not that it cannot be a name
        WorkFolder(tmp_path).get("field", requested[0])


@pytest.mark.parametrize("verb", ["import", "fit", "stylize", "render", "eval", "verify"])
def test_help_tells_its_flags(verb):
    reported = subprocess.run(
        [sys.executable, "-m", "stylerf_cli.main", verb, "--help"],
        check=True, capture_output=True, text=True, cwd=REPOSITORY,
    ).stdout  # fmt: skip
    lines = re.findall(rf"^run {verb} (.+)$", SCRIPT.read_text(), re.M)
    assert lines
    for line in lines:
        for flag in re.findall(r"--[a-z-]+", line):
            assert re.search(rf"{flag}\b", reported), flag


def test_a_step_that_fails_ends_it(tmp_path):
    code, calls = scripted(tmp_path, "photos", "night.jpg", "work", FAIL_AT="fit")
    assert code == 3 and [call[0] for call in calls] == ["import", "fit"]


def test_too_few_arguments_are_a_usage_fault(tmp_path):
    assert scripted(tmp_path, "photos") == (2, [])


def test_the_example_holds_options_of_render():
    content = read_toml(SETTINGS)
    config = build_config(RenderConfig, argparse.Namespace(), content, str(SETTINGS))
    assert config.path == content["path"] and content.keys() <= set(vars(config))
