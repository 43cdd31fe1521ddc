"""Colors under an edit: the module's own in marked cells, everything else as before."""

import numpy as np

from stylerf.editing.edited_color import EditedColor
from stylerf.editing.palette_module import PaletteModule
from stylerf.fields.palette_edits import PaletteEdits
from stylerf.geometry.cameras import Camera
from stylerf.rendering.view import render_view
from tests.stylerf.small import SPACES, field_of, vm_color


def test_only_rays_through_marked_cells_change_and_to_the_palettes_colors():
    field = field_of(SPACES["box"], 1, vm_color(2))
    field.density.values[-1] = 4.0  # opaque
    box = np.float32([[0, 0, 0], [1, 1, 1]])
    module = PaletteModule.create(np.random.default_rng(0), np.float32([[0.9, 0.1, 0.1], [0.1, 0.1, 0.9]]), box)
    marked = np.zeros((8, 8, 8), bool)
    marked[4:] = True
    pose = np.eye(4)
    pose[2, 3] = -3.0
    view = Camera("c", 32, 24, 40.0, 40.0, 16, 12, pose)
    plain = render_view(field, view, threads=1)
    seen = {}
    for name, changes in (("as learned", PaletteEdits()), ("changed", PaletteEdits({0: (0.0, 1.0, 0.0)}))):
        field.color = EditedColor(field.color if name == "as learned" else seen["base"], module, marked, changes)
        seen.setdefault("base", field.color._base)
        seen[name] = render_view(field, view, threads=1, regions={"a": marked})
    field.color = seen["base"]
    inside = seen["changed"].masks["a"] / np.maximum(plain.alpha, 1e-6)
    outside = (inside == 0) & (plain.alpha > 0.5)
    assert outside.any() and (inside > 0.99).any()
    np.testing.assert_allclose(seen["changed"].rgb[outside], plain.rgb[outside], atol=1e-6)
    assert np.abs(seen["changed"].rgb - seen["as learned"].rgb)[inside > 0.99].max() > 0.1
    np.testing.assert_array_equal(seen["changed"].alpha, plain.alpha)
