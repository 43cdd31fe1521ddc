"""The network that judges stylizations: a different one than those that made them."""

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass

from schemas.errors import UsageError
from schemas.work_folder import Artifact, sources_of
from stages.weights import resolve

# SIFID takes its features just before the second pooling.
JUDGES, LAYER = ("st-vgg16", "hed-vgg16", "vgg16"), "conv2_2"
LAYER_OF_ONLY_NETWORK = "conv1_2"  # no method matches it by default


@dataclass(frozen=True)
class Judge:
    """A feature extractor and one of its layers. independent: whether it took no part in the stylization."""

    network: resolve.ResolvedExtractor
    layer: str
    independent: bool

    @property
    def description(self) -> str:
        """Network and layer, for labels and protocols."""
        return f"{self.network.name}, {self.layer}{'' if self.independent else ', which also stylized'}"


def judge_beside(used: Collection[str], otherwise: resolve.ResolvedExtractor) -> Judge:
    """Return the first of JUDGES that is installed and was not used.

    Args:
        used: Digests of the networks that stylized.
        otherwise: The network to take, at a layer that no method matches by default, if there is no other.
    """
    for name in JUDGES:
        with suppress(UsageError):
            found = resolve.resolve(name)
            if found.digest not in used:
                return Judge(found, LAYER, True)
    if otherwise.digest not in used:
        return Judge(otherwise, LAYER, True)
    return Judge(otherwise, LAYER_OF_ONLY_NETWORK, False)


def networks_that_stylized(field: Artifact | None) -> frozenset[str]:
    """Return the digests of the feature networks behind a field and its local edits, as recorded in their manifests."""
    if field is None:
        return frozenset()
    figures = [one.manifest.figures.get("features") for one in [field, *sources_of(field, ("field", "scene", "edit"))]]
    digests = [made.get("digest") for made in figures if isinstance(made, dict)]
    return frozenset(digest for digest in digests if isinstance(digest, str))
