"""What a blend is made of, how it is stored, and what it refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.fields.blended_color import MOST_BLENDS, MOST_LAYERS, BlendedColor
from stylerf.fields.radiance_field import RadianceField, layers_of
from stylerf.fields.region_color import RegionColor
from tests.stylerf.blends import CELLS, RAYS, corner, fields, layer, over, picture
from tests.stylerf.small import hash_color, vm_color


def stored(field: RadianceField) -> RadianceField:
    arrays = {name: array.copy() for name, array in field.arrays().items()}
    return RadianceField.restore(json.loads(json.dumps(field.describe())), arrays)


def nested() -> RadianceField:
    """A blend of a blend with a region and of a region's own colors."""
    made = fields()
    patched = replace(made["plain"], color=RegionColor(vm_color(8), hash_color(9), corner()))
    inner = over(made["source"], layer(made["mapped"], 1.0), layer(made["plain"], 0.3, corner()))
    return over(made["source"], layer(inner, 0.6), layer(patched, 0.4), layer(made["source"], 0.5, ~corner()))


def test_a_stored_blend_gives_the_same_picture_to_the_bit():
    field = nested()
    np.testing.assert_array_equal(picture(stored(field)), picture(field))
    assert [part.kind for part in layers_of(field.color)] == ["hash", "vm", "patch", "vm", "vm"]


def test_parameters_of_a_blend_are_those_of_its_layers():
    made = fields()
    blend = over(made["source"], layer(made["source"], 0.5), layer(made["mapped"], 0.5))
    expected = made["source"].parameters + len(made["mapped"].color.values)
    assert blend.parameters == expected


def test_shares_of_every_sample_add_up_to_one():
    from stylerf.rendering.rays import render_rays

    field = nested()
    samples = render_rays(field, RAYS, threads=2).samples
    total = np.zeros(len(samples.weights))
    for one, shares in field.color.shares(samples.shading_points(), 2):
        assert not isinstance(one.color, BlendedColor)
        total += shares
    there = np.concatenate([np.arange(*pair) for pair in zip(samples.starts, samples.ends)])
    np.testing.assert_allclose(total[there], 1, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "expected"),
    {
        "weight over 1": (lambda data: data["layers"][0].update(weight=1.5), "weight"),
        "weight NaN": (lambda data: data["layers"][0].update(weight=float("nan")), "weight"),
        "sum below 1": (lambda data: data["layers"][0].update(weight=0.1), "add up to 1"),
        "no layers": (lambda data: data.update(layers=[]), "add up to 1"),
        "many": (lambda data: data.update(layers=data["layers"] * MOST_LAYERS), "at most"),
        "no list": (lambda data: data.update(layers={}), "layers"),
        "cells": (lambda data: data["layers"][2].update(cells=CELLS + 1), "within"),
        "no map": (lambda data: data["layers"][0].pop("color_map"), "color_map"),
        "text": (lambda data: data["layers"].append("layer"), "expected an object"),
        "kind": (lambda data: data["layers"][0]["color"].update(kind="other"), "kind"),
    }.values(),
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_damaged_blend_is_refused(change, expected):
    field = nested()
    data = json.loads(json.dumps(field.describe()))
    change(data["color"])
    with pytest.raises(InvalidValue, match=expected):
        RadianceField.restore(data, field.arrays())


def test_a_region_under_the_whole_scene_is_refused():
    made = fields()
    with pytest.raises(InvalidValue, match="limited to a region comes before"):
        BlendedColor([layer(made["plain"], 1.0, corner()), layer(made["source"], 1.0)])


def test_blends_nested_too_deeply_are_refused():
    made = fields()
    field = made["source"]
    for _ in range(MOST_BLENDS):
        field = over(made["source"], layer(field, 1.0))
    np.testing.assert_array_equal(picture(stored(field)), picture(field))
    with pytest.raises(InvalidValue, match="9 nested blends; at most 8"):
        over(made["source"], layer(field, 1.0))
    data = field.describe()
    data["color"] = {"kind": "blend", "layers": [data["color"]["layers"][0] | {"color": data["color"]}]}
    with pytest.raises(InvalidValue, match="kind"):
        RadianceField.restore(data, field.arrays())


def test_a_blend_refuses_to_learn():
    made = fields()
    blend = over(made["source"], layer(made["source"], 1.0)).color
    assert blend.groups() == [] and len(blend.values) == 0
    with pytest.raises(InvalidValue, match="cannot be trained"):
        blend.backward(None, None, None, None, np.zeros((1, 0), np.float32))
