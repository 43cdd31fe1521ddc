"""Errors at the boundary to files and users, each with the exit code of the command."""

from typing import Any


def one_line(error: BaseException) -> str:
    """Return an error's text on one line, or its type if it has none."""
    return " ".join(str(error).split()) or type(error).__name__


class StylerfError(Exception):
    """Base class. The message is one line: what was expected, what was found, where, and what to do next.

    Attributes:
        keeps_run: Whether an unfinished run is kept, so that the next one can resume it.
        details: What `--json` prints in addition to the message.
    """

    exit_code = 3
    keeps_run = False

    def __init__(self, line: str = "", details: dict[str, Any] | None = None) -> None:
        super().__init__(line)
        self.details = details or {}


class CheckFailed(StylerfError):
    """A requested check failed."""

    exit_code = 1


class UsageError(StylerfError):
    """The command line or configuration asks for something that does not exist."""

    exit_code = 2


class TrainedFurther(UsageError):
    """An interrupted run is already past the step at which it should end."""

    keeps_run = True


class BadInput(StylerfError):
    """Unusable photos, cameras, style images or masks."""

    exit_code = 3


class InputGone(BadInput):
    """A file that a run was reading no longer exists."""

    keeps_run = True


class NoVideo(BadInput):
    """Frames were rendered, but could not be encoded as a video."""

    keeps_run = True


class ArtifactDamaged(StylerfError):
    """A file of an artifact is missing, truncated or altered."""

    exit_code = 4


class WouldBeLost(ArtifactDamaged):
    """Files that no run wrote would be overwritten by an artifact."""

    keeps_run = True


class ArtifactStale(StylerfError):
    """An artifact is missing, out of date, or of a schema that this version cannot read."""

    exit_code = 4


class OutOfResources(StylerfError):
    """Memory, disk space or permission is lacking."""

    exit_code = 5
    keeps_run = True
