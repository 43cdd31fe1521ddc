"""Search for the capacity of a fit: grow while held-out views gain, then prune what they hardly lose by.

Growth alone cannot show what a level is worth, since views also gain from its training time. After the last level,
parts of the field are therefore pruned. Parts whose removal causes no immediate loss stay pruned, which makes all later
steps cheaper.
"""

import math
from dataclasses import replace

from stylerf.training.fit.settings import CapacityLevel, FitSettings, FitState, Kinds, Trial

MIN_STEPS_PER_LEVEL = 100
TRIAL_SHARE = 0.08  # minimum fraction of the budget that a level gets before it is dropped
RANKS = (8, 16)  # that pruning may reach; each needs its own set of compiled kernels
RESOLUTIONS = (32, 48, 64, 96, 128, 192, 256, 384, 512)
COLOR_STEP = 16  # a coarser color's resolution is a multiple of it
# PSNR for an error of one 8-bit step of the photos. Beyond that is rounding: no reason to grow, no sign of collapse.
ROUNDING_PSNR = 20 * math.log10(255)


def _fewer_density_ranks(level: CapacityLevel, kinds: Kinds, settings: FitSettings) -> dict[str, int]:
    below = [n for n in RANKS if n < level.density_rank]
    return {"density_rank": below[-1]} if kinds.density == "vm" and below else {}


def _fewer_color_ranks(level: CapacityLevel, kinds: Kinds, settings: FitSettings) -> dict[str, int]:
    # An MLP head has a fixed input width.
    below = [n for n in RANKS if n < level.color_rank]
    return {"color_rank": below[-1]} if kinds.color == "vm" and kinds.head == "linear" and below else {}


def _coarser(level: CapacityLevel, kinds: Kinds, settings: FitSettings) -> dict[str, int]:
    below = [n for n in RESOLUTIONS if n < level.resolution]
    if not below:
        return {}
    coarser_color = 0 < level.color_resolution < below[-1]
    return {"resolution": below[-1], "color_resolution": level.color_resolution if coarser_color else 0}


def _coarser_color(level: CapacityLevel, kinds: Kinds, settings: FitSettings) -> dict[str, int]:
    # By a third: views hardly lose more than by a quarter, and a color of 176^3 halves a field of 256^3.
    below = max(RESOLUTIONS[0], round(level.color.resolution * 2 / 3 / COLOR_STEP) * COLOR_STEP)
    return {"color_resolution": below} if below < level.color.resolution else {}


def _view_independent(level: CapacityLevel, kinds: Kinds, settings: FitSettings) -> dict[str, int]:
    view_dependent = kinds.color == "vm" and kinds.head == "linear" and min(level.degree, settings.degree) > 0
    return {"degree": 0} if view_dependent else {}


# By name: (level, kinds, settings) -> changed attributes of the level; empty if there is nothing to prune.
PRUNINGS = {
    "density ranks": _fewer_density_ranks,
    "resolution": _coarser,
    "color ranks": _fewer_color_ranks,
    "color resolution": _coarser_color,
    "degree": _view_independent,
}


class CapacitySearch:
    """Decides what to try next and whether to keep it; holds no arrays.

    judges: text that names what the quality is measured on.
    """

    def __init__(self, settings: FitSettings, state: FitState, judges: str) -> None:
        self.settings, self.state, self.judges = settings, state, judges

    @property
    def level(self) -> CapacityLevel:
        """The current capacity."""
        return replace(self.settings.levels[self.state.level], **self.state.pruned)

    @property
    def trial(self) -> Trial:
        """The level on trial; only valid while there is one."""
        assert self.state.trial is not None
        return self.state.trial

    def name(self, level: CapacityLevel) -> str:
        """Format a capacity: 128^3 rank 16+24; with a coarser color, 256^3+128^3 rank 16+24."""
        kinds, wanted = self.settings.kinds, self.settings.degree
        vm = (kinds.density, level.density_rank), (kinds.color, level.color_rank)
        ranks = [str(rank) for kind, rank in vm if kind == "vm"]
        degree = min(level.degree, wanted)
        coarser = f"+{level.color_resolution}^3" if level.color.resolution != level.resolution else ""
        words = f"{level.resolution}^3{coarser}" + (f" rank {'+'.join(ranks)}" if ranks else "")
        return words + ("" if degree == wanted else f" degree {degree}")

    # -- when -------------------------------------------------------------------------------------------------------

    def _past_minimum(self, progress: float) -> bool:
        """Whether the current level has had its minimum number of steps.

        On the way to a fixed capacity, an equal share of a short budget is enough.
        """
        levels = self.state.level + 1
        even = self.settings.force_growth and progress >= levels / (self._last + 1)
        return even or self.state.step >= MIN_STEPS_PER_LEVEL * levels

    def _used_up(self, progress: float) -> bool:
        """Whether the current level has used its part of the budget, or its maximum number of steps."""
        level, settings = self.state.level, self.settings
        end = settings.level_ends[level] if level < len(settings.level_ends) else settings.held_out_until
        most = settings.level_max_steps
        return progress >= end or (level < len(most) and self.state.step >= most[level])

    @property
    def _last(self) -> int:
        return min(len(self.settings.levels) - 1, len(self.settings.level_ends))

    def growth_due(self, progress: float) -> bool:
        """Whether to try the next level now."""
        s, settings = self.state, self.settings
        possible = not s.growth_ended and s.trial is None and s.level < self._last
        due = possible and self._past_minimum(progress) and self._used_up(progress)
        # Views that are trained on cannot decide anything, so a trial needs its minimum of steps before that.
        return due and (settings.force_growth or self._steps_left(progress) >= MIN_STEPS_PER_LEVEL)

    def _steps_left(self, progress: float) -> float:
        """Estimate the steps left until held-out views are trained on."""
        return (self.settings.held_out_until / max(progress, 1e-9) - 1) * self.state.step

    def pruning_due(self, progress: float) -> str | None:
        """Return the name of what to prune now, or None."""
        s, settings = self.state, self.settings
        growing = not s.growth_ended and s.level < self._last
        if settings.force_growth or s.trial is not None or growing or not self._past_minimum(progress):
            return None
        if not s.growth_ended and not self._used_up(progress):
            return None
        # Views that are trained on cannot judge a loss.
        return self._next_pruning() if progress < settings.held_out_until else None

    def _next_pruning(self) -> str | None:
        s, settings = self.state, self.settings
        for name in settings.prunings:
            # A level is worth at least its gain during the trial; later, the gain from further training would hide its
            # loss. A level that is no larger may have been kept without a gain.
            if name == "resolution" and s.level_gain is not None and s.level_gain >= settings.min_gain:
                continue
            if name not in s.rejected and PRUNINGS[name](self.level, settings.kinds, settings):
                return name
        return None

    @property
    def settled(self) -> bool:
        """Whether nothing is on trial and nothing is left to try."""
        top = self.state.trial is None and (self.state.growth_ended or self.state.level >= self._last)
        return top and (self.settings.force_growth or self._next_pruning() is None)

    def over(self, progress: float) -> bool:
        """Whether the current level's trial is over."""
        trial = self.state.trial
        if trial is None:
            return False
        if self.settings.force_growth:
            return True  # nothing to decide: a later rollback must return to this level, not to the one before
        due = self._past_minimum(progress) and self._used_up(progress)
        # Nothing can be judged once the held-out views are trained on.
        return (due and progress >= trial.extended_until) or progress >= self.settings.held_out_until

    def extended(self, quality: float, parameters: int, progress: float) -> bool:
        """Extend the trial of a level that has not gained enough; return whether it was extended.

        A few hundred out of very many steps reveal little, possibly less than noise: no level is dropped before it has
        had TRIAL_SHARE of the budget.
        """
        trial = self.trial
        until = min(trial.began_at + TRIAL_SHARE, self.settings.held_out_until)
        if progress >= until or self._gained(quality, parameters):
            return False
        trial.extended_until = until
        return True

    def _gained(self, quality: float, parameters: int) -> bool:
        """Whether the level on trial has gained enough; one that is no larger need not gain anything."""
        trial, settings = self.trial, self.settings
        # A lean last level can be smaller than the one before (decision 0040).
        required = settings.min_gain if parameters > trial.parameters else 0.0
        return quality - trial.before >= required or settings.force_growth

    # -- what -------------------------------------------------------------------------------------------------------

    def grow(self, quality: float, parameters: int, progress: float) -> CapacityLevel:
        """Start the trial of the next level and return that level. quality, parameters: of the current field."""
        self.state.trial = Trial(quality, self.level, parameters, began_at=progress)
        self.state.level += 1
        return self.level

    def judge(self, quality: float, parameters: int) -> tuple[bool, str]:
        """End a level's trial; return whether it is kept, and the reason. parameters: of the field on trial."""
        trial, old, new = self.trial, self.name(self.trial.level), self.name(self.level)
        gain, kept = quality - trial.before, self._gained(quality, parameters)
        if self.settings.force_growth:
            text = f"{new} after {old}, as requested"
        elif kept:
            self.state.level_gain = round(gain, 3)
            text = f"{new} kept: {self.judges} gained {gain:.2f} dB over {old}"
        else:
            times = parameters / trial.parameters
            text = f"{new} dropped: {gain:+.2f} dB for {times:.1f} times the size; staying at {old}"
            self._note(new, old, parameters, trial.parameters, gain)
        self.end(kept)
        return kept, text

    def end(self, kept: bool) -> None:
        """End a level's trial; unless `kept`, return to the previous level."""
        self.state.trial = None
        if not kept:
            self.state.level, self.state.growth_ended = self.state.level - 1, True

    def pruned(self, what: str) -> CapacityLevel:
        """Return the current capacity after a pruning."""
        return replace(self.level, **PRUNINGS[what](self.level, self.settings.kinds, self.settings))

    def judge_pruning(self, what: str, before: float, after: float, parameters: tuple[int, int]) -> tuple[bool, str]:
        """Return whether a pruning is kept, and the reason: there may be almost no immediate loss (decision 0063).

        before, after: qualities, dB. parameters: of the field before and after.
        """
        state, old, new, (more, fewer) = self.state, self.name(self.level), self.name(self.pruned(what)), parameters
        state.unpruned = before if state.unpruned is None else max(state.unpruned, before)
        kept = after >= min(state.unpruned, ROUNDING_PSNR) - self.settings.min_gain
        if kept:
            state.pruned |= PRUNINGS[what](self.level, self.settings.kinds, self.settings)
        else:
            state.rejected.append(what)
        larger = f"{old}, {more / fewer:.1f} times the size" if more > 1.05 * fewer else old
        self._note(old, new, more, fewer, before - after)
        verdict = "is enough" if kept else "is too little"
        return kept, f"{new} {verdict}: {self.judges} {after - before:+.2f} dB against {larger}"

    def _note(self, larger: str, smaller: str, more: int, fewer: int, gain: float) -> None:
        self.state.sizes.append(
            {"larger": larger, "smaller": smaller, "parameters": [more, fewer], "gain": round(gain, 3)}
        )

    # -- the result -------------------------------------------------------------------------------------------------

    def summary(self, parameters: int) -> str:
        """Return the final capacity in one line, with the gain of a larger one and the loss of a smaller one."""
        kinds, here = self.settings.kinds, self.name(self.level)
        kind = kinds.density if kinds.density == kinds.color else f"{kinds.density}+{kinds.color}"
        line = f"{kind} {here}, {parameters / 1e6:.2f} M parameters"
        more = [s for s in self.state.sizes if s["smaller"] == here]
        less = [s for s in self.state.sizes if s["larger"] == here]
        found = []
        for s in more[-1:]:
            times = s["parameters"][0] / s["parameters"][1]
            found.append(f"{s['larger']} would gain {s['gain']:.2f} dB for {times:.1f}x the size")
        for s in sorted(less, key=lambda s: s["gain"])[:1]:  # the least costly
            found.append(f"{s['smaller']} would lose {s['gain']:.2f} dB")
        return f"{line}: {'; '.join(found)}" if found else line
