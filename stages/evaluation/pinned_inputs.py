"""Pin the files and networks that an evaluation reads besides artifacts, by their digests."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from schemas.canonical_json import file_sha256
from schemas.images import read_image
from schemas.work_folder import Artifact
from stages.configs.evaluate import EvaluateConfig
from stages.evaluation.path_consistency import flows_digest
from stages.evaluation.perceptual_metrics import available_networks, style_file
from stages.evaluation.reference_metrics import references_digest
from stages.evaluation.region_masks import masks_digest


def pinned(config: EvaluateConfig, field: Artifact | None = None) -> EvaluateConfig:
    """Add the digests of the files it names and of the available networks, so that a change of them is noticed.

    field: may name a style image too. Raises BadInput if a file is missing, or an image cannot be read.
    """
    style = style_file(config, None)
    if style is not None:
        read_image(style)
    styled = style_file(config, field) is not None
    networks = available_networks(config.perceptual != "none", styled, config.features)
    digests: dict[str, Any] = digests_of_files(config)
    return replace(config, **digests, networks=networks)


def digests_of_files(config: EvaluateConfig) -> dict[str, str]:
    """Current digests of the files that options name; empty for options that name none."""
    style = style_file(config, None)
    return {
        "style_digest": "" if style is None else file_sha256(style),
        "masks_digest": masks_digest(Path(config.masks).expanduser()) if config.masks else "",
        "flow_digest": flows_digest(Path(config.flow).expanduser()) if config.flow else "",
        "reference_digest": references_digest(config.reference) if config.reference else "",
    }
