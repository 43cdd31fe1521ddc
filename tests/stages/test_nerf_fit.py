"""Which capacities a fit climbs, by the space of its scene."""

from types import SimpleNamespace

import pytest

from stages.configs.fit import FitConfig
from stages.nerf_fit import _settings
from stylerf.geometry.space import Space
from stylerf.training.ladders import LADDER
from tests.stylerf.small import SPACES

SCENE = SimpleNamespace(background="none", layout="unbounded")


def settings(space: Space, **options):
    return _settings(FitConfig(**options), SCENE, space)


def test_a_density_in_a_contraction_may_grow_finer_than_its_colour():
    asked = settings(SPACES["contraction"])
    assert asked.ladder[:-1] == LADDER
    assert asked.ladder[-1].resolution == 384 and asked.ladder[-1].colour.resolution == 256
    assert len(asked.shares) == len(asked.longest) == len(asked.ladder)
    assert sorted(asked.shares) == list(asked.shares) and asked.shares[-1] < asked.held_out_until


@pytest.mark.parametrize(
    ("space", "options"),
    [("box", {}), ("frustum", {}), ("contraction", {"field": "voxel"}), ("contraction", {"head": "mlp"})],
)
def test_elsewhere_and_with_other_kinds_the_ladder_ends_sooner(space, options):
    asked = settings(SPACES[space], **options)
    assert asked.ladder == LADDER and len(asked.shares) == len(asked.longest) == len(asked.ladder)


def test_a_capacity_given_by_hand_is_climbed_to_whatever_the_space():
    asked = settings(SPACES["contraction"], capacity="fixed:192x8x16")
    last = asked.ladder[-1]
    assert (last.resolution, last.density_rank, last.colour_rank) == (192, 8, 16) and asked.always_climb
    assert len(asked.shares) == len(asked.ladder) - 1


def test_batches_grow_with_the_time_there_is_unless_their_size_is_given():
    space = SPACES["box"]
    budgets = ("20s", "60s", "2m", "5m", "900")
    assert [_settings(FitConfig(budget=one), SCENE, space).samples for one in budgets] == [
        30_000, 30_000, 60_000, 90_000, 90_000,
    ]  # fmt: skip
    assert len({_settings(FitConfig(budget=one), SCENE, space, "cuda").samples for one in budgets}) == 1
    assert all(_settings(FitConfig(samples=2000), SCENE, space, device).samples == 2000 for device in (None, "cuda"))
    with pytest.raises(ValueError, match="samples must be 1000 or more"):
        FitConfig(samples=999)
