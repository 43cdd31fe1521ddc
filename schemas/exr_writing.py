"""Writing of single-part EXR files, whatever their channels."""

import errno
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from schemas.atomic_write import refusal_of_disk, replacing
from schemas.native_output import native_output_silenced


def write_part(path: Path, header: dict[str, Any], channels: dict[str, np.ndarray], size: int) -> None:
    """Write a file atomically; equal arguments give equal bytes.

    Args:
        header: Attributes; `type` and `compression` too.
        channels: [h, w] each, contiguous: OpenEXR silently writes strided arrays wrongly (its issue 1929).
        size: Bytes of the channels, for the message where the disk is full.

    Raises:
        OutOfResources: The disk is full or read-only.
    """
    with replacing(path) as temporary:
        try:
            with native_output_silenced():
                OpenEXR.File(header, dict(channels)).write(str(temporary))  # a copy: OpenEXR replaces its values
        except RuntimeError as error:
            message = f"the EXR writer failed ({one_line(error)})"
            raise refusal_of_disk(path, size) or OSError(errno.EIO, message, str(path)) from error


def one_line(error: BaseException) -> str:
    """Return an error's text, its type if it has none."""
    return " ".join(str(error).split()) or type(error).__name__
