"""Descriptions and arrays of artifacts, as they are turned into what the mathematics works with: sound, or damaged."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from schemas.errors import ArtifactDamaged

# What a constructor raises where its arguments are not what it takes; InvalidValue is a ValueError.
UNSOUND = (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, RecursionError)


@contextmanager
def sound(path: Path, what: str) -> Iterator[None]:
    """ArtifactDamaged, naming the path, where what is made of a file's numbers within refuses them.

    what: is made of them, with its article.
    """
    try:
        yield
    except UNSOUND as error:
        why = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
        raise ArtifactDamaged(f"{path} does not hold {what} ({why}); rebuild it") from error
