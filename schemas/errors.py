"""What can go wrong at a boundary, and the exit code that each kind of fault ends the command with."""


class StylerfError(Exception):
    """A fault told in one line: what was expected, what was found, where, and what to do next.

    keeps_run: what a run has done so far stays for the next one to go on with.
    """

    exit_code = 3
    keeps_run = False


class CheckFailed(StylerfError):
    """A check that was asked for does not hold."""

    exit_code = 1


class UsageError(StylerfError):
    """The command line or configuration asks for something that does not exist."""

    exit_code = 2


class BadInput(StylerfError):
    """Photos, cameras, styles or masks that cannot be used."""

    exit_code = 3


class NoVideo(BadInput):
    """Frames were rendered, but no film could be made of them."""

    keeps_run = True


class ArtifactDamaged(StylerfError):
    """A file of an artifact is missing, cut short or altered since it was written."""

    exit_code = 4


class WouldBeLost(ArtifactDamaged):
    """Files that no run wrote lie where an artifact is to stand."""

    keeps_run = True


class ArtifactStale(StylerfError):
    """An artifact is missing, out of date, or of a schema this version cannot read."""

    exit_code = 4


class OutOfResources(StylerfError):
    """No memory, no disk space, or no permission left to go on."""

    exit_code = 5
    keeps_run = True
