"""What the stylize stage decides by itself: the grain of its colors, and which rays learn."""

import numpy as np
import pytest
import torch

from stages.configs.stylize import COLOR_CELLS, CONFIGS, ArfConfig, DesrfConfig
from stages.stylization.settings import new_color, settings_of, strategy_of


@pytest.mark.parametrize(
    ("pixel_cells", "finest"),
    [(128.0, 160), (180.0, 224), (5.0, COLOR_CELLS[0]), (4000.0, COLOR_CELLS[1]), (float("nan"), COLOR_CELLS[0])],
)
def test_colors_are_a_quarter_finer_than_a_pixel_within_bounds(pixel_cells, finest):
    config = ArfConfig(style="x", levels=2, table_bits=10)
    assert new_color(config, np.random.default_rng(0), pixel_cells).finest == finest


def test_cells_that_are_requested_are_taken():
    config = ArfConfig(style="x", levels=2, table_bits=10, finest=48)
    assert new_color(config, np.random.default_rng(0), 500.0).finest == 48


@pytest.mark.parametrize(
    ("method", "options", "side", "rays"),
    [
        ("arf", {}, 1008, "deferred"),
        ("desrf", {}, 256, "deferred"),
        ("desrf", {}, 257, "dilated"),
        ("desrf", {"rays": "patch"}, 100, "patch"),
    ],
)
def test_rays_follow_from_method_and_size_unless_requested(method, options, side, rays):
    assert strategy_of(CONFIGS[method](style="x", **options), side) == rays


@pytest.mark.parametrize(
    ("method", "options", "closed", "color", "displacement", "coarse"),
    [
        ("desrf", {}, False, 1.0, 0.0, 0.6),
        ("desrf", {}, True, 1.0, 0.0, 0.5),
        ("desrf", {"match_by": "nearest"}, True, 10.0, 0.0, 0.0),
        ("desrf", {"displacement_weight": 0.2}, False, 1.0, 0.2, 0.6),
        ("arf", {}, False, 1.0, None, 0.5),
        ("arf", {"match_by": "nearest"}, True, 10.0, None, 0.0),
        ("arf", {"keep_colors": True}, True, 10.0, None, 0.5),
        ("desrf", {"coarse": 0.0, "color_weight": 4.0}, False, 4.0, 0.0, 0.0),
        ("refnpr", {}, True, 1.0, None, 0.5),
        ("refnpr", {"reference_by": "gram"}, True, 10.0, None, 0.0),
    ],
)
def test_what_holds_shapes_follows_from_method_and_scene_unless_requested(
    method, options, closed, color, displacement, coarse
):
    found = settings_of(CONFIGS[method](style="x", **options), 200, closed)
    assert (found.weights.color, getattr(found, "displacement_weight", None), found.coarse) == (
        color,
        displacement,
        coarse,
    )


@pytest.mark.parametrize(
    ("method", "options", "structure", "gram", "scale"),
    [
        ("arf", {}, 8.0, 2.0, 512 / 800),
        ("arf", {"match_by": "nearest"}, 0.0, 0.0, 0.5),
        ("arf", {"match_by": "nearest", "gram_weight": 3.0}, 0.0, 3.0, 0.5),
        ("desrf", {}, 4.0, 2.0, 512 / 800),
        ("snerf", {}, 0.0, 0.0, 0.5),
        ("snerf", {"image_by": "features"}, 8.0, 2.0, 512 / 800),
        ("refnpr", {}, 8.0, 2.0, 512 / 800),
        ("arf", {"structure_weight": 1.0, "gram_weight": 0.0, "feature_scale": 0.25}, 1.0, 0.0, 0.25),
    ],
)
def test_how_images_are_compared_decides_on_edges_statistics_and_size(method, options, structure, gram, scale):
    found = settings_of(CONFIGS[method](style="x", **options), 800, True)
    assert (found.weights.structure, found.weights.gram, found.feature_scale) == (structure, gram, scale)
    if method == "refnpr":  # a view follows its reference, not the photo's edges
        of_view = found.reference_feature_weights
        assert of_view.structure == 0 and of_view.gram == 0
        assert of_view.grain == 0 and found.weights.grain == 4


@pytest.mark.parametrize(
    ("method", "options", "layers"),
    [
        ("arf", {}, "conv2_1,conv3_1"),
        ("desrf", {}, "conv2_1,conv3_1"),
        ("arf", {"coarse": 0.0}, "conv2_1,conv3_1"),
        ("arf", {"layers": "conv3,conv4"}, ""),
        ("arf", {"match_by": "nearest", "coarse": 0.5}, ""),
        ("snerf", {}, ""),
        ("refnpr", {}, "conv2_1,conv3_1"),
    ],
)
def test_transport_leaves_out_deep_layers_after_the_coarse_steps_unless_told(method, options, layers):
    assert settings_of(CONFIGS[method](style="x", **options), 800, True).fine_layers == layers


def test_grain_counts_where_features_are_transported():
    for options, expected in (({}, 4.0), ({"match_by": "nearest"}, 0.0), ({"grain_weight": 1.0}, 1.0)):
        assert settings_of(ArfConfig(style="x", **options), 800, True).weights.grain == expected
    deformed = [settings_of(DesrfConfig(style="x"), 800, capture).weights.grain for capture in (True, False)]
    assert deformed == [1.0, 1.0]
    assert settings_of(DesrfConfig(style="x", match_by="nearest"), 800, True).weights.grain == 0


def test_edges_of_a_deformed_object_weigh_less():
    for method, options, expected in (("desrf", {}, 2.0), ("desrf", {"match_by": "nearest"}, 0.0), ("arf", {}, 8.0)):
        assert settings_of(CONFIGS[method](style="x", **options), 800, False).weights.structure == expected, method


def test_shapes_of_captures_learn_faster_than_those_of_objects():
    rates = [settings_of(DesrfConfig(style="x"), 800, capture).deform_rate for capture in (True, False)]
    assert rates == [0.06, 0.024]
    assert settings_of(DesrfConfig(style="x", deform_rate=0.01), 800, True).deform_rate == 0.01


def test_smaller_views_slow_fewer_levels_of_the_colors():
    assert [settings_of(ArfConfig(style="x"), side, True).detail for side in (1024, 512, 256)] == [5.0, 5.0, 2.5]


def test_references_are_matched_at_half_size_of_at_least_256_pixels():
    made = {side: settings_of(CONFIGS["refnpr"](style="x"), side, True) for side in (200, 400, 512, 1024)}
    assert [one.reference_scale for one in made.values()] == [1.0, 0.64, 0.5, 0.5]
    assert [one.feature_scale for one in made.values()] == [1.0, 1.0, 1.0, 0.5]  # for making references
    given = settings_of(CONFIGS["refnpr"](style="x", feature_scale=0.75), 512, True)
    assert given.reference_scale == given.feature_scale == 0.75


def test_broad_cells_are_slowed_where_features_are_transported():
    broad = {name: settings_of(CONFIGS[name](style="x"), 512, True).broad for name in ("arf", "desrf", "refnpr")}
    assert broad == {"arf": 10.0, "desrf": 10.0, "refnpr": np.inf}
    assert settings_of(ArfConfig(style="x", match_by="nearest"), 512, True).broad == np.inf
    assert settings_of(ArfConfig(style="x"), 1024, True).broad == 20.0  # features are as wide at half the size


def test_cells_narrower_than_features_see_do_not_learn():
    narrow = {side: settings_of(ArfConfig(style="x"), side, True).narrow for side in (256, 512, 1024)}
    assert narrow == {256: 0.55, 512: 1.1, 1024: 2.2}  # pixels; large views have features at half the size
    assert settings_of(CONFIGS["refnpr"](style="x"), 512, True).narrow == 0.0  # references teach single pixels


def test_finest_colors_learn_as_fast_as_the_style_image_is_rough():
    """A flat one slows them to a tenth, noise as strong as canvas does not; an option decides before either."""
    flat = torch.full((3, 64, 96), 0.5)
    noise = torch.from_numpy(np.random.default_rng(0).random((3, 96, 144)).astype(np.float32))
    faint = 0.5 + 0.15 * (noise - 0.5)

    def rate(image, **options):
        return settings_of(ArfConfig(style="x", **options), 96, True, style_image=image).detail_rate

    assert rate(flat) == rate(None) == 0.1 and rate(noise) == 1.0
    assert 0.15 < rate(faint) < 0.6
    assert rate(faint, stroke=3.0) < 0.7 * rate(faint)  # larger strokes are smoother
    assert rate(noise, detail_rate=0.3) == 0.3
    assert settings_of(CONFIGS["refnpr"](style="x"), 96, True, style_image=flat).detail_rate == 1.0


@pytest.mark.parametrize(
    "options",
    [{"match_by": "nearest", "diversity": 1.0}, {"keep_colors": True, "match": "before"}, {"diversity": -1.0}],
)
def test_options_that_would_have_no_effect_are_refused(options):
    with pytest.raises(ValueError, match=r"--diversity|--keep-colors|diversity"):
        ArfConfig(style="x", **options)


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("snerf", {"style": "x", "match_by": "nearest"}),
        ("refnpr", {"style": "x", "reference_by": "gram", "diversity": 1.0}),
        ("refnpr", {"reference": ("0=x.png",), "match_by": "nearest"}),
    ],
)
def test_matching_is_refused_where_no_features_are_matched(method, options):
    with pytest.raises(ValueError, match="--match-by and --diversity have no effect"):
        CONFIGS[method](**options)
    CONFIGS[method](**options | {"match_by": "transport", "diversity": 0.5})


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("snerf", {"gram_weight": 1.0}),
        ("refnpr", {"gram_weight": 1.0}),
        ("refnpr", {"structure_weight": 1.0}),
        ("refnpr", {"grain_weight": 1.0}),
    ],
)
def test_weights_of_terms_that_a_method_lacks_are_refused(method, options):
    (name,) = options
    with pytest.raises(ValueError, match=f"--{name.replace('_', '-')}"):
        CONFIGS[method](style="x", **options)
    CONFIGS[method](style="x", **{name: -1.0})


def test_a_budget_of_steps_has_an_image_and_a_step_of_the_field_for_every_round():
    with pytest.raises(ValueError, match="give at least 6 steps, or fewer --rounds"):
        CONFIGS["snerf"](style="x", budget="5")
    CONFIGS["snerf"](style="x", budget="5", rounds=2)
