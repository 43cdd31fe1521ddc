"""Options that a stage cannot use as given are refused before anything runs."""

import pytest

from stages.configs.edit import EditConfig, FinetuneConfig
from stages.configs.fit import FitConfig
from stages.configs.render import label_of
from stages.configs.stylize import ArfConfig, DesrfConfig, RefNprConfig
from stages.configs.view_syntax import depth_of


@pytest.mark.parametrize(
    ("config", "options", "words"),
    [
        (ArfConfig, {"style": "x", "style_weight": -1.0}, "style_weight must not be negative"),
        (ArfConfig, {"style": "x", "keep_colors": True, "max_gain": 8.0}, "--max-gain limits color matching"),
        (ArfConfig, {"style": "x", "dilation": 4}, "need --rays dilated, random or patch"),
        (RefNprConfig, {"style": "x", "remember": False}, "need --rays dilated, random or patch"),
        (DesrfConfig, {"style": "x", "rays": "full", "blur": 3}, "need --rays dilated, random or patch"),
        (EditConfig, {"style": "x", "style_weight": -1.0, "edge_weight": -2.0}, "style_weight, edge_weight must not"),
        (EditConfig, {"style": "x", "style_side": -3}, "style_side must be at least 16"),
        (FitConfig, {"held_out": -7}, "held_out must be at least 0, or -1"),
        (FitConfig, {"smoothness": -5.0}, "smoothness must be at least 0, or -1"),
        (FinetuneConfig, {"colors": "field", "inside": 0.8, "beside": 0.3}, "inside and beside together at most 1"),
        (FinetuneConfig, {"freeze_density": True, "density_factor": 0.3}, "no effect with --freeze-density"),
    ],
)
def test_values_out_of_range_are_refused(config, options, words):
    with pytest.raises(ValueError, match=words):
        config(**options)


def test_options_of_some_rays_are_taken_where_only_some_learn():
    for config, options in ((DesrfConfig, {"blur": 3}), (ArfConfig, {"rays": "random", "remember": False})):
        assert config(style="x", **options).blur == options.get("blur", 0)


def test_shares_that_are_one_but_for_rounding_are_taken():
    for inside, beside in ((0.8, 0.2), (0.9, 0.1), (0.7, 0.3)):
        assert FinetuneConfig(colors="field", inside=inside, beside=beside).inside == inside
    assert FinetuneConfig(inside=0.9).inside == 0.9  # `beside` is not used while only the region's own colors learn


@pytest.mark.parametrize("text", ["a:1.2.3,4", "a:2,1", "a:.,1", "a:1,2,3 "])
def test_what_is_no_range_of_depths_is_refused_in_words(text):
    with pytest.raises(ValueError, match="is not a range of depths in a view"):
        depth_of(text)
    assert depth_of("a:.5,2.") == ("a", 0.5, 2.0)


@pytest.mark.parametrize(("path", "label"), [("été.json", "t"), ("相机.json", "path"), ("_cam.json", "cam"),
                                             ("orbit", "orbit")])  # fmt: skip
def test_what_frames_are_named_after_begins_a_valid_name(path, label):
    assert label_of(path) == label
