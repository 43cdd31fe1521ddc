"""What an evaluation looks at beside artifacts, files and networks: read before any work, known by digests."""

from dataclasses import replace
from pathlib import Path

from schemas.canonical_json import file_sha256
from schemas.images import read_image
from schemas.work_folder import Artifact
from stages.configs.evaluate import EvaluateConfig
from stages.evaluation.optical_flow import flows_digest
from stages.evaluation.perceptual_metrics import painting_file
from stages.evaluation.perceptual_networks import networks_found
from stages.evaluation.reference_metrics import references_digest
from stages.evaluation.region_masks import masks_digest


def pinned(config: EvaluateConfig, field: Artifact | None = None) -> EvaluateConfig:
    """The config with the digests of the files it names and of the networks that are here, so that others measure anew.

    BadInput where there are none, or the painting or a reference cannot be read. field: may tell of a painting too.
    """
    painting = painting_file(config, None)
    if painting is not None:
        read_image(painting)
    return replace(
        config,
        **digests_of_files(config),
        networks=networks_found(config.perceptual != "none", painting_file(config, field) is not None, config.features),
    )


def digests_of_files(config: EvaluateConfig) -> dict[str, str]:
    """The digests of the files that the options name, as they are now; empty where an option names none."""
    painting = painting_file(config, None)
    return {
        "style_digest": "" if painting is None else file_sha256(painting),
        "masks_digest": masks_digest(Path(config.masks).expanduser()) if config.masks else "",
        "flow_digest": flows_digest(Path(config.flow).expanduser()) if config.flow else "",
        "reference_digest": references_digest(config.reference) if config.reference else "",
    }
