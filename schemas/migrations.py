"""The present schema of each kind of artifact, and how older ones are brought to it when read.

A new schema of a kind raises its number in CURRENT, adds one function to MIGRATIONS and one stored sample of the old
version to tests/schemas/samples/.
"""

from collections.abc import Callable
from pathlib import Path

from schemas.errors import ArtifactDamaged, ArtifactStale

CURRENT: dict[str, int] = {
    "scene": 2,
    "field": 2,
    "frames": 2,
    "region": 2,
    "edit-dataset": 2,
    "edit": 2,
    "report": 2,
}

Migration = Callable[[dict, Path], dict]

# (kind, from this schema) -> function(manifest as stored, folder) -> manifest of the next schema. Nothing is written.
MIGRATIONS: dict[tuple[str, int], Migration] = {
    (kind, 1): lambda content, folder: {**content, "threads": None}
    for kind in CURRENT  # were not recorded
}


def migrated(content: dict, folder: Path) -> dict:
    """The manifest `content` of the artifact in `folder` brought to the present schema of its kind, step by step.

    Raises ArtifactStale for a schema newer than this version knows or too old to migrate, ArtifactDamaged for a
    manifest without a usable kind and schema.
    """
    kind, schema = content.get("kind"), content.get("schema")
    if not isinstance(schema, int) or isinstance(schema, bool) or schema < 1 or not isinstance(kind, str):
        raise ArtifactDamaged(f"{folder}: manifest.json names no kind and schema; make the artifact again")
    if kind not in CURRENT:
        raise ArtifactStale(f"{folder} is of kind {kind!r}, which was written by a newer stylerf; update stylerf")
    if schema > CURRENT[kind]:
        raise ArtifactStale(
            f"{folder} was written by a newer stylerf: its {kind} schema is {schema}, this version reads up to "
            f"{CURRENT[kind]}; update stylerf"
        )
    while schema < CURRENT[kind]:
        step = MIGRATIONS.get((kind, schema))
        if step is None:
            raise ArtifactStale(f"{folder}: {kind} schema {schema} is too old to read; make the artifact again")
        schema += 1
        content = {**step(dict(content), folder), "schema": schema}
    return content
