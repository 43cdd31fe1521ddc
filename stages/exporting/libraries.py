"""Optional libraries of the extra `export`, imported when a format needs them."""

import importlib
from typing import Any

from schemas.errors import UsageError

PACKAGES = {"pxr": "usd-core", "pygltflib": "pygltflib", "fast_simplification": "fast-simplification", "gsply": "gsply"}
OF_FORMATS = {"usd": "pxr", "usda": "pxr", "usdc": "pxr", "glb": "pygltflib", "spz": "gsply"}


def check_formats(formats: tuple[str, ...]) -> None:
    """Import what the formats need, so that a missing library is reported before anything is computed."""
    for name in formats:
        if name in OF_FORMATS:
            needed(OF_FORMATS[name], f"--format {name}")


def needed(module: str, purpose: str) -> Any:
    """Import a library; UsageError with the command that installs it where it is missing.

    Args:
        module: its name, with the submodule that is wanted.
        purpose: what needs it, such as "--format glb".
    """
    package = PACKAGES[module.partition(".")[0]]
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise UsageError(
            f"{purpose} needs {package}, which cannot be imported ({error}); pip install 'stylerf[export]'"
        ) from error
