"""A tiny still life, photographed, fitted, stylized and rendered once for all tests that start from there."""

import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from stages.pipeline import resources
from stages.pipeline.demo_scene import PAINTING, write_demo
from stages.run.progress import Silent
from tests.stages.photo_room import walk, write_photos
from tests.stylerf_cli.long_stages import LongStage, arguments_of, before, undisturbed
from tests.stylerf_cli.nursery import WITHOUT_GPUS, Nursery

FIT = ("--budget", "60", "--no-buffers", "--capacity", "fixed:32x8x8", "--samples", "3000")
DEFORM = ("--steps", "20", "--vertices", "12", "--width", "16", "--patience-db", "0")
STYLIZE = ("--budget", "6", "--refit-steps", "40", "--levels", "4", "--finest", "64", "--table-bits", "12")


@pytest.fixture(scope="package", autouse=True)
def without_gpus():
    """`--device auto` is the CPU here, in children too: a GPU's runs agree to rounding, and bits are compared.

    The nursery begins before this, with the same variables.
    """
    with pytest.MonkeyPatch.context() as patched:
        for name, value in WITHOUT_GPUS.items():
            patched.setenv(name, value)
        patched.setattr(resources, "_may_have_gpu", lambda: False)
        yield


@pytest.fixture(scope="session")
def nursery():
    """Where commands are started as processes of their own."""
    made = Nursery()
    yield made
    made.close()


@pytest.fixture(scope="session")
def in_memory():
    """A folder in memory where there is such a place: stages flush all they write, which a busy disk makes slow."""
    place = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=place) as folder:
        yield Path(folder)


@pytest.fixture(scope="session")
def photos(in_memory) -> Path:
    """Twelve photos of the still life with poses and true depth, 32 x 32, and a painting."""
    write_demo(in_memory / "photos", 32, 10, 2, 0, 1, Silent())
    return in_memory / "photos"


@pytest.fixture(scope="session")
def finished(in_memory, nursery, photos) -> Path:
    """A work folder with scene `main`, fields `fit`, `fit-deformed`, `painting-arf`, and frames; nobody changes it."""
    work = in_memory / "finished"
    for arguments in (
        ("import", photos, work),
        ("fit", work, *FIT),
        ("stylize", work, "--style", photos / PAINTING, *STYLIZE),
        ("deform", work, "--of", "fit", *DEFORM),
        ("render", work, "--of", "fit", "--path", "test"),
        ("render", work, "--of", "painting-arf", "--path", "test"),
        ("render", work, "--of", "fit", "--path", "orbit", "--count", "9"),
    ):
        command = nursery.run(in_memory / "said", *arguments, "--quiet")
        assert command.code == 0, command.err
    return work


@pytest.fixture
def work(finished, in_memory):
    """A copy of the finished work folder."""
    folder = Path(tempfile.mkdtemp(dir=in_memory))
    shutil.copytree(finished, folder / "work")
    yield folder / "work"
    shutil.rmtree(folder)


@pytest.fixture(scope="session")
def room(in_memory) -> Path:
    """Eight photos without poses, 240 x 180."""
    write_photos(in_memory / "room", walk(8, (0.45, 1.1), width=240, height=180, focal=230.0))
    return in_memory / "room"


@pytest.fixture(scope="session")
def long_stage(in_memory, finished, nursery, photos, room) -> Callable[[str], tuple[LongStage, Path]]:
    """By name: a stage that has run to its end once, and the work folder where `whole` is what it made."""
    made: dict[str, tuple[LongStage, Path]] = {}

    def prepared(name: str) -> tuple[LongStage, Path]:
        if name == "import":
            return imported()
        if name not in made:
            work = in_memory / f"long {name}" / "work"
            shutil.copytree(finished, work)
            for arguments in before(name, work):
                command = nursery.run(in_memory / "said", *arguments, "--quiet")
                assert command.code == 0, command.err
            made[name] = undisturbed(nursery, *arguments_of(name, work, photos, room), work), work
        return made[name]

    def imported() -> tuple[LongStage, Path]:
        """A work folder holds one scene: `whole` lies in another, and each time the folder is empty."""
        folder = in_memory / "long import"
        if "import" not in made:
            folder.mkdir()
            stage = undisturbed(nursery, *arguments_of("import", folder / "whole", photos, room), folder / "whole")
            arguments, _ = arguments_of("import", folder / "work", photos, room)
            made["import"] = replace(stage, arguments=arguments, apart=folder / "whole"), folder / "work"
        shutil.rmtree(folder / "work", ignore_errors=True)
        return made["import"]

    return prepared
