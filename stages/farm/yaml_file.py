"""Read YAML that strangers may have written: plain values only, each key once, no aliases, bounded size and depth."""

from pathlib import Path
from typing import Any

from schemas.errors import OutOfResources, UsageError
from schemas.safe_names import printable
from schemas.safe_reading import read_text

LARGEST = 4 << 20  # bytes
DEEPEST = 20  # levels


def read_yaml(path: Path) -> Any:
    """Return what a YAML file holds.

    YAML lets a later key replace an earlier one silently, and aliases grow a file exponentially; both are refused.

    Raises:
        UsageError: it is missing, is not YAML, or holds such things.
        OutOfResources: the extra `farm` is not installed.
    """
    try:
        import yaml
    except ModuleNotFoundError:
        raise OutOfResources(
            "PyYAML, which reads the table, is not installed; install it with: pip install 'stylerf[farm]'"
        ) from None

    class Loader(yaml.SafeLoader):
        """Safe values, checked on the way."""

        depth = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise yaml.constructor.ConstructorError(None, None, "aliases (*name) are not taken", self._mark())
            self.depth += 1
            if self.depth > DEEPEST:
                raise yaml.constructor.ConstructorError(None, None, "it is nested too deeply", self._mark())
            node = super().compose_node(parent, index)
            self.depth -= 1
            return node

        def _mark(self) -> Any:
            return self.peek_event().start_mark

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            seen = set()
            for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
                if not isinstance(key, yaml.ScalarNode):
                    raise yaml.constructor.ConstructorError(
                        None, None, "a key is a list or mapping; quote text that holds braces", key.start_mark
                    )
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"{printable(str(key.value))!r} is there twice", key.start_mark
                    )
                seen.add(key.value)
            return super().construct_mapping(node, deep)

    try:
        text = read_text(path, LARGEST, UsageError)
        return yaml.load(text, Loader)
    except FileNotFoundError:
        raise UsageError(f"{path}: there is no such table") from None
    # The last four: what PyYAML's constructors raise for tags on values that do not fit them, such as `!!int ""`.
    except (yaml.YAMLError, ValueError, RecursionError, TypeError, LookupError, AttributeError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f":{mark.line + 1}" if mark else ""
        why = printable(str(getattr(error, "problem", None) or error).splitlines()[0])
        raise UsageError(f"{path}{where}: {why}") from error
