"""Triton's interpreter without the part of its time in which it prepares `triton.language` again and again.

It replaces the language's functions before every launch and every call of a device function, although those of the
launch are in place by then: looking through the language's modules takes longer than most functions do.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import ModuleType

import pytest


@contextmanager
def patched_once() -> Iterator[None]:
    """Replace the language's functions when they are first needed, and put them back at the end."""
    from triton import language
    from triton.runtime import interpreter

    replace, made, known = interpreter._patch_lang, {}, (language, language.core)

    @cache
    def replaced_once(function: Callable) -> object:
        names = (one for one in function.__globals__.values() if isinstance(one, ModuleType))
        seen = frozenset(id(one) for one in names if one in known)
        if seen not in made:
            made[seen] = replace(function)
        return interpreter._LangPatchScope()  # nothing to put back after a launch

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(interpreter, "_patch_lang", replaced_once)
        try:
            yield
        finally:
            for scope in reversed(made.values()):
                scope.restore()
