"""Config of the scenes that `stylerf stress` makes; that verb fills it in."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class CorruptSceneConfig:
    """One fault of one scene.

    fault: its name, see docs/stress.md. amount: how much of it. side: longer side of the photos, pixels; larger ones
    are downscaled. views: training views of a procedural scene. tests: test views, which have no fault. source: folder
    of the scene to corrupt, empty for a procedural one. source_digest: its digest.
    """

    fault: str = "seeds"
    amount: float = 0.0
    side: int = 160
    views: int = 24
    tests: int = 4
    source: str = field(default="", metadata={"digest": "source_digest"})
    source_digest: str = ""
