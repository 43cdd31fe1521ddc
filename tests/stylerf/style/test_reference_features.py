"""Correspondences with a reference, against slow loops over positions; what counts, what is trusted."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from stylerf.style.reference_features import UNRELATED, ReferenceFeatures, ReferenceObjective
from stylerf.style.style_loss import StyleWeights
from tests.stylerf.style.small_trunk import picture, small_trunk

HEIGHT, WIDTH = 24, 32
WEIGHTS = StyleWeights(0.7, 0.2, 0.3, 5.0)


def templates(alpha=None) -> list[ReferenceFeatures]:
    return [ReferenceFeatures(picture(HEIGHT, WIDTH, 10 + i), picture(HEIGHT, WIDTH, 20 + i), alpha) for i in range(2)]


def objective(given=None, weights=WEIGHTS, **more) -> ReferenceObjective:
    given = given or templates()
    return ReferenceObjective(small_trunk(), small_trunk("conv2_2", 3), given, weights, 1.0, **{"basis": 0, **more})


def rows(trunk, image: torch.Tensor) -> list[np.ndarray]:
    """Features of conv1 and of conv2 (two layers joined), [n, c] float64, unit length or 0 where all are dead."""
    first, second, third = (f[0].double().flatten(1).T.numpy() for f in trunk(image[None]))
    return [
        r / np.maximum(np.linalg.norm(r, axis=1, keepdims=True), 1e-9)
        for r in (first, np.concatenate([second, third], 1))
    ]


def test_style_is_the_look_that_the_reference_has_where_its_content_is():
    made, render, photo = objective(), picture(HEIGHT, WIDTH, 1), picture(HEIGHT, WIDTH, 2)
    keys = [np.concatenate(p) for p in zip(*(rows(made.extractor, t.photo) for t in templates()))]
    looks = [np.concatenate(p) for p in zip(*(rows(made.extractor, t.stylized) for t in templates()))]
    expected = 0.0
    for requested, seen, key, look in zip(rows(made.extractor, photo), rows(made.extractor, render), keys, looks):
        total = 0.0
        for i in range(len(requested)):
            j = int(np.argmax(key @ requested[i]))
            total += 1 - float(seen[i] @ look[j])
        expected += total / len(requested)
    loss, parts = made(render, made.wanted(photo))
    assert parts["style"] == pytest.approx(expected, rel=1e-5) and expected > 0.05
    together = 0.7 * parts["style"] + 0.2 * parts["content"] + 0.3 * parts["variation"] + 5 * parts["color"]
    assert float(loss) == pytest.approx(together, rel=1e-5)


def test_the_reference_itself_is_requested_to_be_its_stylized_picture():
    one = templates()[:1]
    made = objective(one, StyleWeights(1, 0, 0, 5))
    wanted = made.wanted(one[0].photo)
    _, parts = made(one[0].stylized, wanted)
    astray = []
    pictures = (rows(made.extractor, picture_) for picture_ in (one[0].photo, one[0].stylized))
    for keys, looks, matches in zip(*pictures, wanted.matches.values(), strict=True):
        likeness = keys @ keys.T
        np.fill_diagonal(likeness, -1)
        # Alike in all that is alive, or dead altogether: which of them is found is rounding's choice.
        certain = (likeness.max(1) < 1 - 1e-5) & (np.abs(keys).sum(1) > 0)
        assert certain.mean() > 0.8
        np.testing.assert_array_equal(matches.numpy()[certain], np.flatnonzero(certain))
        # A position whose features are all dead is at distance 1 from everything, itself included.
        astray.append((~certain | (np.abs(looks).sum(1) == 0)).mean())
    assert parts["style"] <= np.mean(astray) + 1e-6 and parts["color"] < 1e-9
    _, others = made(one[0].photo, wanted)
    cells = [F.adaptive_avg_pool2d(picture_, wanted.trusted.shape) for picture_ in (one[0].photo, one[0].stylized)]
    assert others["style"] > 0.05
    assert others["color"] == pytest.approx(float((cells[0] - cells[1]).square().mean()), rel=1e-4)


def test_coarse_colors_are_those_of_the_likest_cell_unless_it_is_strange():
    made, photo = objective(), picture(HEIGHT, WIDTH, 2)
    size = (2, 2)  # of 24 x 32 pixels, cells of at least 16

    def cells(image: torch.Tensor) -> np.ndarray:
        found = F.adaptive_avg_pool2d(made.coarse(image[None])[-1][0], size).flatten(1).T.double().numpy()
        return found / np.linalg.norm(found, axis=1, keepdims=True)

    keys = np.concatenate([cells(t.photo) for t in templates()])
    pooled = [F.adaptive_avg_pool2d(t.stylized, size).flatten(1).T.numpy() for t in templates()]
    cosines = cells(photo) @ keys.T
    wanted = made.wanted(photo)
    expected = np.concatenate(pooled)[cosines.argmax(1)].T.reshape(3, *size)
    np.testing.assert_allclose(wanted.colors.numpy(), expected, atol=1e-6)
    assert (wanted.trusted == 1).all()
    image, half = picture(HEIGHT, WIDTH, 1), made.wanted(photo)
    half.trusted[0] = 0  # strange cells count as 0 in the mean over all
    gaps = (F.adaptive_avg_pool2d(image, size) - half.colors).square().mean(0)
    assert made(image, half)[1]["color"] == pytest.approx(float(gaps[1].sum() / 4), rel=1e-5)
    made.coarse_keys = -made.coarse_keys  # features are not negative: nothing is like anything now
    strange = made.wanted(photo)
    assert not strange.trusted.any() and made(photo, strange)[1]["color"] == 0 and UNRELATED < 1


def test_where_the_object_is_not_nothing_is_sought_found_or_requested():
    """The reference's right half is background: its looks there must not be taken over, however alike."""
    alpha = torch.zeros(HEIGHT, WIDTH)
    alpha[:, : WIDTH // 2] = 1
    masked = templates(alpha)
    made = objective(masked)
    swapped = [ReferenceFeatures(t.photo.flip(2), t.stylized.flip(2), alpha.flip(1)) for t in masked]
    photo = masked[0].photo.clone()
    wanted, other = made.wanted(photo, alpha), objective(swapped).wanted(photo, alpha)
    assert len(wanted.matches["conv1"]) == HEIGHT * WIDTH // 2 and len(wanted.matches["conv2"]) == HEIGHT * WIDTH // 8
    assert (wanted.trusted[:, 1] == 0).all() and not np.array_equal(wanted.colors, other.colors)
    image = picture(HEIGHT, WIDTH, 4)
    changed = image.clone()
    changed[:, :, 28:] = 0.2
    losses = [made(i, wanted, alpha)[1] for i in (image, changed)]
    assert losses[0]["style"] == pytest.approx(losses[1]["style"], rel=1e-6)
    assert losses[0]["content"] == pytest.approx(losses[1]["content"], rel=1e-6)


def test_many_rows_are_sampled_alike_in_every_picture_of_a_reference(monkeypatch):
    monkeypatch.setattr("stylerf.style.reference_features.MOST_ROWS", 100)
    one = templates()[:1]
    made = objective([ReferenceFeatures(one[0].photo, one[0].photo)], StyleWeights(1, 0, 0, 0))
    assert len(made.stylized["conv1"].rows) == len(made.keys["conv1"].rows) == 100
    assert torch.equal(made.stylized["conv1"].rows, made.keys["conv1"].rows)
    assert torch.equal(made.keys_of([one[0].photo])["conv2"].rows, made.keys["conv2"].rows)


def test_the_gradient_is_that_of_finite_differences():
    made = objective()
    for trunk in (made.extractor, made.coarse):
        trunk.double()
    given = [ReferenceFeatures(t.photo.double(), t.stylized.double()) for t in templates()]
    made = ReferenceObjective(made.extractor, made.coarse, given, WEIGHTS, 1.0, basis=0)
    wanted, image = made.wanted(picture(HEIGHT, WIDTH, 2).double()), picture(HEIGHT, WIDTH, 1).double()
    way = picture(HEIGHT, WIDTH, 7).double() - 0.5
    leaf = image.clone().requires_grad_()
    made(leaf, wanted)[0].backward()
    slope = (made(image + 1e-6 * way, wanted)[0] - made(image - 1e-6 * way, wanted)[0]) / 2e-6
    assert float((leaf.grad * way).sum()) == pytest.approx(float(slope), rel=1e-4)
