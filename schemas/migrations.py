"""The current schema of each artifact kind, and the migrations of older artifacts, which run when these are read.

To change a schema: raise the kind's number in CURRENT, add a manifest migration to MIGRATIONS and, if files inside the
artifact change, a step to current_json or current_arrays; add a sample of the new version to tests/schemas/samples/.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from schemas.errors import ArtifactDamaged, ArtifactStale

CURRENT: dict[str, int] = {
    "scene": 4,
    "field": 3,
    "frames": 3,
    "region": 3,
    "edit-dataset": 3,
    "edit": 3,
    "report": 3,
    "export": 1,
}

Json = dict[str, Any]
Migration = Callable[[Json, Path], Json]

# Schema 3 renamed keys: American spelling, and the field's terms in place of ours.
RENAMED_PARTS = {"colour": "color", "centre": "center", "stylised": "stylized", "learnt": "learned"}
RENAMED_KEYS = {
    "clip": "gradient_clip",
    "even_from": "near_scaling_distance",
    "figures": "metrics",
    "hull": "visual_hull",
    "least": "min_opacity",
    "least_spread": "min_spread",
    "most_colors": "max_colors",
    "most_gain": "max_gain",
    "painting": "style_image",
    "taps": "layers",
}
RENAMED_VALUES = {
    "stage": {"recolour": "recolor", "fault_scene": "corrupt_scene"},
    "unit": {"share": "fraction"},
}
BY_VIEW = ("exposure_stops", "views")  # objects whose keys are names of views


def renamed_in_3(value: Any, key: str = "") -> Any:
    """A JSON value of schema 2 with the keys, and the values of known keys, that schema 3 uses."""
    if isinstance(value, dict) and key in BY_VIEW:
        return {name: renamed_in_3(item) for name, item in value.items()}
    if isinstance(value, dict):
        return {_key_in_3(name): renamed_in_3(item, _key_in_3(name)) for name, item in value.items()}
    if isinstance(value, list):
        return [renamed_in_3(item, key) for item in value]
    return RENAMED_VALUES.get(key, {}).get(value, value) if isinstance(value, str) else value


def _key_in_3(name: str) -> str:
    for old, new in RENAMED_PARTS.items():
        name = name.replace(old, new)
    return RENAMED_KEYS.get(name, name)


def _without_threads(content: Json, folder: Path) -> Json:
    return {**content, "threads": None}  # schema 1 did not record them


def _with_new_names(content: Json, folder: Path) -> Json:
    # `files` and `versions` name files and packages, not options.
    return {key: value if key in ("files", "versions") else renamed_in_3(value, key) for key, value in content.items()}


def _unchanged(content: Json, folder: Path) -> Json:
    return content  # scene.json of schema 4 may hold the lenses of photos


# (kind, schema) -> function(manifest of that schema, folder) -> manifest of the next schema. Nothing is written.
MIGRATIONS: dict[tuple[str, int], Migration] = {
    **{(kind, 1): _without_threads for kind, newest in CURRENT.items() if newest > 1},
    **{(kind, 2): _with_new_names for kind, newest in CURRENT.items() if newest > 2},
    ("scene", 3): _unchanged,
}


def current_json(document: Any, schema: int) -> Any:
    """Migrate a JSON document of an artifact with `schema` to the current schema."""
    return renamed_in_3(document) if schema < 3 else document


def current_arrays(arrays: dict[str, np.ndarray], schema: int) -> dict[str, np.ndarray]:
    """Migrate the names of arrays of an artifact with `schema` to the current schema."""
    return {_key_in_3(name): array for name, array in arrays.items()} if schema < 3 else arrays


def migrated(content: Json, folder: Path) -> Json:
    """Migrate the manifest `content` of the artifact in `folder` to the current schema of its kind, step by step.

    Raises:
        ArtifactStale: The schema is newer than this version knows, or too old to migrate.
        ArtifactDamaged: The manifest has no valid kind and schema.
    """
    kind, schema = content.get("kind"), content.get("schema")
    if not isinstance(schema, int) or isinstance(schema, bool) or schema < 1 or not isinstance(kind, str):
        raise ArtifactDamaged(f"{folder}: manifest.json has no kind and schema; rebuild the artifact")
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
            raise ArtifactStale(f"{folder}: {kind} schema {schema} is too old to read; rebuild the artifact")
        schema += 1
        content = {**step(dict(content), folder), "schema": schema}
    return content
