"""Which kind of bristles an element has: cross-validation over its micro-motions, where the data can tell.

Each kind is fitted to all micro-motions but one, and compared with the one that is left, in turn. What is left over in
the motions that were not fitted, line by line of the spectrum, says how well a kind predicts.

A kind is told from the best one if the logarithm of its residual power in a line, noise included, is larger by more
than three standard errors in the mean over the lines. If every other kind is told from the best one, that is the
element's; else the data cannot tell.

Elements that share joints are compared together, for only sums of their torques are measured: all sets of kinds are
fitted to all motions, and for each kind of each element the set that fits best is cross-validated. So a kind of an
element is told only if others of it predict worse whatever kinds its neighbours have.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import stats

from rx90_common.base.arrays import Array
from rx90_common.base.quoting import listed
from rx90_common.friction.held_out import HeldOutErrors, leave_out
from rx90_common.friction.parts.bristles import BristlesPart
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.estimates import LARGEST_DEVIATION, PRESLIDING, ParameterEstimate
from rx90_emulator.identification.presliding.bristle_motion import (
    ATTRACTION,
    FAMILIES,
    KindFamily,
    KindMotion,
    joint_groups,
)
from rx90_emulator.identification.presliding.fit import PreslidingFit
from rx90_emulator.identification.presliding.group_fit import GroupFit
from rx90_emulator.identification.records import BagSource

MIN_MOTIONS: Final = 3
"""Micro-motions of a joint, below which nothing is left to be predicted."""
MAX_ELEMENTS: Final = 3
"""Elements that are compared together; with each more, the sets of kinds are three times as many."""
DISTINGUISHABLE_SE: Final = 3.0
"""Standard errors by which a kind must predict worse than the best one to be told from it."""
_MIN_RELATIVE_SD = {"c0": 0.002, "c1": 0.01}  # relative: encoder steps, and 10 us of timing, show in no residual
_MIN_RELATIVE_SD_SHARED = {"c0": 0.02, "c1": 0.05}  # of elements that share joints: others' errors are alike in all
_MIN_SD_OF_PARTS = 0.02  # of numbers in parts: errors of the sliding regime are the same in all motions
_MAX_MISSED = 0.5  # of the friction torque, by the kind that predicts best, noise included
_MAX_INERTIA_ERROR = 0.1  # relative error of the joint's inertia
_MAX_REACH = 2.0  # of a block, in parts of the travel: there and back, a block with half of it slips


@dataclass(frozen=True, eq=False)
class KindTrial:
    """What became of a kind of bristles.

    Attributes:
        family: the kind.
        bristles: that fit all motions; None is LuGre's.
        seen: torque of the element along its largest motion, measured, with others' taken off by the fit, and fitted,
            block means, Nm, each shape (b,).
        estimates: of c0, c1 and the kind's own numbers; the deviations are those of the jackknife over the motions.
        missed: RMS of what it misses in motions that were not fitted, over the RMS of the friction torque.
        behind: by how many standard errors it predicts worse than the best kind; 0 for that.
        inertia: largest relative error of the joints' inertia.
        reach: largest deflection at which a block slips, rad; 0 without blocks.
    """

    family: KindFamily
    bristles: BristlesPart | None
    seen: tuple[Array, Array]
    estimates: dict[str, ParameterEstimate]
    missed: float
    behind: float
    inertia: float = 0.0
    reach: float = 0.0

    @property
    def distinguishable(self) -> bool:
        """Return whether the data tell it from the best kind."""
        return self.behind > DISTINGUISHABLE_SE


@dataclass(frozen=True, eq=False)
class KindChoice:
    """The kinds of bristles that were tried for an element.

    Attributes:
        trials: by kind, in the order of the families that were tried.
        position: along the element's largest motion, rad, block means, shape (b,).
    """

    trials: tuple[KindTrial, ...]
    position: Array

    @property
    def best(self) -> KindTrial:
        """Return the trial that predicts best."""
        return min(self.trials, key=lambda trial: trial.behind)

    @property
    def possible(self) -> tuple[KindTrial, ...]:
        """Return the trials that the data cannot tell from the best, which is among them."""
        return tuple(trial for trial in self.trials if not trial.distinguishable)

    @property
    def kind(self) -> str | None:
        """Return "LuGre", "elasto-plastic" or "Maxwell slip"; None where the data cannot tell."""
        kinds = {trial.family.kind for trial in self.possible}
        return kinds.pop() if len(kinds) == 1 else None

    @property
    def margin(self) -> float:
        """Return by how many standard errors the best trial of another kind than the best one's is behind."""
        others = [trial.behind for trial in self.trials if trial.family.kind != self.best.family.kind]
        return min(others, default=0.0)

    @property
    def doubt(self) -> str:
        """Return why no kind is told; "" if one is."""
        best = self.best
        if best.missed > _MAX_MISSED:
            return f"even the best kind, {best.family.name}, misses {100.0 * best.missed:.0f} % of the friction torque"
        if self.kind is None:
            return f"the data do not tell {listed([trial.family.name for trial in self.possible])} apart"
        if best.inertia > _MAX_INERTIA_ERROR:
            error = f"{100.0 * best.inertia:.0f} % off the description's"
            return f"the joint's inertia would be {error}: a payload or a rotor may be missing"
        travel = float(np.ptp(self.position))
        if best.reach > _MAX_REACH * travel:
            return (
                f"Maxwell slip predicts best, but a block would slip only after {1e3 * best.reach:.2g} mrad, and "
                f"the micro-oscillations went through {1e3 * travel:.2g} mrad"
            )
        return ""


@dataclass(frozen=True, eq=False)
class ElementKind:
    """What is known of the kind of an element's bristles.

    Attributes:
        element: its name.
        reason: why no kind is told; "" where one is.
        choice: what was tried; None where nothing could be.
        sources: the bags that it rests on.
    """

    element: str
    reason: str
    choice: KindChoice | None = None
    sources: tuple[BagSource, ...] = ()

    @property
    def decision(self) -> str:
        """Return "LuGre", "elasto-plastic", "Maxwell slip", "cannot tell", or "not compared"."""
        if self.choice is None:
            return "not compared"
        return self.choice.best.family.kind if self.decided else "cannot tell"

    @property
    def decided(self) -> bool:
        """Return whether the data tell it, LuGre's too."""
        return self.choice is not None and not self.reason

    @property
    def trial(self) -> KindTrial | None:
        """Return the trial whose bristles take the place of LuGre's; None where LuGre's stay."""
        best = self.choice.best if self.choice is not None and self.decided else None
        return None if best is None or best.bristles is None else best

    @property
    def bristles(self) -> BristlesPart | None:
        """Return the bristles that the element gets; None is LuGre's."""
        return None if self.trial is None else self.trial.bristles

    @property
    def text(self) -> str:
        """Return the decision with how sure it is, or why there is none."""
        if self.choice is None or self.reason:
            return f"{self.decision}: {self.reason}"
        return f"{self.decision}, told from the others by {self.choice.margin:.1f} standard errors or more"

    @property
    def largest(self) -> tuple[Array, dict[str, Array]]:
        """Return position, rad from the mean, and torque of the bristles, Nm, of the largest micro-motion compared.

        The torques are the measured one, that of the best kind and those of the best trial of each other kind, by name.
        """
        assert self.choice is not None
        shown: dict[str, KindTrial] = {}
        for trial in sorted(self.choice.trials, key=lambda trial: trial.behind):
            shown.setdefault(trial.family.kind, trial)
        torques = {"measured": self.choice.best.seen[0]}
        torques |= {trial.family.name: trial.seen[1] for trial in shown.values()}
        position = self.choice.position
        return position - position.mean(), {name: torque - torque.mean() for name, torque in torques.items()}


def decisions(kinds: Iterable[ElementKind]) -> list[tuple[str, str]]:
    """Return what became of each element in words, elements of which the same is said together."""
    together: dict[str, list[str]] = {}
    for kind in kinds:
        together.setdefault(kind.text, []).append(kind.element)
    return [(", ".join(names), text) for text, names in together.items()]


def choose_kinds(
    fit: PreslidingFit, arm: RigidArm, progress: Callable[[str], None] = lambda _: None
) -> tuple[ElementKind, ...]:
    """Return the kind of bristles of each element, in the arm's order.

    Args:
        fit: with LuGre's bristles, of the arm.
        arm: whose elements these are.
        progress: called `kind_steps(arm)` times, with what is done next.
    """
    groups = {moved.elements: moved for moved in fit.groups}
    found: dict[str, ElementKind] = {}
    for elements in (group.elements for group in joint_groups(arm)):
        names, moved = [arm.element_names[e] for e in elements], groups.get(elements)
        least, count = max(MIN_MOTIONS, 2 * len(names)), 0 if moved is None else len(moved.motions)
        if moved is not None and count >= least and len(names) <= MAX_ELEMENTS:
            choices = choose_kinds_of(
                moved.motions,
                moved.c0,
                FAMILIES,
                lambda place, kind, names=names: progress(f"{names[place]}: {kind}"),  # type: ignore[misc]
            )
            for name, one in zip(names, choices, strict=True):
                found[name] = ElementKind(name, one.doubt, one, moved.sources)
            continue
        for _ in range(steps_of(len(names), FAMILIES)):
            progress(f"{listed(names)}: bristles")
        reason = f"{count} micro-oscillations; {least} or more tell kinds apart"
        if len(names) > MAX_ELEMENTS:
            reason = f"{len(names)} elements share joints; accepted: {MAX_ELEMENTS} at most"
        found |= {name: ElementKind(name, reason) for name in names}
    return tuple(found[name] for name in arm.element_names)


def kind_steps(arm: RigidArm) -> int:
    """Return how many steps `choose_kinds` takes."""
    return sum(steps_of(len(group.elements), FAMILIES) for group in joint_groups(arm))


def steps_of(elements: int, families: Sequence[KindFamily]) -> int:
    """Return how often `choose_kinds_of` calls `progress`."""
    searched = len(_middle(families)) ** elements if 1 < elements <= MAX_ELEMENTS else 0
    return searched + elements * len(families)


def _middle(families: Sequence[KindFamily]) -> dict[str, KindFamily]:
    """Return a family for each kind, that in the middle."""
    kinds: dict[str, list[KindFamily]] = {}
    for family in families:
        kinds.setdefault(family.kind, []).append(family)
    return {kind: some[(len(some) - 1) // 2] for kind, some in kinds.items()}


def choose_kinds_of(
    motions: Sequence[KindMotion],
    c0: Array,
    families: Sequence[KindFamily] = FAMILIES,
    progress: Callable[[int, str], None] = lambda *_: None,
) -> list[KindChoice]:
    """Return which kinds of bristles the elements of a group of joints have.

    Args:
        motions: micro-motions of the group of e elements, 2 e or more, and at least MIN_MOTIONS.
        c0: a first guess, Nm/rad, such as that of the fit with LuGre's bristles, shape (e,).
        families: what is tried.
        progress: called `steps_of(e, families)` times, with the place of an element and the name of a kind before the
            kind is tried.
    """
    count = len(c0)
    middle = _middle(families)
    fits: dict[tuple[KindFamily, ...], GroupFit] = {}
    if count > 1:
        for tried in itertools.product(middle.values(), repeat=count):
            progress(0, ", ".join(family.name for family in tried))
            fits[tried] = GroupFit.of(tried, motions, c0)
    searched = list(fits)
    sets: list[list[tuple[KindFamily, ...]]] = [[] for _ in range(count)]  # of each element, one for each family
    without: dict[tuple[KindFamily, ...], list[GroupFit]] = {}
    power: dict[tuple[KindFamily, ...], Array] = {}
    for place, family in itertools.product(range(count), families):
        progress(place, family.name)
        own = middle[family.kind]
        # The set that fits best of those with the family at the place.
        best = min((some for some in searched if some[place] is own), key=lambda some: fits[some].cost, default=(own,))
        chosen = (*best[:place], family, *best[place + 1 :])
        sets[place].append(chosen)
        if chosen not in fits:
            fits[chosen] = GroupFit.of(chosen, motions, c0)
        if chosen not in power:
            without[chosen], power[chosen] = _held_out(fits[chosen])
    errors = HeldOutErrors(power)
    best = errors.best()
    model = fits[best].model
    friction = sum(float(np.sum((motion.target / model.scale) ** 2)) for motion in model.motions)
    floor = _MIN_RELATIVE_SD if len(sets) == 1 else _MIN_RELATIVE_SD_SHARED
    found = []
    for place, tried_here in enumerate(sets):
        positions = [motion.traces[place].position for motion in model.motions]
        largest = int(np.argmax([np.ptp(position) for position in positions]))
        trials = []
        for some in tried_here:
            # Of sets with the same kind here, which differ elsewhere, that which predicts best.
            chosen = errors.best(each for each in power if each[place] == some[place])
            whole, rows = fits[chosen], [fit.numbers(place) for fit in without[chosen]]
            trials.append(
                KindTrial(
                    some[place],
                    whole.bristles(place),
                    whole.seen(place, largest),
                    jackknife_estimates(whole.numbers(place), rows, floor),
                    float(np.sqrt(power[chosen].sum() / friction)),
                    errors.behind(chosen, best),
                    float(np.abs(whole.x[whole.model.inertial]).max()),
                    whole.reach(place),
                )
            )
        found.append(KindChoice(tuple(trials), positions[largest]))
    return found


def _held_out(whole: GroupFit) -> tuple[list[GroupFit], Array]:
    """Return the fits to all motions but one, and what they miss in each spectral line of that one, shape (lines,)."""

    def squares(fit: GroupFit, index: int) -> Array:
        motion = whole.model.motions[index]
        lines = np.unique(motion.line, return_inverse=True)[1]
        left = fit.left_over(motion, whole.model.starts(whole.x)[index])
        return np.bincount(lines, np.sum(left**2, axis=1)).astype(np.float64)

    return leave_out(range(len(whole.model.motions)), whole.without, squares)


def jackknife_estimates(
    whole: Mapping[str, float], without: Sequence[Mapping[str, float]], floor: Mapping[str, float]
) -> dict[str, ParameterEstimate]:
    """Return what was fitted with the deviations of the jackknife: how far fits without one motion each lie apart.

    A variance of so few fits is itself uncertain: Student's distribution widens the deviations so that 1.96 of them
    hold 95 %. What is the same in all motions does not show in it: the floor, in parts of c0 and c1, is for that.
    """
    rows = np.array([list(fit.values()) for fit in without])
    student = stats.t.ppf(0.975, len(rows) - 1) / stats.norm.ppf(0.975)
    spread = student * np.sqrt((len(rows) - 1.0) * np.var(rows, axis=0))
    found = {}
    for (name, value), scatter in zip(whole.items(), spread.tolist(), strict=True):
        deviation = float(np.hypot(scatter, floor[name] * value if name in floor else _MIN_SD_OF_PARTS))
        found[name] = ParameterEstimate(value, deviation)
        if name in PRESLIDING and not deviation < LARGEST_DEVIATION * value:
            found[name] = ParameterEstimate.unknown(f"standard deviation {deviation:.2g} at a value of {value:.3g}")
        if name.endswith(ATTRACTION):
            found[name] = ParameterEstimate.unknown("it does not show in presliding")
    return found
