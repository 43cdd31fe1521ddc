"""The runner: reuse, resume after any death, refusals of the machine, honest clocks."""

import errno
import importlib
import inspect
import itertools
import json
import os
import pkgutil
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, is_dataclass, replace
from functools import partial as partial_call

import numpy as np
import pytest

import stages.configs
from schemas import atomic_write
from schemas import partial_artifact as partial
from schemas.artifact import VERB_OF
from schemas.canonical_json import file_sha256
from schemas.errors import ArtifactDamaged, ArtifactStale, BadInput, OutOfResources, UsageError
from schemas.manifest import MANIFEST, Recipe
from schemas.work_folder import Artifact, WorkFolder
from stages.configs import option, options_of
from stages.run import clock, runner
from stages.run.progress import Context, Silent
from stages.run.runner import Spec, execute, recipe_of
from tests.conftest import REPOSITORY
from tests.stages.toy_stage import SPEC, ToyConfig, run


def toy(work: WorkFolder, name="fox", config=None, inputs=None, force=False, seed=0, function=run):
    return execute(SPEC, function, work, name, inputs or {}, config or ToyConfig(), Context(seed=seed), force)


@pytest.fixture
def expected(tmp_path) -> str:
    """Digest of the files that an undisturbed run makes."""
    return toy(WorkFolder(tmp_path / "undisturbed"))[0].digest


def test_a_standing_artifact_is_reused_and_a_changed_recipe_is_not(tmp_path):
    work, calls = WorkFolder(tmp_path), []

    def counted(*arguments):
        calls.append(1)
        return run(*arguments)

    first, reused = toy(work, function=counted)
    assert not reused and first.manifest.figures["list"] == [1] and first.manifest.config == {"steps": 30, "pause": 0.0}
    again, reused = toy(work, function=counted)
    assert reused and again.digest == first.digest and len(calls) == 1
    assert toy(work, function=counted, config=ToyConfig(pause=0.5))[1]  # which has no say in the result
    assert not toy(work, function=counted, config=ToyConfig(steps=31))[1]
    assert not toy(work, function=counted)[1]
    assert not toy(work, function=counted, force=True)[1]
    assert toy(work, function=counted, seed=0)[1] and not toy(work, function=counted, seed=1)[1]
    assert len(calls) == 5


def test_manifest_tells_versions_and_inputs(tmp_path):
    work = WorkFolder(tmp_path)
    source = execute(Spec("src", "import", 1, "scene"), run, work, "fox", {}, ToyConfig(steps=3), Context())[0]
    made = toy(work, inputs={"scene": source})[0].manifest
    assert [(ref.role, ref.kind, ref.name, ref.digest) for ref in made.inputs] == [
        ("scene", "scene", "fox", source.digest)
    ]
    assert made.versions["numpy"] == np.__version__ and made.versions["python"].startswith("3.")


def test_inputs_are_verified_before_a_run(tmp_path):
    work = WorkFolder(tmp_path)
    source = execute(Spec("src", "import", 1, "scene"), run, work, "fox", {}, ToyConfig(steps=3), Context())[0]
    data = bytearray(source.file("field.safetensors").read_bytes())
    data[-3] ^= 4
    source.file("field.safetensors").write_bytes(data)
    with pytest.raises(ArtifactDamaged, match=r"field\.safetensors was altered"):
        toy(work, inputs={"scene": source})


def test_nothing_takes_the_place_of_what_it_is_made_from(tmp_path):
    work = WorkFolder(tmp_path)
    first = toy(work, "fit")[0]
    second = toy(work, "red", inputs={"field": first})[0]
    before = snapshot(work)
    for name, source in (("fit", first), ("red", second), ("fit", second)):
        with pytest.raises(UsageError, match=f"field {name} would replace what it is made from; give another --name"):
            toy(work, name, inputs={"field": source})
    assert snapshot(work) == before


def snapshot(work: WorkFolder) -> dict[str, str]:
    return {one.name: one.digest for one in work.artifacts()}


def test_the_verb_of_every_stage_is_known_where_one_is_damaged():
    modules = [path for path in (REPOSITORY / "stages").glob("*.py") if "\nSPEC = " in path.read_text()]
    specs = [importlib.import_module(f"stages.{path.stem}").SPEC for path in modules]
    # A scene with a fault lies in a work folder of `stress`, which makes it again by itself.
    assert {spec.stage: spec.verb for spec in specs if spec.stage != "corrupt_scene"} == VERB_OF


def in_child(action) -> int:
    """Wait status of a forked child that runs `action` and ends without any of the interpreter's clean-up."""
    child = os.fork()
    if child == 0:
        try:
            action()
            os._exit(0)
        except BaseException:
            os._exit(9)
    return child


def test_kill_at_random_moments_then_resume_gives_the_same_result(tmp_path, expected):
    chance, deaths, paced = random.Random(5), 0, ToyConfig(pause=0.003)
    for number in range(20):
        work = WorkFolder(tmp_path / f"{number}")
        child = in_child(partial_call(toy, work, config=paced))
        # A random place in the run rather than a random time: other jobs may share the machine.
        reached, deadline = chance.randrange(11), time.monotonic() + 20
        while len(list(work.root.rglob("[0-9]*.png"))) < reached and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(chance.uniform(0.0, 0.02))
        os.kill(child, signal.SIGKILL)
        deaths += os.WIFSIGNALED(os.waitpid(child, 0)[1])
        for artifact in work.artifacts():
            artifact.verify()
        made = toy(work, config=paced)[0]
        made.verify()
        assert files_of(made) == files_of(expected_artifact(tmp_path))
        assert os.listdir(work.root / "field").count(".fox.partial") == 0
    assert deaths >= 10, "too few children died in time for the test to mean anything"


def expected_artifact(tmp_path) -> Artifact:
    return WorkFolder(tmp_path / "undisturbed").get("field", "fox")


def files_of(artifact: Artifact) -> list[str]:
    return [record.sha256 for record in artifact.manifest.files]


def die_at(number: int, action) -> None:
    """Runs `action` and kills this process before the `number`th flush, rename or removal of anything."""
    count = itertools.count()

    def deadly(function):
        def called(*arguments, **keywords):
            if next(count) == number:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **keywords)

        return called

    for name in ("fsync", "replace", "rename"):
        setattr(os, name, deadly(getattr(os, name)))
    partial._exchange = deadly(partial._exchange)
    shutil.rmtree = deadly(shutil.rmtree)
    action()


@pytest.mark.parametrize("replaced", [False, True])
def test_a_death_at_any_flush_rename_or_removal_leaves_old_or_new(tmp_path, replaced):
    config = ToyConfig(steps=4)
    wanted = files_of(toy(WorkFolder(tmp_path / "undisturbed"), config=config)[0])
    for number in itertools.count():
        work = WorkFolder(tmp_path / f"{number}")
        old = toy(work, config=ToyConfig(steps=3))[0].digest if replaced else None
        child = in_child(partial_call(die_at, number, partial_call(toy, work, config=config)))
        died = os.WIFSIGNALED(os.waitpid(child, 0)[1])
        for artifact in work.artifacts():
            artifact.verify()
            assert artifact.digest == old or files_of(artifact) == wanted
        assert len(work.artifacts()) == 1 or not replaced
        made = toy(work, config=config)[0]
        made.verify()
        assert files_of(made) == wanted
        # Also where the run died with its artifact in place, before it had tidied up.
        assert work.unfinished() == [] and not list(work.root.rglob(".*.partial"))
        if not died:
            break
    assert number > 15


def test_a_stage_resumes_where_it_stopped_and_the_clock_adds_up(tmp_path, expected, monkeypatch):
    monkeypatch.setattr(clock, "SAVED_EVERY_SECONDS", 0.01)
    work, said = WorkFolder(tmp_path / "x"), []

    class Heard(Silent):
        def say(self, text):
            said.append(text)

    def interrupted(inputs, config, partial, context):
        with pytest.raises(ZeroDivisionError):
            run(inputs, ToyConfig(steps=15), Explodes(partial), context)
        time.sleep(0.2)
        raise KeyboardInterrupt

    class Explodes:
        """Lets the toy save its checkpoints but not finish."""

        def __init__(self, partial):
            self.checkpoint = partial.checkpoint
            self.real = partial.path

        @property
        def path(self):
            if (self.checkpoint / "state.safetensors").is_file() and len(list(self.real.rglob("*.png"))) == 5:
                raise ZeroDivisionError
            return self.real

    with pytest.raises(KeyboardInterrupt):
        toy(work, function=interrupted)
    assert work.artifacts() == [] and work.unfinished() == [("field", "fox")]
    made, _ = execute(SPEC, run, work, "fox", {}, ToyConfig(), Context(progress=Heard()))
    assert said == ["resuming the interrupted toy of fox"]
    assert files_of(made) == files_of(expected_artifact(tmp_path))
    assert made.manifest.figures["runs"] == 2
    assert 0.2 <= made.manifest.seconds < 20
    assert 5 < made.manifest.peak_memory_mb < 50_000


def test_expensive_work_with_other_options_is_not_lost_without_a_word(tmp_path, expected, monkeypatch):
    work, said = WorkFolder(tmp_path / "x"), []

    class Heard(Silent):
        def say(self, text):
            said.append(text)

    def requested(config, **more):
        return execute(SPEC, run, work, "fox", {}, config, Context(progress=Heard()), protect=True, **more)

    def interrupted(inputs, config, partial, context):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        toy(work, function=interrupted)
    reported = json.loads((work.root / "field/.fox.partial/clock.json").read_text())
    (work.root / "field/.fox.partial/clock.json").write_text(json.dumps(reported | {"seconds": 3300.0}))
    with pytest.raises(ArtifactStale, match="55 min of work with --steps 30, would be lost; run `stylerf toy`"):
        requested(ToyConfig(steps=31))
    made, _ = requested(ToyConfig())
    assert made.digest == expected and made.manifest.seconds > 3300
    assert requested(ToyConfig())[1]
    assert said == ["resuming the interrupted toy of fox"]
    requested(ToyConfig(steps=31))
    assert said[1:] == [
        "field fox, 55 min of work with --steps 30, will be replaced when this is done; "
        "`stylerf toy --name NAME` keeps both"
    ]
    requested(ToyConfig())  # what took a moment goes without a word
    with pytest.raises(KeyboardInterrupt):
        toy(work, function=interrupted, config=ToyConfig(steps=40))
    requested(ToyConfig(steps=41))
    assert len(said) == 2
    with pytest.raises(KeyboardInterrupt):
        toy(work, function=interrupted)
    (work.root / "field/.fox.partial/clock.json").write_text(json.dumps(reported | {"seconds": 3300.0}))
    requested(ToyConfig(steps=42), force=True)
    assert work.unfinished() == []


def test_options_to_go_on_with_are_reported_as_a_command_line_takes_them():
    before = Recipe("toy", 1, {"remember": False, "masks": True, "layers": ["a b", "c"], "steps": 30}, [], seed=7)
    now = Recipe("toy", 1, {"remember": True, "masks": False, "layers": [], "steps": 30}, [], seed=0)
    assert now.other_options(before) == "--no-remember, --masks, --layers 'a b' c, --seed 7"


def test_expensive_work_on_other_inputs_is_not_replaced_without_a_word(tmp_path, monkeypatch):
    work, said = WorkFolder(tmp_path / "x"), []
    monkeypatch.setattr("stages.run.runner.EXPENSIVE_SECONDS", 0.0)

    class Heard(Silent):
        def say(self, text):
            said.append(text)

    def requested(steps: int, inputs: dict, spec: Spec = SPEC):
        return execute(spec, run, work, "fox", inputs, ToyConfig(steps=steps), Context(progress=Heard()), protect=True)

    source, _ = toy(work, "photos")
    requested(5, {"scene": source})
    source, _ = toy(work, "photos", ToyConfig(steps=7))
    requested(5, {"scene": source})
    assert [line.partition("work ")[2].partition(",")[0] for line in said] == ["with field photos as it was"]
    source, _ = toy(work, "photos", ToyConfig(steps=8))
    requested(6, {"scene": source})
    requested(6, {"scene": source}, replace(SPEC, revision=SPEC.revision + 1))
    assert "work with --steps 5, field photos as it was, will" in said[1]
    assert f"work with revision {SPEC.revision} of {SPEC.stage}, will" in said[2] and len(said) == 3


def test_where_a_file_lies_has_no_say_once_its_content_is_known():
    @dataclass(frozen=True)
    class Config:
        style: str = option("", help="a file", digest="style_digest")
        style_digest: str = ""

    def made(*values: str):
        return recipe_of(SPEC, {}, Config(*values), 0)

    assert made("/here/a.png", "12").digest == made("/there/b.png", "12").digest
    assert made("/here/a.png", "12").digest != made("/here/a.png", "13").digest
    assert made("/here/a.png", "").digest != made("/there/b.png", "").digest
    assert made("/here/a.png", "12").config["style"] == "/here/a.png"  # reported in the manifest all the same


def test_a_file_that_is_gone_at_the_end_does_not_cost_the_run(tmp_path):
    @dataclass(frozen=True)
    class Config(ToyConfig):
        style: str = option("", help="a file", digest="style_digest")
        style_digest: str = ""

    style = tmp_path / "style.png"
    style.write_bytes(b"paint")
    spec = replace(SPEC, outside=lambda config: {"style_digest": file_sha256(config.style)})
    config = Config(style=str(style), style_digest=file_sha256(style))

    def moved(*arguments):
        figures = run(*arguments)
        style.rename(tmp_path / "elsewhere.png")
        return figures

    work = WorkFolder(tmp_path / "work")
    with pytest.raises(BadInput, match=r"style\.png was removed while .* needed it; put it back") as gone:
        execute(spec, moved, work, "fox", {}, config, Context())
    assert gone.value.keeps_run and list((tmp_path / "work").rglob("*.partial"))
    (tmp_path / "elsewhere.png").rename(style)
    assert execute(spec, run, work, "fox", {}, config, Context())[0].manifest.figures["runs"] == 2

    def refused(config):
        raise BadInput("cams.json does not exist; restore it")

    with pytest.raises(BadInput, match=r"cams\.json does not exist; restore it; .* put it back") as gone:
        execute(replace(spec, outside=refused), run, work, "bear", {}, config, Context())
    assert gone.value.keeps_run and work.unfinished() == [("field", "bear")]


def test_expensive_work_of_other_inputs_is_reported_when_it_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(partial, "EXPENSIVE_SECONDS", 0.0)
    monkeypatch.setattr(runner, "EXPENSIVE_SECONDS", 0.0)
    work, said = WorkFolder(tmp_path), []

    class Heard(Silent):
        def say(self, text):
            said.append(text)

    def requested(scene, function=run):
        context = Context(progress=Heard())
        return execute(SPEC, function, work, "fox", {"scene": scene}, ToyConfig(), context, protect=True)

    def interrupted(inputs, config, partial, context):
        raise KeyboardInterrupt

    def source(seed):
        spec = Spec("src", "import", 1, "scene")
        return execute(spec, run, work, "main", {}, ToyConfig(steps=3), Context(seed=seed), force=True)[0]

    with pytest.raises(KeyboardInterrupt):
        requested(source(0), interrupted)
    requested(source(1))
    requested(source(2))
    assert said == [
        f"{before}, 0 min of work with scene main as it was, {after}"
        for before, after in (
            ("an interrupted `stylerf toy` of field fox", "cannot resume; deleting it"),
            ("field fox", "will be replaced when this is done; `stylerf toy --name NAME` keeps both"),
        )
    ]


def test_a_users_own_files_are_not_deleted_even_with_force(tmp_path):
    work = WorkFolder(tmp_path)
    made = toy(work)[0]
    (made.path / "comp.nk").write_text("mine")
    assert toy(work)[1]  # what stands is of use as before
    for more in ({"force": True}, {"seed": 1}):
        with pytest.raises(ArtifactDamaged, match=r"comp\.nk would be deleted"):
            toy(work, **more)
    assert (made.path / "comp.nk").read_text() == "mine"


def test_peak_memory_is_that_of_the_stage_not_of_the_one_before(tmp_path):
    def greedy(inputs, config, partial, context):
        return {"sum": float(np.ones(40_000_000).sum())}

    big = toy(WorkFolder(tmp_path), "big", function=greedy)[0].manifest.peak_memory_mb
    small = toy(WorkFolder(tmp_path), "small", ToyConfig(steps=1))[0].manifest.peak_memory_mb
    if not os.access("/proc/self/clear_refs", os.W_OK):
        pytest.skip("this system cannot reset the memory peak of a process")
    assert big > small + 250


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "no space left"),
        (PermissionError(errno.EACCES, "Permission denied"), "no permission"),
        (MemoryError(), "out of memory"),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), "out of memory"),
        (OSError(errno.EIO, "Input/output error", "/disk/7.exr"), "/disk/7.exr: Input/output error; rerun"),
        (TimeoutError(errno.ETIMEDOUT, "Connection timed out"), "Connection timed out"),
        (OSError(errno.ESTALE, "Stale file handle"), "Stale file handle"),
        (RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory: you tried 9"), "out of memory"),
        (type("OutOfMemoryError", (RuntimeError,), {})("CUDA out of memory"), "out of memory"),
    ],
)
def test_a_machine_that_refuses_is_reported_and_the_run_can_be_resumed(tmp_path, fault, words, expected):
    def refused(inputs, config, partial, context):
        (partial.checkpoint / "kept").write_text("")
        raise fault

    work = WorkFolder(tmp_path / "x")
    with pytest.raises(OutOfResources, match=words) as caught:
        toy(work, function=refused)
    assert "\n" not in str(caught.value)
    assert (tmp_path / "x/field/.fox.partial/checkpoint/kept").exists()
    assert toy(work)[0].digest == expected


def test_a_codec_that_tells_no_reason_keeps_the_run(tmp_path):
    def failing(*_):
        raise OSError("encoder error -2")

    with pytest.raises(OSError, match="encoder error -2"):
        toy(WorkFolder(tmp_path), function=failing)
    assert WorkFolder(tmp_path).unfinished() == [("field", "fox")]


@pytest.mark.parametrize(
    "fault",
    [BadInput("no photos"), ZeroDivisionError(), OSError(errno.ENOENT, "gone"), IsADirectoryError(errno.EISDIR, "")],
)
def test_other_faults_leave_nothing_that_would_fail_again(tmp_path, fault):
    def failing(*_):
        raise fault

    with pytest.raises(type(fault)):
        toy(WorkFolder(tmp_path), function=failing)
    assert WorkFolder(tmp_path).unfinished() == []
    assert os.listdir(tmp_path / "field") == [".fox.lock"]


def test_ctrl_c_keeps_the_checkpoint(tmp_path, expected):
    work = WorkFolder(tmp_path / "x")
    child = in_child(lambda: toy(work, config=ToyConfig(pause=0.05)))
    deadline = time.monotonic() + 10
    while not list(work.root.rglob("state.safetensors")) and time.monotonic() < deadline:
        time.sleep(0.01)
    os.kill(child, signal.SIGINT)
    assert os.WEXITSTATUS(os.waitpid(child, 0)[1]) == 9
    assert work.unfinished() == [("field", "fox")]
    assert (work.root / "field/.fox.partial/clock.json").is_file()
    assert files_of(toy(work, config=ToyConfig(pause=0.05))[0]) == files_of(expected_artifact(tmp_path))


FILL = """
import sys, numpy as np
from pathlib import Path
from schemas.errors import OutOfResources
from schemas.work_folder import WorkFolder
from stages.run.progress import Context
from stages.run.runner import Spec, execute, recipe_of
from schemas.tensors import save_tensors
import tests.stages.toy_stage as toy

def run(inputs, config, partial, context):
    toy.run(inputs, config, partial, context)
    save_tensors(partial.path / "big.safetensors", {"a": np.ones(int(sys.argv[2]))})
    return {}

if len(sys.argv) > 3:
    import resource, signal
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
try:
    execute(toy.SPEC, run, WorkFolder(sys.argv[1]), "fox", {}, toy.ToyConfig(), Context())
    print("made")
except OutOfResources as error:
    print(error)
"""


def fill(folder, *arguments) -> str:
    command = [sys.executable, "-c", FILL, str(folder), *(str(item) for item in arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=REPOSITORY)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    return done.stdout


def test_a_file_size_limit_is_reported_and_the_next_run_finishes(tmp_path):
    assert fill(tmp_path, 10_000, 30_000).startswith("no space left")
    assert WorkFolder(tmp_path).artifacts() == []
    assert fill(tmp_path, 10_000) == "made\n"
    WorkFolder(tmp_path).get("field", "fox").verify()


def test_a_full_disk_is_reported_and_the_next_run_finishes(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=256k", "none", str(disk)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("mounting a small tmpfs needs root; the file size limit above tests the same path")
    try:
        reported = fill(disk, 100_000)
        assert reported.startswith("no space left") and "MB free" in reported
        assert WorkFolder(disk).artifacts() == [] and WorkFolder(disk).unfinished() == [("field", "fox")]
        assert fill(disk, 1000) == "made\n"
        WorkFolder(disk).get("field", "fox").verify()
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_folder_without_write_permission_is_reported(tmp_path):
    if os.geteuid() == 0:
        pytest.skip("root may write anywhere; the next test refuses through the system calls")
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(OutOfResources, match="no permission"):
            toy(WorkFolder(tmp_path / "work"))
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.parametrize("call", ["mkdir", "open"])
def test_a_refused_system_call_is_reported(tmp_path, monkeypatch, call):
    real = getattr(os, call)

    def refuse(path, *arguments, **keywords):
        if str(path).startswith(str(tmp_path)):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return real(path, *arguments, **keywords)

    monkeypatch.setattr(os, call, refuse)
    with pytest.raises(OutOfResources, match="no permission"):
        toy(WorkFolder(tmp_path / "work"))


def test_a_second_writer_is_refused(tmp_path):
    work = WorkFolder(tmp_path)

    def nested(*arguments):
        with pytest.raises(OutOfResources, match="another process"):
            toy(work)
        return run(*arguments)

    toy(work, function=nested)
    assert (work.get("field", "fox").path / MANIFEST).is_file()


def test_an_artifact_finished_by_another_in_the_meantime_is_reused(tmp_path, monkeypatch):
    work, begin = WorkFolder(tmp_path), WorkFolder.begin

    def late(self, *arguments, **more):
        monkeypatch.undo()
        toy(work)
        return begin(self, *arguments, **more)

    monkeypatch.setattr(WorkFolder, "begin", late)
    assert toy(work)[1] is True


def test_versions_and_refusals_know_only_their_own():
    assert runner.refusal_of_machine(ValueError("no"), atomic_write.Path(".")) is None
    assert set(runner.versions()) >= {"python", "stylerf"}


def test_without_paths_a_recipe_is_the_same_and_tells_names_alone():
    config = {"style": "/ann/a=b.png", "reference": ["0012=/ann/p.png", "7=q.png"], "pause": 0.5, "of": "/x/y"}
    recipe = Recipe("toy", 1, config, [], 0, ["style", "reference", "pause"])
    named = runner.without_folders(recipe)
    assert named.config == {"style": "a=b.png", "reference": ["0012=p.png", "7=q.png"], "pause": 0.5, "of": "/x/y"}
    assert named.digest == recipe.digest


def test_every_option_that_names_files_has_a_digest_in_their_place():
    """Else --no-paths would leave its folders in the manifest, and a changed file would go unnoticed."""
    names_files = re.compile(r"FILE|FOLDER|DIR|\.png|\b(file|folder|style image)\b")
    found = set()
    for module in pkgutil.iter_modules(stages.configs.__path__):
        for config in vars(importlib.import_module(f"stages.configs.{module.name}")).values():
            if not (inspect.isclass(config) and is_dataclass(config)):
                continue
            for item in options_of(config):
                what = item.metadata
                text = isinstance(item.default, str | tuple) and what["metavar"] != "N" and not what["choices"]
                if text and names_files.search(f"{what['metavar']} {what['help']}"):
                    found.add(item.name)
                    if config.__name__ == "FarmConfig":  # of no stage: a table of jobs has no manifest
                        continue
                    assert what["digest"], (config.__name__, item.name)
    assert found >= {"images", "source", "features", "style", "reference", "masks", "flow", "path", "mask", "scribble"}


def _during(act, outcome=run):
    """A stage in whose course `act` happens."""

    def stage(*arguments):
        figures = outcome(*arguments)
        act()
        return figures

    return stage


def source_of(work: WorkFolder, seed: int = 0) -> Artifact:
    return execute(Spec("src", "import", 1, "scene"), run, work, "fox", {}, ToyConfig(steps=3), Context(seed=seed))[0]


def test_an_input_altered_while_a_stage_read_it_gives_no_result(tmp_path):
    work = WorkFolder(tmp_path)
    source = source_of(work)

    def flip():
        data = bytearray(source.file("field.safetensors").read_bytes())
        data[-1] ^= 1
        source.file("field.safetensors").write_bytes(data)

    with pytest.raises(ArtifactDamaged, match=r"field\.safetensors was altered"):
        toy(work, inputs={"scene": source}, function=_during(flip))
    assert os.listdir(tmp_path / "field") == [".fox.lock"]


def test_an_input_made_again_while_a_stage_read_it_gives_no_result(tmp_path):
    work = WorkFolder(tmp_path)
    source = source_of(work)
    with pytest.raises(ArtifactStale, match="scene fox was rebuilt while `stylerf toy` was using it"):
        toy(work, inputs={"scene": source}, function=_during(lambda: source_of(work, seed=1)))
    assert not (tmp_path / "field" / "fox").exists()


@dataclass(frozen=True)
class PaintedConfig(ToyConfig):
    style_digest: str = ""


@pytest.mark.parametrize("pinned", [True, False])
def test_a_file_from_outside_that_changed_meanwhile_gives_no_result(tmp_path, pinned):
    painting = tmp_path / "painting"
    painting.write_text("blue")
    spec = replace(SPEC, outside=lambda config: {"style_digest": painting.read_text()})
    config = PaintedConfig(style_digest="blue" if pinned else "")
    stage = _during(lambda: painting.write_text("red"))
    if not pinned:  # a program of one's own that did not ask for it
        assert execute(spec, stage, WorkFolder(tmp_path), "fox", {}, config, Context())[0].name == "fox"
        return
    with pytest.raises(BadInput, match="--style changed while"):
        execute(spec, stage, WorkFolder(tmp_path), "fox", {}, config, Context())
    assert not (tmp_path / "field" / "fox").exists()


@pytest.mark.parametrize("kind", [BadInput, ArtifactDamaged])
def test_a_failed_read_keeps_the_run_whatever_the_error_is_called(tmp_path, kind):
    def failing(inputs, config, partial, context):
        (partial.checkpoint / "kept").write_text("")
        try:
            raise OSError(errno.ESTALE, "Stale file handle")
        except OSError as error:
            raise kind("photo 7 cannot be read") from error

    with pytest.raises(kind):
        toy(WorkFolder(tmp_path), function=failing)
    assert (tmp_path / "field" / ".fox.partial" / "checkpoint" / "kept").exists()


def test_a_partial_run_that_cannot_be_opened_is_reported_and_kept(tmp_path, monkeypatch):
    begun = WorkFolder(tmp_path).begin("field", "fox", recipe_of(SPEC, {}, ToyConfig(), 0))
    begun.release()
    with monkeypatch.context() as failing:
        failing.setattr(partial, "_stored", lambda path: (_ for _ in ()).throw(OSError(errno.EIO, "I/O", str(path))))
        with pytest.raises(OutOfResources, match="rerun the same command to resume"):
            toy(WorkFolder(tmp_path))
    assert WorkFolder(tmp_path).unfinished() == [("field", "fox")]


def test_threads_stand_in_the_manifest(tmp_path):
    context = Context(threads=3)
    assert execute(SPEC, run, WorkFolder(tmp_path), "fox", {}, ToyConfig(), context)[0].manifest.threads == 3
