"""The files that the options of an evaluation name: read before any work, and known by their digests."""

from dataclasses import replace
from pathlib import Path

from schemas.canonical import file_sha256
from schemas.images import read_image
from stages.configs.evaluate import EvaluateConfig
from stages.evaluation.flows import flows_digest
from stages.evaluation.lenses import painting_file
from stages.evaluation.masks import masks_digest
from stages.evaluation.references import references_digest


def pinned(config: EvaluateConfig) -> EvaluateConfig:
    """The config with the digests of the files it names, so that changed ones are measured against anew.

    BadInput where there are none, or the painting or a reference cannot be read.
    """
    painting = painting_file(config, None)
    if painting is not None:
        read_image(painting)
    return replace(
        config,
        style_digest="" if painting is None else file_sha256(painting),
        masks_digest=masks_digest(Path(config.masks).expanduser()) if config.masks else "",
        flow_digest=flows_digest(Path(config.flow).expanduser()) if config.flow else "",
        reference_digest=references_digest(config.reference) if config.reference else "",
    )
