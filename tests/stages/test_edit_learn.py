"""Options of learning a look: each reaches the trainer, or is refused where it would do nothing."""

import pytest

from stages.configs.edit import EditConfig
from stages.edit_learn import settings_of


def test_steps_after_pruning_are_those_that_were_requested():
    ordinary = settings_of(EditConfig(recolor=True))
    assert (ordinary.pruned_steps, ordinary.pruned_style_steps) == (100, 40)
    assert settings_of(EditConfig(recolor=True, pruned_steps=7)).pruned_steps == 7
    assert settings_of(EditConfig(style="night.png", pruned_steps=7)).pruned_style_steps == 7


@pytest.mark.parametrize(
    "option",
    [{"crop": (0, 0, 32)}, {"keep_colors": True}, {"style_steps": 9}, {"style_weight": 1.0}, {"features": "hed"},
     {"layers": "conv2"}, {"match": False}, {"style_side": 64}],
)  # fmt: skip
def test_options_of_a_painting_are_refused_without_one(option):
    EditConfig(style="night.png", **option)
    with pytest.raises(ValueError, match=f"{next(iter(option))}.*--recolor"):
        EditConfig(recolor=True, **option)
