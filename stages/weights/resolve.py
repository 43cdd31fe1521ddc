"""Trained weights, resolved to tensors: feature extractors for stylizing, networks of perceptual metrics.

Nothing is downloaded. Weights that are found (stages.weights.sources) are converted to one canonical form, kept as
safetensors in a cache folder, and identified by the digest of their tensors, so that two files with the same values are
the same weights.

Environment: STYLERF_CACHE (cache folder; else $XDG_CACHE_HOME/stylerf, else ~/.cache/stylerf), STYLERF_WEIGHTS (a
folder with the user's own weights, see stages.weights.sources).
"""

import hashlib
import os
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from schemas.canonical_json import file_sha256
from schemas.errors import BadInput, UsageError
from stages.weights.sources import (
    DECODERS,
    DEFAULT_EXTRACTORS,
    DEFAULT_METRICS,
    EXTRACTORS,
    HUB_SHA256,
    HUB_URLS,
    METRICS,
    Source,
    converted,
    hub_folder,
    read_file,
    recognized,
)
from stylerf.environment.trusted_paths import not_ours


@dataclass(frozen=True)
class ResolvedExtractor:
    """Weights ready for use. digest: sha256 of the tensors; path: where they were read from; kind: the architecture."""

    name: str
    digest: str
    path: Path
    source: str
    state: dict[str, Tensor]
    kind: str

    def manifest(self) -> dict[str, str]:
        """What a manifest records of them."""
        return {"name": self.name, "digest": self.digest, "source": self.source, "kind": self.kind}


def resolve(name_or_path: str | os.PathLike | None = None) -> ResolvedExtractor:
    """Return the feature extractor to use: by name, from a file, or (None) the first in default order that is found.

    Raises UsageError for an unknown or missing one (with the command that gets it), BadInput for a damaged file.
    """
    if name_or_path is None:
        for name in DEFAULT_EXTRACTORS:
            found = _read(EXTRACTORS[name])
            if found is not None:
                return found
        raise UsageError(f"no feature extractor is installed; get one with: {EXTRACTORS['hed-vgg16'].obtain}")
    if str(name_or_path) in EXTRACTORS:
        return _named(EXTRACTORS[str(name_or_path)])
    path = Path(name_or_path).expanduser()
    if not path.is_file():
        raise UsageError(
            f"--features expects one of {', '.join(EXTRACTORS)} or a file of VGG weights; {str(name_or_path)!r} is "
            "neither"
        )
    kind, state = recognized(path)
    return ResolvedExtractor(path.stem, state_digest(state), path, f"VGG weights of {path}", state, kind)


def chosen(features: str) -> dict[str, str]:
    """Return the options `features` and `features_digest` of a recipe: the name that None resolves to; for a file also
    its digest.

    Reads no weights. Errors as for `resolve`, except for errors inside a file.
    """
    features = features or found_extractor()
    if features in EXTRACTORS:
        return {"features": features, "features_digest": ""}
    path = Path(features).expanduser()
    if not path.is_file():
        resolve(features or None)  # raises with the reason
    return {"features": str(path.resolve()), "features_digest": file_sha256(path)}


def digests_of_files(config: Any) -> dict[str, str]:
    """Return the current SHA-256 of the painting and the weights file that the options of a stylization name."""
    found = {"style_digest": config.style and file_sha256(config.style)}
    return found | ({"features_digest": file_sha256(config.features)} if config.features_digest else {})


def found_extractor() -> str:
    """Return the name of the extractor that None resolves to, empty without any; reads no weights."""
    return next((row["name"] for row in describe() if row["chosen"]), "")


def resolve_metric(name: str) -> ResolvedExtractor:
    """Return the network and heads of a perceptual metric by name; errors as for `resolve`."""
    if name not in METRICS:
        raise UsageError(f"unknown perceptual metric {name!r}; choose from {', '.join(METRICS)}")
    return _named(METRICS[name])


def resolve_decoder(name: str = "vgg19-wct-decoder") -> ResolvedExtractor:
    """Return the decoder of an extractor's features; UsageError with the command that gets it if it is missing."""
    return _named(DECODERS[name])


def available_metrics() -> list[str]:
    """Return the names of the perceptual metrics whose weights are available, in the order of reporting."""
    return [name for name in DEFAULT_METRICS if METRICS[name].locate() or _cached(METRICS[name])]


def describe() -> list[dict[str, Any]]:
    """Return every known source of weights, for `doctor`: use, name, words, found, path, cached, chosen, and how to
    obtain it.

    Only checks whether the files exist; reads none.
    """
    rows, chosen = [], None
    for use, sources in (("features", EXTRACTORS), ("metric", METRICS), ("decoder", DECODERS)):
        for source in sources.values():
            files, cache = source.locate(), _cached(source)
            found = bool(files or cache)
            if use == "features" and found and chosen is None and source.name in DEFAULT_EXTRACTORS:
                chosen = source.name
            rows.append(
                {
                    "use": use,
                    "name": source.name,
                    "what": source.words,
                    "found": found,
                    "path": str(files[0] if files else cache) if found else None,
                    "cached": cache is not None,
                    "chosen": use == "features" and chosen == source.name,
                    "obtain": source.obtain,
                }
            )
    return rows


def cache_folder() -> Path:
    """Return the folder of converted weights, which is created on first use."""
    own = os.environ.get("STYLERF_CACHE")
    if own:
        return Path(own).expanduser() / "features"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache").expanduser() / "stylerf" / "features"


def state_digest(state: dict[str, Tensor]) -> str:
    """Return the SHA-256 of names, shapes and little-endian float32 values, in the order of the names."""
    total = hashlib.sha256()
    for name in sorted(state):
        values = np.ascontiguousarray(state[name].cpu().numpy().astype("<f4", copy=False))
        total.update(f"{name} {list(values.shape)}\n".encode())
        total.update(values.data)
    return total.hexdigest()


def _named(source: Source) -> ResolvedExtractor:
    found = _read(source)
    if found is None:
        raise UsageError(f"{source.name} ({source.words}) not found; get it with: {source.obtain}")
    return found


def _read(source: Source) -> ResolvedExtractor | None:
    """Load from the cache if its values are as expected, else convert the original files and cache the result."""
    files = source.locate()
    cached = _from_cache(source, files)
    if cached is not None:
        return cached
    if files is None:
        return None
    for file in files:
        _check_hub_file(file)
    state = converted(source.convert, files[0], *(read_file(file) for file in files))
    digest = state_digest(state)
    if source.digest not in (None, digest):
        raise BadInput(
            f"weights {files[0]}: the values differ from those of {source.name} (digest {digest[:12]}, expected "
            f"{source.digest[:12]}); install it again with: {source.obtain}"
        )
    _keep(source, state, digest, files)
    return ResolvedExtractor(source.name, digest, files[0], source.words, state, source.kind)


def _cached_file(source: Source) -> Path:
    return cache_folder() / f"{source.name}.safetensors"


def _cached(source: Source) -> Path | None:
    """Return the cached file, if it exists. Without a digest to check it against, this user must have created it."""
    path = _cached_file(source)
    return path if path.is_file() and (source.digest or not_ours(path) is None) else None


def _from_cache(source: Source, files: Sequence[Path] | None) -> ResolvedExtractor | None:
    """Return None if nothing is cached, or if it is damaged or from other original files (it is then recreated)."""
    path = _cached(source)
    if path is None:
        return None
    try:
        with safe_open(path, framework="pt") as file:
            known = file.metadata() or {}
            expected = source.digest or known.get("digest")
            # The user's files may be replaced by others of the same name.
            if source.digest is None and files is not None and known.get("files") != _digests(files):
                return None
            state = {name: file.get_tensor(name) for name in file.keys()}
    except (OSError, SafetensorError):
        return None
    digest = state_digest(state)
    if digest != expected:
        return None
    return ResolvedExtractor(source.name, digest, path, source.words, state, source.kind)


def _digests(files: Sequence[Path]) -> str:
    return " ".join(file_sha256(file) for file in files)


def _keep(source: Source, state: dict[str, Tensor], digest: str, files: Sequence[Path]) -> None:
    """Write the cache file completely or not at all; an unwritable folder only means converting again next time."""
    path = _cached_file(source)
    known = {"name": source.name, "kind": source.kind, "digest": digest, "files": _digests(files)}
    data = save(state, metadata=known)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(temporary, path)
        except OSError:
            Path(temporary).unlink(missing_ok=True)


def _check_hub_file(path: Path) -> None:
    """Raise BadInput if a file in torch's hub does not match the digest in its name."""
    expected = {url.rsplit("/", 1)[1]: HUB_SHA256[model] for model, url in HUB_URLS.items()}
    if path.name in expected and path.parent == hub_folder() and (found := file_sha256(path)) != expected[path.name]:
        raise BadInput(
            f"weights {path}: sha256 is {found}, expected {expected[path.name]}; delete the file and download it again"
        )
