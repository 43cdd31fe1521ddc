"""How a command line gives a value to an option."""

from typing import Any


def flags(flag: str, value: Any) -> list[str]:
    """Words of the command line: --steps 30, --no-masks, --layers a b."""
    if isinstance(value, bool):
        return [flag if value else f"--no-{flag[2:]}"]
    return [flag, *map(str, value if isinstance(value, list | tuple) else [value])]
