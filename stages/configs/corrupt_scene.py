"""Options of the scenes that `stylerf stress` makes; filled in by that verb."""

from dataclasses import dataclass

from stages.configs import option


@dataclass(frozen=True)
class CorruptSceneConfig:
    """One fault of one scene. source, source_digest: the scene that it is made from; empty for a procedural one."""

    fault: str = option("seeds", help="name of the fault, see docs/stress.md")
    amount: float = option(0.0, help="how much of it")
    side: int = option(160, help="longer side of the photos, pixels; larger ones are averaged down")
    views: int = option(24, help="training views of a procedural scene")
    tests: int = option(4, help="test views, which have no fault")
    source: str = option("", help="folder of the scene", digest="source_digest")
    source_digest: str = ""
