"""kill -9 at random moments of every long stage: what stands stays whole, and the same command ends as if nothing had
happened."""

import shutil
import tempfile
from pathlib import Path

import pytest

from tests.stages.photo_room import walk, write_photos
from tests.stylerf_cli.long_stages import arguments_of, killed_until_done, undisturbed

VERBS = ("import", "fit", "stylize", "render", "eval")


@pytest.fixture(scope="module")
def room(in_memory) -> Path:
    """Eight photos without poses, 240 x 180."""
    write_photos(in_memory / "room", walk(8, (0.45, 1.1), width=240, height=180, focal=230.0))
    return in_memory / "room"


@pytest.fixture(scope="module")
def prepared(request, in_memory, finished, nursery, photos, room):
    """A stage that has once run to its end, and the work folder it did so in."""
    folder = Path(tempfile.mkdtemp(dir=in_memory))
    work = folder / "work"
    shutil.copytree(finished, work)
    arguments, kind = arguments_of(request.param, work, photos, room)
    yield undisturbed(nursery, arguments, kind, work), work
    shutil.rmtree(folder)


@pytest.mark.parametrize("prepared", VERBS, indirect=True)
def test_a_stage_killed_at_two_moments_ends_as_an_undisturbed_one(prepared, nursery):
    stage, work = prepared
    killed_until_done(nursery, stage, work, 2, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("prepared", VERBS, indirect=True)
def test_a_stage_killed_at_twenty_moments_ends_as_an_undisturbed_one(prepared, nursery):
    stage, work = prepared
    killed_until_done(nursery, stage, work, 20, seed=2)
