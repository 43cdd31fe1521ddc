"""Optional libraries of the extra `export`, imported when a format needs them."""

import importlib
import sys
from typing import Any

from schemas.errors import OutOfResources

PACKAGES = {"pxr": "usd-core", "pygltflib": "pygltflib", "fast_simplification": "fast-simplification", "gsply": "gsply"}
OF_FORMATS = {"usd": "pxr", "usda": "pxr", "usdc": "pxr", "glb": "pygltflib", "spz": "gsply"}
ALONE = {("splats", "glb")}  # kind and format that do not need the library


def check_formats(kind: str, formats: tuple[str, ...]) -> None:
    """Import what the formats of a kind need, so that a missing library is reported before anything is computed."""
    for name in formats:
        if name in OF_FORMATS and (kind, name) not in ALONE:
            needed(OF_FORMATS[name], f"--format {name}")


def needed(module: str, purpose: str) -> Any:
    """Import a library; if it is missing, OutOfResources says how to install it.

    Args:
        module: its name, with the submodule that is wanted.
        purpose: what needs it, such as "--format glb".
    """
    package = PACKAGES[module.partition(".")[0]]
    try:
        return importlib.import_module(module)
    except ImportError as error:
        how = "pip install 'stylerf[export]'"
        if package == "gsply" and sys.version_info >= (3, 14):
            how = "it has no wheel for Python 3.14, so choose another format"
        raise OutOfResources(f"{purpose} needs {package}, which cannot be imported ({error}); {how}") from error
