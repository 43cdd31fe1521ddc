"""The options of an evaluation: refused where they make no sense, and pinned to the files that they name."""

from dataclasses import replace
from pathlib import Path

from schemas.canonical import file_sha256
from schemas.errors import UsageError
from stages.configs.evaluate import EvaluateConfig
from stages.evaluation.flows import flows_digest
from stages.evaluation.masks import masks_digest
from stages.evaluation.nets import SMALLEST_SIDE
from stages.evaluation.references import references_digest


def pinned(config: EvaluateConfig) -> EvaluateConfig:
    """The config with the digests of the files it names, so that changed ones are measured against anew."""
    path = Path(config.style).expanduser()
    return replace(
        config,
        style_digest=file_sha256(path) if config.style and path.is_file() else config.style_digest,
        masks_digest=masks_digest(Path(config.masks).expanduser()) if config.masks else "",
        flow_digest=flows_digest(Path(config.flow).expanduser()) if config.flow else "",
        reference_digest=references_digest(config.reference) if config.reference else "",
    )


def check(config: EvaluateConfig) -> None:
    """UsageError where an option is out of its range."""
    for name, value, least in (
        ("gap", config.gap, 2), ("pairs", config.pairs, 0), ("sheet", config.sheet, 1),
        ("perceptual-pairs", config.perceptual_pairs, 0),
        ("style-side", config.style_side, SMALLEST_SIDE), ("margin", config.margin, 0), ("ring", config.ring, 1),
    ):  # fmt: skip
        if value < least:
            raise UsageError(f"--{name} {value}: expected at least {least}")
    if not 0 < config.depth_tolerance < 1:
        raise UsageError(f"--depth-tolerance {config.depth_tolerance:g}: expected a share between 0 and 1")
