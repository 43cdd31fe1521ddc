"""kill -9 at random moments of every long stage: what stands stays whole, and the same command ends as if nothing had
happened."""

import pytest

from tests.stylerf_cli.long_stages import IN_THE_GATE, STAGES, killed_until_done


@pytest.mark.parametrize("name", IN_THE_GATE)
def test_a_stage_killed_at_two_moments_ends_as_an_undisturbed_one(long_stage, nursery, name):
    stage, work = long_stage(name)
    made = killed_until_done(nursery, stage, work, 2, seed=1)
    if name == "fit that grows":
        decisions = " ".join(made.manifest.figures["decisions"])
        assert " over " in decisions and "dropped" in decisions and (" enough" in decisions or "little" in decisions)


@pytest.mark.slow
@pytest.mark.parametrize("name", STAGES)
def test_a_stage_killed_at_twenty_moments_ends_as_an_undisturbed_one(long_stage, nursery, name):
    stage, work = long_stage(name)
    killed_until_done(nursery, stage, work, 20, seed=2)
