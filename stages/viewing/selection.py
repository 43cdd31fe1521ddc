"""A selection in progress: its options as in `stylerf select`, and undo."""

from dataclasses import dataclass, field, replace

from stages.configs.select import SelectConfig

MOST_STEPS = 20


@dataclass(frozen=True)
class Selection:
    """Options of a selection in progress; empty ones select nothing yet. combined: (region, how), in order."""

    at: tuple[str, ...] = ()
    avoid: tuple[str, ...] = ()
    box: tuple[float, ...] = ()
    tolerance: float = SelectConfig.tolerance
    steps: int = SelectConfig.steps
    iterations: int = SelectConfig.iterations
    reach: float = SelectConfig.reach
    union: tuple[str, ...] = ()
    subtract: tuple[str, ...] = ()
    intersect: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.at or self.box or self.union)

    def config(self) -> SelectConfig:
        """Return the options of `stylerf select`; ValueError if they are inconsistent."""
        own = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return SelectConfig(**own)


@dataclass
class History:
    """Selections up to the current one, for undo."""

    states: list[Selection] = field(default_factory=lambda: [Selection()])

    @property
    def now(self) -> Selection:
        """The current selection."""
        return self.states[-1]

    def change(self, **values: object) -> Selection:
        """Change the selection, as a new state unless nothing changes."""
        new = replace(self.now, **values)  # type: ignore[arg-type]  # replace checks the names
        if new != self.now:
            self.states.append(new)
        return new

    def add(self, name: str, value: str) -> Selection:
        """Add to one of the lists."""
        return self.change(**{name: (*getattr(self.now, name), value)})

    def undo(self) -> Selection:
        """Return to the previous selection, if there is one."""
        if len(self.states) > 1:
            self.states.pop()
        return self.now

    def clear(self) -> Selection:
        """Start over; undo brings the old selection back."""
        return self.change(**{name: getattr(Selection(), name) for name in Selection.__dataclass_fields__})
