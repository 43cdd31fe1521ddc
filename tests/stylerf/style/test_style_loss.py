"""The style objective against slow loops over positions and features, its alpha weights, its gradient."""

import numpy as np
import pytest
import torch

from stylerf.errors import InvalidValue
from stylerf.style import style_loss
from stylerf.style.edge_loss import GRAIN_CELL, grain, luma_gradient, missing_edges
from stylerf.style.feature_extractor import by_block, fitted, resized
from stylerf.style.feature_matching import StyleRows, style_rows, unit_rows
from stylerf.style.style_loss import (
    CELLS,
    EVERYTHING,
    GramObjective,
    StyleObjective,
    StyleWeights,
    TransportObjective,
    gram_difference,
    gram_matrix,
    position_weights,
    window_of,
)
from tests.stylerf.style.small_trunk import picture, small_trunk


def features(shape: tuple[int, ...], seed: int) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) + 0.05


def test_nearest_neighbor_distance_equals_a_double_loop():
    content, style = features((4, 3, 5), 0), features((4, 6, 2), 1)
    distances, matches = style_loss.nearest_neighbor_distance(content, style_rows(style))
    expected = []
    for i in range(3):
        for j in range(5):
            f = content[:, i, j]
            cosines = [
                float(f @ style[:, a, b] / (f.norm() * style[:, a, b].norm())) for a in range(6) for b in range(2)
            ]
            expected.append(1 - max(cosines))
            assert matches[i * 5 + j] == int(np.argmax(cosines))
    np.testing.assert_allclose(distances.numpy(), expected, atol=1e-7)  # the 1e-8 in the norms


def test_its_gradient_and_that_of_other_losses():
    style = style_rows(features((4, 6, 2), 1))
    content = features((4, 3, 5), 0).requires_grad_()
    weights = features((3, 5), 2).round()
    gram = style_loss.gram_matrix(features((4, 6, 2), 1))
    reference = features((4, 3, 5), 3)
    checked = {
        "nnfm": lambda x: style_loss.nearest_neighbor_distance(x, style)[0],
        "weighted": lambda x: style_loss.nearest_neighbor_distance(x, style, weights)[0],
        "content": lambda x: style_loss.content_distance(x, reference),
        "gram": lambda x: style_loss.gram_distance(x, gram, weights),
        "variation": style_loss.image_variation,
        "diagonal": style_loss.diagonal_variation,
    }
    for name, loss in checked.items():
        assert torch.autograd.gradcheck(loss, (content,)), name


def test_gradients_are_finite_at_zero():
    flat = torch.zeros(3, 4, 4, dtype=torch.float64, requires_grad=True)
    style = StyleRows(unit_rows(torch.ones(2, 3, dtype=torch.float64)))
    distances, _ = style_loss.nearest_neighbor_distance(flat, style)
    total = distances.sum() + style_loss.diagonal_variation(flat).sum() + style_loss.image_variation(flat)
    (gradient,) = torch.autograd.grad(total, flat)
    assert float(distances.detach().min()) == 1 and torch.isfinite(gradient).all()


def test_a_transparent_background_takes_no_part():
    style = style_rows(features((4, 6, 2), 1))
    content = features((4, 3, 5), 0)
    weights = torch.ones(3, 5, dtype=torch.float64)
    weights[:, 3:] = 0
    weights[1, 1] = 0.25
    altered = content.clone()
    altered[:, :, 3:] = 7.0
    content.requires_grad_()
    distances, matches = style_loss.nearest_neighbor_distance(content, style, weights)
    assert distances.shape == matches.shape == (9,)
    assert torch.equal(distances, style_loss.nearest_neighbor_distance(altered, style, weights)[0])
    (gradient,) = torch.autograd.grad(distances.sum(), content)
    assert float(gradient[:, :, 3:].abs().max()) == 0 and float(gradient[:, :, :3].abs().min()) > 0
    plain, _ = style_loss.nearest_neighbor_distance(content[:, :, :3], style)
    expected = plain * weights[:, :3].flatten()
    torch.testing.assert_close(distances, expected)


def test_given_matches_are_used_instead_of_a_search():
    style, content = style_rows(features((4, 6, 2), 1)), features((4, 3, 5), 0)
    distances, found = style_loss.nearest_neighbor_distance(content, style)
    again, same = style_loss.nearest_neighbor_distance(content, style, matches=found)
    assert torch.equal(distances, again) and torch.equal(found, same)
    worse, _ = style_loss.nearest_neighbor_distance(content, style, matches=(found + 1) % 12)
    assert float(worse.sum()) > float(distances.sum())


def test_position_weights_reach_beside_the_object():
    alpha = torch.zeros(8, 12)
    alpha[2:4, 4:6] = 1  # one position of the 4 x 6 features
    found = style_loss.position_weights(alpha, torch.zeros(5, 4, 6), around=1)
    expected = torch.zeros(4, 6)
    expected[0:3, 1:4] = 1
    torch.testing.assert_close(found, expected)


def test_position_weights_average_the_pixels_they_stand_for():
    alpha = torch.zeros(8, 12)
    alpha[:, 6:] = 1
    alpha[0, 0] = 1
    found = style_loss.position_weights(alpha, torch.zeros(5, 2, 3))
    assert found.tolist() == [[1 / 16, 0.5, 1], [0, 0.5, 1]]


def test_taps_of_a_block_are_joined():
    found = by_block(("conv2_2", "conv3_1", "conv3_2"), [torch.ones(1, c, 4, 5) * c for c in (2, 3, 4)])
    assert {name: tuple(value.shape) for name, value in found.items()} == {"conv2": (2, 4, 5), "conv3": (7, 4, 5)}
    assert float(found["conv3"][2, 0, 0]) == 3 and float(found["conv3"][3, 0, 0]) == 4


def test_gram_matrix_equals_a_loop_and_ignores_positions_of_no_weight():
    values = features((3, 2, 4), 5)
    expected = np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            expected[a, b] = sum(float(values[a, i, j] * values[b, i, j]) for i in range(2) for j in range(4)) / 24
    np.testing.assert_allclose(style_loss.gram_matrix(values).numpy(), expected, rtol=1e-12)
    weights = torch.tensor([[1.0, 1, 0, 0], [1, 1, 0, 0]], dtype=torch.float64)
    torch.testing.assert_close(style_loss.gram_matrix(values, weights), style_loss.gram_matrix(values[:, :, :2]))
    with pytest.raises(InvalidValue):
        style_loss.gram_matrix(values, weights * 0)


def test_variations_by_hand():
    image = torch.zeros(3, 2, 3)
    image[0] = torch.tensor([[0.0, 1, 1], [0, 0, 3]])
    # channel 0: dx = 1, 0 / 0, 3 ; dy = 0, -1, 2 ; means over 3*2*2 and 3*1*3 entries
    assert float(style_loss.image_variation(image)) == pytest.approx(((1 + 9) / 12 + (1 + 4) / 9) / 2)
    expected = torch.tensor([[1.0, 1, 2], [0, 3, 0]])  # |dx + dy| per pixel, 0 past the border
    assert torch.equal(style_loss.diagonal_variation(image), expected)
    assert float(style_loss.content_distance(image, torch.zeros(3, 2, 3))[1, 2]) == 3


HEIGHT, WIDTH = 20, 44
WEIGHTS = StyleWeights(0.7, 0.05, 0.3, 2.0)


def objective(weights=WEIGHTS, double=False, **more) -> StyleObjective:
    trunk, painting = small_trunk(), picture(30, 40, 1)
    if double:
        trunk, painting = trunk.double(), painting.double()
    return StyleObjective(trunk, painting, (HEIGHT, WIDTH), weights, **{"basis": 0, **more})


def blocks_of(trunk, image) -> list[np.ndarray]:
    """[c, h, w] of conv1 and of conv2 (its two layers joined), float64."""
    first, second, third = (f[0].detach().double().numpy() for f in trunk(image[None]))
    return [first, np.concatenate([second, third])]


def slow_parts(made: StyleObjective, image, photo, alpha=None) -> tuple[float, float, float]:
    """(style, content, variation): loops over positions and over all features of the painting."""
    small = [resized(i, HEIGHT // 2, WIDTH // 2) for i in (image, photo)]
    painted = blocks_of(made.extractor, fitted(picture(30, 40, 1).to(image), max(HEIGHT, WIDTH) // 2))
    style_loss, content_loss = 0.0, 0.0
    for found, wanted, style in zip(*(blocks_of(made.extractor, i) for i in small), painted):
        h, w = found.shape[1:]
        rows, a, b = style.reshape(len(style), -1), HEIGHT // h, WIDTH // w
        style_sum, content_sum, total = 0.0, 0.0, 0.0
        for i, j in np.ndindex(h, w):
            share = 1.0 if alpha is None else float(alpha[i * a : (i + 1) * a, j * b : (j + 1) * b].mean())
            f = found[:, i, j]
            cosines = (f @ rows) / (np.linalg.norm(f) * np.linalg.norm(rows, axis=0) + 1e-12)
            style_sum += share * (1 - cosines.max())
            content_sum += share * ((f - wanted[:, i, j]) ** 2).mean()
            total += share
        style_loss = style_loss + style_sum / total
        content_loss = content_loss + content_sum / total / (style**2).mean()  # in the painting's own unit
    x = image.detach().double().numpy()
    across, down = np.diff(x, axis=2) ** 2, np.diff(x, axis=1) ** 2
    return style_loss, content_loss, (across.mean() + down.mean()) / 2


def object_alpha() -> torch.Tensor:
    """An object in the left half with a soft rim; nothing at the right."""
    alpha = torch.zeros(HEIGHT, WIDTH)
    alpha[2:18, 3:12] = 1
    alpha[2:18, 12:14] = 0.5
    return alpha


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("double", [False, True])
def test_loss_and_its_parts_equal_a_slow_loop(masked, double):
    made = objective(double=double)
    image, photo = (p.double() if double else p for p in (picture(HEIGHT, WIDTH, 2), picture(HEIGHT, WIDTH, 3)))
    alpha = object_alpha() if masked else None
    expected = slow_parts(made, image, photo, alpha)
    loss, parts = made(image, made.content_of(photo), alpha)
    # The content's reference is kept in half precision: eleven bits.
    assert parts["style"] == pytest.approx(expected[0], rel=1e-5)
    assert parts["content"] == pytest.approx(expected[1], rel=2e-3)
    assert parts["variation"] == pytest.approx(expected[2], rel=1e-5)
    together = 0.7 * parts["style"] + 0.05 * parts["content"] + 0.3 * parts["variation"] + 2 * parts["color"]
    assert float(loss) == pytest.approx(together, rel=1e-5)
    assert min(expected) > 1e-3


@pytest.mark.parametrize("masked", [False, True])
def test_the_color_distance_is_that_of_cells(masked):
    """A picture as wide as two cells' pixels: cells of two by two, those of the object alone."""
    generator = torch.Generator().manual_seed(1)
    image, photo = (torch.rand(3, 2 * 20, 2 * CELLS, generator=generator) for _ in range(2))
    alpha = torch.zeros(40, 2 * CELLS)
    alpha[4:20, 6:30] = 1.0
    made = objective(StyleWeights(0, 0, 0, 3.0))
    loss, parts = made(image, made.content_of(photo), alpha if masked else None)
    apart = (image - photo).double().reshape(3, 20, 2, CELLS, 2).mean((2, 4)).square()
    expected = apart[:, 2:10, 3:15].mean() if masked else apart.mean()
    assert parts["color"] == pytest.approx(float(expected), rel=1e-5) and float(loss) == pytest.approx(
        3 * float(expected), rel=1e-5
    )


def test_colors_finer_than_a_cell_are_free():
    made, photo = objective(StyleWeights(0, 0, 0, 1.0)), torch.full((3, 2 * CELLS, 2 * CELLS), 0.5)
    checks = (torch.arange(2 * CELLS)[:, None] + torch.arange(2 * CELLS)) % 2 * 0.8 - 0.4
    assert made(photo + checks, made.content_of(photo))[1]["color"] < 1e-12


def test_the_diagonal_variation_is_the_mean_of_its_pixels():
    image = picture(HEIGHT, WIDTH, 2)
    x, total = image.double().numpy(), 0.0
    for i, j in np.ndindex(HEIGHT, WIDTH):
        right = x[:, i, j + 1] - x[:, i, j] if j + 1 < WIDTH else 0
        down = x[:, i + 1, j] - x[:, i, j] if i + 1 < HEIGHT else 0
        total += np.linalg.norm(np.zeros(3) + right + down)
    parts = objective(variation="diagonal")(image, objective().content_of(image))[1]
    assert parts["variation"] == pytest.approx(total / (HEIGHT * WIDTH), rel=1e-5)


@pytest.mark.parametrize("masked", [False, True])
def test_gram_distance_is_relative_to_the_style_images_gram_matrix(masked):
    image, alpha = picture(HEIGHT, WIDTH, 2), object_alpha() if masked else None
    made = GramObjective(small_trunk(), picture(30, 40, 1), (HEIGHT, WIDTH), WEIGHTS)
    painted = blocks_of(made.extractor, fitted(picture(30, 40, 1), max(HEIGHT, WIDTH) // 2))
    found, expected = blocks_of(made.extractor, resized(image, HEIGHT // 2, WIDTH // 2)), 0.0
    for seen, style in zip(found, painted):
        h, w = seen.shape[1:]
        a, b = HEIGHT // h, WIDTH // w
        total, gram = 0.0, 0.0
        for i, j in np.ndindex(h, w):
            share = 1.0 if alpha is None else float(alpha[i * a : (i + 1) * a, j * b : (j + 1) * b].mean())
            gram, total = gram + share * np.outer(seen[:, i, j], seen[:, i, j]), total + share
        wanted = np.einsum("chw,dhw->cd", style, style) / style[0].size
        expected += ((gram / total - wanted) ** 2).sum() / (wanted**2).sum() / 2
    parts = made(image, made.content_of(image), alpha)[1]
    assert parts["style"] == pytest.approx(expected, rel=1e-4) and expected > 1e-3
    assert made(image, made.content_of(image), torch.zeros(HEIGHT, WIDTH))[1]["style"] == 0


def test_what_lies_outside_the_object_is_neither_matched_nor_kept():
    made, image, alpha = objective(StyleWeights(1, 1, 0, 1)), picture(HEIGHT, WIDTH, 2), object_alpha()
    content = made.content_of(picture(HEIGHT, WIDTH, 3))
    other = image.clone()
    other[:, :, 32:] = 0.9  # beyond the reach of the second block's filters from the last column that counts, 13
    losses, gradients = [], []
    for candidate in (image, other):
        leaf = candidate.clone().requires_grad_()
        loss, _ = made(leaf, content, alpha)
        loss.backward()
        losses.append(float(loss.detach()))
        gradients.append(leaf.grad)
    assert losses[0] == pytest.approx(losses[1], rel=1e-6)
    torch.testing.assert_close(gradients[0][:, :, :14], gradients[1][:, :, :14])
    assert not gradients[0][:, :, 32:].any() and gradients[0][:, 2:18, 3:12].abs().min() > 0


def test_an_object_that_is_nowhere_costs_nothing():
    made, image = objective(), picture(HEIGHT, WIDTH, 2).requires_grad_()
    loss, parts = made(image, made.content_of(image.detach()), torch.zeros(HEIGHT, WIDTH))
    loss.backward()
    assert parts["style"] == parts["content"] == parts["color"] == 0 and torch.isfinite(image.grad).all()


def test_a_weight_of_zero_needs_no_content_and_drops_its_part():
    made, image = objective(StyleWeights(2.0, 0.0, 0.0, 0.0)), picture(HEIGHT, WIDTH, 2)
    loss, parts = made(image, None)
    assert parts["content"] == parts["color"] == 0 and float(loss) == pytest.approx(2 * parts["style"], rel=1e-6)


@pytest.mark.parametrize("masked", [False, True])
def test_gradient_equals_finite_differences_in_float64(masked):
    made, alpha = objective(double=True), object_alpha() if masked else None
    image, content = picture(HEIGHT, WIDTH, 2).double(), made.content_of(picture(HEIGHT, WIDTH, 3).double())
    leaf = image.clone().requires_grad_()
    made(leaf, content, alpha)[0].backward()
    generator = torch.Generator().manual_seed(5)
    for _ in range(6):
        # Small enough that no neighbor changes and no ReLU turns: the loss is smooth between such events.
        way = torch.randn(image.shape, generator=generator, dtype=torch.float64)
        up, down = (float(made(image + sign * 1e-6 * way, content, alpha)[0]) for sign in (1, -1))
        assert (up - down) / 2e-6 == pytest.approx(float((leaf.grad * way).sum()), rel=1e-5, abs=1e-8)


def test_fewer_rows_and_a_basis_choose_worse_or_equal_neighbors():
    image = picture(HEIGHT, WIDTH, 2)
    style = StyleWeights(1, 0, 0, 0)
    exact, few, short = (
        objective(style, **more)(image, None)[1]["style"] for more in ({}, {"most_rows": 20}, {"basis": 3})
    )
    assert exact < few < 1 and exact < short < 1


def test_the_style_image_is_at_distance_zero_unless_features_are_zero():
    painting = picture(30, 40, 1)
    made = StyleObjective(small_trunk(), painting, (30, 40), StyleWeights(1, 0, 0, 0), scale=1.0, basis=0)
    silent = sum((f == 0).all(0).mean() for f in blocks_of(made.extractor, painting))
    assert made(painting, None)[1]["style"] == pytest.approx(silent, abs=1e-5) and silent < 0.01


# -- windows --------------------------------------------------------------------------------------------------------


def test_a_window_holds_the_object_and_a_margin_on_sides_of_eight():
    alpha = np.zeros((100, 160), np.float32)
    alpha[40:50, 60:70] = 0.5
    rows, columns = window_of(alpha)
    assert (rows, columns) == (slice(16, 72), slice(40, 88))  # 10 + 8 pixels around 40..50 and 60..70
    alpha[0, 159] = 1.0
    assert window_of(alpha) == (slice(0, 72), slice(40, 160))
    assert window_of(np.zeros((9, 9), np.float32)) == EVERYTHING


@pytest.mark.parametrize("at", [0, 20, 59])
def test_a_window_is_as_wide_as_a_trunk_needs(at):
    alpha = np.zeros((60, 40), np.float32)
    alpha[at, 5] = 1.0
    rows, columns = window_of(alpha, 50)
    assert rows.stop - rows.start >= 50 and 0 <= rows.start <= at < rows.stop <= 60
    assert columns == slice(0, 40)  # no more than the view has


def test_the_loss_in_a_wide_enough_window_equals_that_of_the_whole():
    """Beyond the object lies an even background, which the small trunk's filters do not see across the margin."""
    generator = torch.Generator().manual_seed(3)
    alpha = torch.zeros(64, 96)
    alpha[24:40, 40:64] = 1.0
    image, photo = (torch.where(alpha > 0, torch.rand(3, 64, 96, generator=generator), 0.8) for _ in range(2))
    made, window = objective(scale=1.0), window_of(alpha.numpy())
    assert window == (slice(8, 56), slice(24, 80))
    whole = made(image, made.content_of(photo), alpha)[1]
    part = made(image, made.content_of(photo, window), alpha, window)[1]
    for name in whole:
        assert part[name] == pytest.approx(whole[name], rel=1e-4), name


def test_transport_is_small_for_the_style_image_and_skips_weight_zero(monkeypatch):
    painting = picture(HEIGHT, WIDTH, 1)
    made = TransportObjective(
        small_trunk("conv2"), painting, (HEIGHT, WIDTH), StyleWeights(1, 0, 0, 0), scale=1.0, diversity=0.5
    )
    own, other = (float(made(image, None)[0]) for image in (painting, picture(HEIGHT, WIDTH, 2)))
    assert 0 <= own < other / 2
    alpha = torch.zeros(HEIGHT, WIDTH)
    alpha[:, : WIDTH // 2] = 1
    mixed = torch.where(alpha > 0, painting, picture(HEIGHT, WIDTH, 3))
    changed = torch.where(alpha > 0, painting, picture(HEIGHT, WIDTH, 4))
    changed[:, :, : WIDTH // 2 + 8] = mixed[:, :, : WIDTH // 2 + 8]  # within reach of features that count
    assert float(made(mixed, None, alpha)[0]) == pytest.approx(float(made(changed, None, alpha)[0]), rel=1e-5)
    assert float(made(mixed, None, torch.zeros(HEIGHT, WIDTH))[0]) == 0


def test_transport_draws_other_positions_in_each_step(monkeypatch):
    monkeypatch.setattr(style_loss, "POSITIONS", 20)
    made = TransportObjective(small_trunk("conv2"), picture(30, 40, 1), (HEIGHT, WIDTH), StyleWeights(1, 0, 0, 0))
    image, found = picture(HEIGHT, WIDTH, 2), []
    for made.draw in (1, 2, 1):
        found.append(float(made(image, None)[0]))
    assert found[0] == found[2] != found[1]


def test_structure_is_part_of_the_loss_where_it_has_a_weight():
    image, photo = picture(HEIGHT, WIDTH, 2), picture(HEIGHT, WIDTH, 3)
    made = objective(StyleWeights(0, 0, 0, 0, 2.0))
    loss, parts = made(image, made.content_of(photo))
    expected = float(missing_edges(image, luma_gradient(photo)))
    assert float(loss) == pytest.approx(2 * expected, rel=1e-2) and parts["structure"] > 0
    assert objective(StyleWeights(1, 0, 0, 0, 0)).weights.need_photo is False


def test_grain_is_part_of_the_loss_where_it_has_a_weight():
    bar, image = torch.zeros(3, 30, 40), picture(HEIGHT, WIDTH, 2)
    bar[:, :, 11:25] = 1
    made = StyleObjective(small_trunk("conv2"), bar, (HEIGHT, WIDTH), StyleWeights(0, 0, 0, 0, grain=2.0))
    loss, parts = made(image, None)
    expected = float(grain(image, made.gradients[GRAIN_CELL]))
    assert float(loss) == pytest.approx(2 * expected, rel=1e-6) and parts["grain"] == pytest.approx(expected)
    assert expected > 0 and made.weights.need_photo is False


def test_the_difference_of_gram_matrices_is_relative_to_both():
    features = torch.rand(6, 5, 7, generator=torch.Generator().manual_seed(0))
    gram = gram_matrix(features)
    assert float(gram_difference(features, gram)) == pytest.approx(0, abs=1e-6)
    for factor in (0.01, 0.5, 2.0, 100.0):  # of the Gram matrix: strong and weak features are equally far
        expected = (factor - 1) ** 2 / (factor**2 + 1)
        assert float(gram_difference(factor**0.5 * features, gram)) == pytest.approx(expected, rel=1e-4)
    one, other = (torch.cat([f, torch.zeros(6, 5, 7)][::way]) for f, way in ((features, 1), (features, -1)))
    assert float(gram_difference(one, gram_matrix(other))) == pytest.approx(1)
    left = torch.zeros(5, 7)
    left[:, :3] = 1
    changed = torch.where(left > 0, features, features.flip(2))
    assert float(gram_difference(changed, gram, left)) == float(gram_difference(features, gram, left))
    features.requires_grad_()
    nothing = gram_difference(features, gram, torch.zeros(5, 7))
    nothing.backward()
    assert float(nothing.detach()) == 1 and float(features.grad.abs().max()) == 0


@pytest.mark.parametrize("kind", [StyleObjective, TransportObjective])
def test_gram_matrices_are_part_of_the_style_distance_where_they_have_a_weight(kind):
    image, alpha, painting = picture(HEIGHT, WIDTH, 2), object_alpha(), picture(30, 40, 1)
    plain, made = (
        kind(small_trunk("conv1_2,conv2_1"), painting, (HEIGHT, WIDTH), StyleWeights(2, 0, 0, 0, 0, gram), 1.0, basis=0)
        for gram in (0.0, 3.0)
    )
    features = made.features_of(image)
    weights = {block: position_weights(alpha, feature, made.around) for block, feature in features.items()}
    grams = {block: known.gram for block, known in made.styles[0].items()}
    apart = [gram_difference(feature, grams[block], weights[block]) for block, feature in features.items()]
    expected = float(plain(image, None, alpha)[0]) + 2 * 3 * float(sum(apart)) / 2
    assert len(apart) == 2 and float(made(image, None, alpha)[0]) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("kind", [StyleObjective, GramObjective, TransportObjective])
@pytest.mark.parametrize("whole", [True, False])
def test_each_pixel_is_compared_with_strokes_of_its_own_size(kind, whole):
    """The distance is that to each size over the pixels that have it, weighted by their share."""
    image, painting = picture(HEIGHT, WIDTH, 2), picture(60, 80, 1)
    weights = StyleWeights(1, 0, 0, 0, 0, 0.5)

    def made(*strokes):
        return kind(small_trunk("conv1_2"), painting, (HEIGHT, WIDTH), weights, 1.0, basis=0, strokes=strokes)

    alpha = None if whole else object_alpha()
    counted = torch.ones(HEIGHT, WIDTH) if alpha is None else alpha
    sizes = torch.zeros(HEIGHT, WIDTH, dtype=torch.uint8)
    sizes[:, 7:] = 2  # no pixel has size 1
    expected = 0.0
    for at, stroke in ((0, 2.0), (2, 0.5)):
        here = counted * (sizes == at)
        expected += float(here.sum() / counted.sum()) * float(made(stroke)(image, None, here)[0])
    found = float(made(2.0, 1.0, 0.5)(image, None, alpha, sizes=sizes)[0])
    assert found == pytest.approx(expected, rel=1e-5)
    assert found != pytest.approx(float(made(2.0)(image, None, alpha)[0]), rel=1e-3)


@pytest.mark.parametrize("kind", [StyleObjective, GramObjective, TransportObjective])
def test_a_gray_objective_pulls_at_no_hue(kind):
    made = kind(small_trunk(), picture(30, 40, 1), (HEIGHT, WIDTH), StyleWeights(1, 0, 0, 0), basis=0, gray=True)
    seen = picture(HEIGHT, WIDTH, 2).requires_grad_()
    made(seen, None)[0].backward()
    assert float(seen.grad.abs().max()) > 0
    torch.testing.assert_close(seen.grad, seen.grad.mean(0, keepdim=True).expand(3, -1, -1))
