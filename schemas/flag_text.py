"""Options as they are typed on a command line."""

from typing import Any


def flags(flag: str, value: Any) -> list[str]:
    """Return the words that set an option, such as --steps 30, --no-masks or --layers a b."""
    if isinstance(value, bool):
        return [flag if value else f"--no-{flag[2:]}"]
    return [flag, *map(str, value if isinstance(value, list | tuple) else [value])]
