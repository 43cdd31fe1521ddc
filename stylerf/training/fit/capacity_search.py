"""Which capacity a fit takes: up a ladder while held-out views gain, then down where they lose next to nothing.

Climbing alone cannot tell what a rung is worth: views gain from the time it has had as well. So when the ladder ends,
parts of the field are given up again, each on trial: the field that it leaves is taught for a while where that is
needed, and compared with what stood before. What the views do not miss stays away, and makes every later step cheaper.
"""

import math
from dataclasses import asdict, replace

from stylerf.training.fit.capacity_levels import CapacityLevel, Kinds
from stylerf.training.fit.settings import FitSettings, FitState

LEAST_STEPS_PER_RUNG = 100
# A reduction's trial: part of the budget, within these numbers of steps; a rung's, before it is dropped.
TRIAL_SHARE, TRIAL_STEPS = 0.08, (50, 250)
# dB that a reduction may take at first. A trial brings back about a third of a dB of what resolution held; of ranks it
# brings back little, and what the views gain in its time as well hides that.
HOPELESS, HOPELESS_RANKS = 0.6, 0.3
# Steps in which the rate rises after a reduction: Adam's first steps, without a past, are its largest. (Moments carried
# over were tried and bring a field back more slowly than none.)
RAMP = 5
RANKS = (8, 16)  # that may be gone down to: each number is a set of kernels to compile
RESOLUTIONS = (32, 48, 64, 96, 128, 192, 256, 384, 512)
COLOR_STEP = 16  # a coarser color's resolution is a multiple of it
# An error of one step of an eight-bit photo. What lies beyond is rounding: no reason to grow, and no collapse to lose.
TELLING_PSNR = 20 * math.log10(255)
GROW = "grow"


def _fewer_density_ranks(rung: CapacityLevel, kinds: Kinds, settings: FitSettings) -> dict[str, int]:
    below = [n for n in RANKS if n < rung.density_rank]
    return {"density_rank": below[-1]} if kinds.density == "vm" and below else {}


def _fewer_color_ranks(rung: CapacityLevel, kinds: Kinds, settings: FitSettings) -> dict[str, int]:
    # A headed color's network has one width.
    below = [n for n in RANKS if n < rung.color_rank]
    return {"color_rank": below[-1]} if kinds.color == "vm" and kinds.head == "linear" and below else {}


def _coarser(rung: CapacityLevel, kinds: Kinds, settings: FitSettings) -> dict[str, int]:
    below = [n for n in RESOLUTIONS if n < rung.resolution]
    if not below:
        return {}
    coarser_color = 0 < rung.color_resolution < below[-1]
    return {"resolution": below[-1], "color_resolution": rung.color_resolution if coarser_color else 0}


def _coarser_color(rung: CapacityLevel, kinds: Kinds, settings: FitSettings) -> dict[str, int]:
    # By a third: at once the views miss it no more than a quarter, and a color of 176^3 halves a field of 256^3.
    below = max(RESOLUTIONS[0], round(rung.color.resolution * 2 / 3 / COLOR_STEP) * COLOR_STEP)
    return {"color_resolution": below} if below < rung.color.resolution else {}


def _seen_alike(rung: CapacityLevel, kinds: Kinds, settings: FitSettings) -> dict[str, int]:
    view_dependent = kinds.color == "vm" and kinds.head == "linear" and min(rung.degree, settings.degree) > 0
    return {"degree": 0} if view_dependent else {}


# What can be given up, by name: (rung, kinds, settings) -> the rung's fields as they would be; empty: nothing.
REDUCTIONS = {
    "density ranks": _fewer_density_ranks,
    "resolution": _coarser,
    "color ranks": _fewer_color_ranks,
    "color resolution": _coarser_color,
    "degree": _seen_alike,
}
OF_RANKS = ("density ranks", "color ranks")


def named(rung: CapacityLevel, kinds: Kinds, settings: FitSettings) -> str:
    """A capacity in words: 128^3 rank 16+24; where the color is coarser, 256^3+128^3 rank 16+24."""
    ranks = []
    if kinds.density == "vm":
        ranks.append(rung.density_rank)
    if kinds.color == "vm":
        ranks.append(rung.color_rank)
    degree = min(rung.degree, settings.degree)
    coarser = f"+{rung.color_resolution}^3" if rung.color.resolution != rung.resolution else ""
    words = f"{rung.resolution}^3{coarser}" + (f" rank {'+'.join(map(str, ranks))}" if ranks else "")
    return words + ("" if degree == settings.degree else f" degree {degree}")


class CapacitySearch:
    """What is tried next, and what becomes of it; it knows no array.

    state.trial, while one is on: {what: `grow` or a reduction's name, before: dB, from, parameters: of the field
    before; of a rung the progress at which it was `begun` and, where it is prolonged, at which it ends; of a reduction
    its first step, the step `until` which it goes on, and what was `given_up` before}.
    """

    def __init__(self, settings: FitSettings, state: FitState, judges: str) -> None:
        self.settings, self.state, self.judges = settings, state, judges

    @property
    def rung(self) -> CapacityLevel:
        """The present capacity."""
        return replace(self.settings.ladder[self.state.rung], **self.state.given_up)

    def name(self, rung: CapacityLevel) -> str:
        return named(rung, self.settings.kinds, self.settings)

    # -- when -------------------------------------------------------------------------------------------------------

    def _ripe(self, progress: float) -> bool:
        """Whether the present rung has had its least steps.

        On the way to a capacity that was asked for an even part of a short budget is enough.
        """
        rungs = self.state.rung + 1
        even = self.settings.always_climb and progress >= rungs / (self._last + 1)
        return even or self.state.step >= LEAST_STEPS_PER_RUNG * rungs

    def _used_up(self, progress: float) -> bool:
        """Whether the present rung has had its share of the budget, or as many steps as do it good."""
        rung, settings = self.state.rung, self.settings
        end = settings.shares[rung] if rung < len(settings.shares) else settings.held_out_until
        return progress >= end or (rung < len(settings.longest) and self.state.step >= settings.longest[rung])

    @property
    def _last(self) -> int:
        return min(len(self.settings.ladder) - 1, len(self.settings.shares))

    def rung_due(self, progress: float) -> bool:
        """Whether the next rung is to be tried."""
        s, settings = self.state, self.settings
        possible = not s.fixed and s.trial is None and s.rung < self._last
        due = possible and self._ripe(progress) and self._used_up(progress)
        # Views that are trained on decide nothing: a trial needs its least steps before that, unless it is none.
        return due and (settings.always_climb or self._steps_left(progress) >= LEAST_STEPS_PER_RUNG)

    def _steps_left(self, progress: float) -> float:
        """Steps until the held-out views are trained on."""
        return (self.settings.held_out_until / max(progress, 1e-9) - 1) * self.state.step

    def _trial_steps(self, progress: float) -> int:
        whole = self.state.step / max(progress, 1e-9)
        return round(min(max(TRIAL_SHARE * whole, TRIAL_STEPS[0]), TRIAL_STEPS[1]))

    def reduction_due(self, progress: float) -> str | None:
        """The name of what is to be given up next, on trial."""
        s, settings = self.state, self.settings
        climbing = not s.fixed and s.rung < self._last
        if settings.always_climb or s.trial is not None or climbing or not self._ripe(progress):
            return None
        if not s.fixed and not self._used_up(progress):
            return None
        return None if self._steps_left(progress) < self._trial_steps(progress) else self._next_reduction()

    def _next_reduction(self) -> str | None:
        s, settings = self.state, self.settings
        for name in settings.reductions:
            # What a rung gained in its trial is the least that it will: later, what the views gain by more training
            # would hide that they miss it. One that is no larger may have been kept without a gain.
            if name == "resolution" and s.climbed is not None and s.climbed >= settings.min_gain:
                continue
            if name not in s.refused and REDUCTIONS[name](self.rung, settings.kinds, settings):
                return name
        return None

    @property
    def settled(self) -> bool:
        """Whether nothing is on trial, and nothing left that could be."""
        top = self.state.trial is None and (self.state.fixed or self.state.rung >= self._last)
        return top and (self.settings.always_climb or self._next_reduction() is None)

    def over(self, progress: float) -> bool:
        """Whether the trial that is on has had its time."""
        trial = self.state.trial
        if trial is None:
            return False
        if trial["what"] != GROW and self.state.step >= trial["until"]:
            return True
        if trial["what"] == GROW and self.settings.always_climb:
            return True  # nothing is to be decided: a fall later must lead back to this rung, not to the one before
        due = trial["what"] == GROW and self._ripe(progress) and self._used_up(progress)
        return (due and progress >= trial.get("longer", 0.0)) or progress >= self.settings.held_out_until

    def prolonged(self, quality: float, parameters: int, progress: float) -> bool:
        """Whether a rung that has not gained enough when its trial is over is tried longer; noted where it is.

        After a few hundred of very many steps a rung shows little, and the views' noise may hide it: none is dropped
        that has had less than TRIAL_SHARE of the budget.
        """
        trial = self.state.trial
        until = min(trial.get("begun", 0.0) + TRIAL_SHARE, self.settings.held_out_until)
        if trial["what"] != GROW or progress >= until or self._gained(quality, parameters):
            return False
        trial["longer"] = until
        return True

    def _gained(self, quality: float, parameters: int) -> bool:
        """Whether the rung on trial has gained enough; one that costs nothing need gain nothing."""
        trial, settings = self.state.trial, self.settings
        least = settings.min_gain if parameters > trial["parameters"] else 0.0
        return quality - trial["before"] >= least or settings.always_climb

    def hopeless(self, quality: float) -> bool:
        """Whether a reduction, just made, has lost more than it can win back."""
        trial = self.state.trial
        bound = HOPELESS_RANKS if trial["what"] in OF_RANKS else HOPELESS
        return not min(trial["before"], TELLING_PSNR) - quality <= bound  # so written, NaN is hopeless

    def enough(self, quality: float) -> bool:
        """Whether the views lose next to nothing by what is on trial."""
        return quality >= min(self.state.whole, TELLING_PSNR) - self.settings.min_gain

    @property
    def rate(self) -> float:
        """Factor of the learning rate."""
        trial = self.state.trial
        if trial is None or trial["what"] == GROW:
            return 1.0
        return min(1.0, (self.state.step - trial["step"] + 1) / RAMP)

    # -- what -------------------------------------------------------------------------------------------------------

    def begin(self, what: str, quality: float, parameters: int, progress: float) -> CapacityLevel:
        """Put a change on trial; the capacity to go on with."""
        state, settings = self.state, self.settings
        before = self.rung
        state.trial = {"what": what, "before": quality, "from": asdict(before), "parameters": parameters}
        if what == GROW:
            state.trial["begun"] = progress
            state.rung += 1
        else:
            state.whole = quality if state.whole is None else max(state.whole, quality)
            until = state.step + self._trial_steps(progress)
            state.trial |= {"step": state.step, "until": until, "given_up": dict(state.given_up)}
            state.given_up |= REDUCTIONS[what](before, settings.kinds, settings)
        return self.rung

    def judge(self, quality: float, parameters: int) -> tuple[bool, str]:
        """End the trial: whether what was tried stays, and why in words. parameters: of the field on trial."""
        settings, trial = self.settings, self.state.trial
        old, new, gain = CapacityLevel(**trial["from"]), self.rung, quality - trial["before"]
        names, sizes = (self.name(old), self.name(new)), (trial["parameters"], parameters)
        if trial["what"] == GROW:
            kept = self._gained(quality, parameters)
            if settings.always_climb:
                text = f"{names[1]} after {names[0]}, as asked for"
            elif kept:
                self.state.climbed = round(gain, 3)
                text = f"{names[1]} kept: {self.judges} gained {gain:.2f} dB over {names[0]}"
            else:
                times = parameters / trial["parameters"]
                text = f"{names[1]} dropped: {gain:+.2f} dB for {times:.1f} times the size; staying at {names[0]}"
                self._note(names[1], names[0], sizes[1], sizes[0], gain)
        else:
            kept = self.enough(quality)
            times = trial["parameters"] / parameters
            larger = f"{names[0]}, {times:.1f} times the size" if times > 1.05 else names[0]
            verdict = "is enough" if kept else "is too little"
            text = f"{names[1]} {verdict}: {self.judges} {gain:+.2f} dB against {larger}"
            self._note(names[0], names[1], sizes[0], sizes[1], -gain)
        self.end(kept)
        return kept, text

    def _note(self, larger: str, smaller: str, more: int, fewer: int, gain: float) -> None:
        self.state.sizes.append(
            {"larger": larger, "smaller": smaller, "parameters": [more, fewer], "gain": round(gain, 3)}
        )

    def end(self, kept: bool) -> None:
        """Leave the trial; where it is not kept, the capacity before it stands again."""
        state, trial = self.state, self.state.trial
        state.trial = None
        if kept:
            return
        if trial["what"] == GROW:
            state.rung, state.fixed = state.rung - 1, True
        else:
            state.given_up = trial["given_up"]
            state.refused.append(trial["what"])

    # -- what it came to --------------------------------------------------------------------------------------------

    def told(self, parameters: int) -> str:
        """The capacity that stands in one line, with what more of it would gain and less of it would lose."""
        kinds, here = self.settings.kinds, self.name(self.rung)
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
