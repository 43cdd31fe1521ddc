"""Reads untrusted YAML: plain values only, each key once, no aliases, bounded size and depth."""

from pathlib import Path
from typing import Any

from schemas.errors import OutOfResources, UsageError
from schemas.safe_names import printable
from schemas.safe_reading import read_text

LARGEST = 4 << 20  # bytes
DEEPEST = 20  # levels


def read_yaml(path: Path) -> Any:
    """Return the content of a YAML file.

    YAML lets a later key silently replace an earlier one, and aliases can grow a file exponentially; both are rejected.

    Raises:
        UsageError: it is missing, is not YAML, or contains such constructs.
        OutOfResources: the extra `farm` is not installed.
    """
    try:
        import yaml
    except ModuleNotFoundError:
        raise OutOfResources(
            "PyYAML, which reads the table, is not installed; install it with: pip install 'stylerf[farm]'"
        ) from None

    class Loader(yaml.SafeLoader):
        """Constructs safe values and checks them."""

        depth = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise yaml.constructor.ConstructorError(None, None, "aliases (*name) are not supported", self._mark())
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
                        None, None, "a key is a list or mapping; quote text that contains braces", key.start_mark
                    )
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"{printable(str(key.value))!r} occurs twice", key.start_mark
                    )
                seen.add(key.value)
            return super().construct_mapping(node, deep)

    try:
        text = read_text(path, LARGEST, UsageError)
        return yaml.load(text, Loader)
    except FileNotFoundError:
        raise UsageError(f"{path}: table not found") from None
    # The last four are raised by PyYAML's constructors for tags on values that do not fit, such as `!!int ""`.
    except (yaml.YAMLError, ValueError, RecursionError, TypeError, LookupError, AttributeError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f":{mark.line + 1}" if mark else ""
        why = printable(str(getattr(error, "problem", None) or error).splitlines()[0])
        raise UsageError(f"{path}{where}: {why}") from error
