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
from functools import cached_property
from typing import Final

import numpy as np
from scipy import stats

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import counted, listed
from rx90_common.friction.held_out import HeldOutErrors, leave_out
from rx90_common.friction.parts.bristles import BristlesPart
from rx90_emulator.identification.model.estimates import LARGEST_DEVIATION, PRESLIDING, ParameterEstimate
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.presliding.bristle_motion import (
    ATTRACTION,
    FAMILIES,
    KindFamily,
    KindMotion,
    MovedGroup,
    joint_groups,
)
from rx90_emulator.identification.presliding.fit import PreslidingFit
from rx90_emulator.identification.presliding.group_fit import GroupFit, KindFit
from rx90_emulator.identification.records.record import BagSource

MIN_MOTIONS: Final = 3
"""Micro-motions of a joint, below which nothing is left to be predicted."""

MAX_ELEMENTS: Final = 3
"""Elements that are compared together; with each more, the sets of kinds are three times as many."""

DISTINGUISHABLE_SE: Final = 3.0
"""Standard errors by which a kind must predict worse than the best one to be told from it."""

_MIN_RELATIVE_SD = {"c0": 0.002, "c1": 0.01}  # relative: encoder steps, and 10 us of timing, show in no residual
_MIN_RELATIVE_SD_SHARED = {
    "c0": 0.02,
    "c1": 0.05,
}  # of elements that share joints: errors of others are alike in all motions
_MIN_SD_OF_PARTS = 0.02  # of numbers in parts: errors of the sliding regime are the same in all motions


@dataclass(frozen=True, eq=False)
class KindTrial:
    """What became of a kind of bristles.

    Attributes:
        fit: to all motions.
        seen: torque of the element along its largest motion, measured, with others' taken off by the fit, and fitted,
            block means, Nm, each shape (b,).
        estimates: of c0, c1 and the kind's own numbers; the deviations are those of the jackknife over the motions.
        missed: RMS of what it misses in motions that were not fitted, over the RMS of the friction torque.
        behind: by how many standard errors it predicts worse than the best kind; 0 for that.
    """

    fit: KindFit
    seen: tuple[Array, Array]
    estimates: dict[str, ParameterEstimate]
    missed: float
    behind: float

    @property
    def family(self) -> KindFamily:
        """Return the kind."""
        return self.fit.family

    @property
    def bristles(self) -> BristlesPart | None:
        """Return the bristles that fit all motions; None is LuGre's."""
        return self.fit.bristles

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


def least_motions(elements: int) -> int:
    """Return the micro-motions of joints with so many elements, below which their kinds are not compared."""
    return max(MIN_MOTIONS, 2 * elements)


def choose_kinds_of(
    motions: Sequence[KindMotion],
    c0: Array,
    families: Sequence[KindFamily] = FAMILIES,
    progress: Callable[[int, str], None] = lambda *_: None,
) -> list[KindChoice]:
    """Return which kinds of bristles the elements of a group of joints have.

    Args:
        motions: micro-motions of the group, `least_motions` of its e elements or more.
        c0: a first guess, Nm/rad, such as that of the fit with LuGre's bristles, shape (e,).
        families: what is tried.
        progress: called `steps_of(e, families)` times, with the place of an element and the name of a kind before the
            kind is tried.

    Raises:
        IdentificationError: for fewer motions.
    """
    if len(motions) < least_motions(len(c0)):
        raise IdentificationError(
            f"{len(motions)} micro-motions of {counted(len(c0), 'element')}; accepted: {least_motions(len(c0))} or more"
        )
    search = _Search(motions, c0, families, progress)
    predictions: dict[tuple[KindFamily, ...], _Prediction] = {}
    sets = []
    for place, family in itertools.product(range(len(c0)), families):
        progress(place, family.name)
        chosen = search.best_with(place, family)
        sets.append(chosen)
        if chosen not in predictions:
            predictions[chosen] = _Prediction.of(search.fit(chosen))
    return _choices(sets, predictions, len(families))


def steps_of(elements: int, families: Sequence[KindFamily]) -> int:
    """Return how often `choose_kinds_of` calls `progress`."""
    searched = len(_searched(families)) ** elements if 1 < elements <= MAX_ELEMENTS else 0
    return searched + elements * len(families)


def _searched(families: Sequence[KindFamily]) -> list[KindFamily]:
    """Return a family for each kind, that in the middle."""
    kinds: dict[str, list[KindFamily]] = {}
    for family in families:
        kinds.setdefault(family.kind, []).append(family)
    return [some[(len(some) - 1) // 2] for some in kinds.values()]


class _Search:
    """The fits of sets of kinds to all motions of a group, each made once."""

    def __init__(
        self,
        motions: Sequence[KindMotion],
        c0: Array,
        families: Sequence[KindFamily],
        progress: Callable[[int, str], None],
    ) -> None:
        self._motions, self._c0 = motions, c0
        self._fits: dict[tuple[KindFamily, ...], GroupFit] = {}
        self._middle = {family.kind: family for family in _searched(families)}
        if len(c0) > 1:
            for families_tried in itertools.product(self._middle.values(), repeat=len(c0)):
                progress(0, ", ".join(family.name for family in families_tried))
                self.fit(families_tried)

    def fit(self, families: tuple[KindFamily, ...]) -> GroupFit:
        """Return the fit of kinds of the elements."""
        if families not in self._fits:
            self._fits[families] = GroupFit.of(families, self._motions, self._c0)
        return self._fits[families]

    def best_with(self, place: int, family: KindFamily) -> tuple[KindFamily, ...]:
        """Return the set of kinds that fits best of those with a family at a place."""
        if len(self._c0) == 1:
            return (family,)
        own = self._middle[family.kind]
        searched = itertools.product(self._middle.values(), repeat=len(self._c0))
        best = min((some for some in searched if some[place] is own), key=lambda some: self._fits[some].cost)
        return (*best[:place], family, *best[place + 1 :])


@dataclass(frozen=True, eq=False)
class _Prediction:
    """What a set of kinds predicts of each motion from all others.

    Attributes:
        whole: the fit to all motions.
        without: the fits to all but one, motion by motion.
        power: what is missed in each spectral line of each motion, over that of the scale, shape (lines,).
    """

    whole: GroupFit
    without: tuple[GroupFit, ...]
    power: Array

    @classmethod
    def of(cls, whole: GroupFit) -> _Prediction:
        """Leave out one motion after the other."""

        def squares(fit: GroupFit, index: int) -> Array:
            motion = whole.model.motions[index]
            lines = np.unique(motion.line, return_inverse=True)[1]
            left = fit.left_over(motion, whole.starts_of(index))
            return np.bincount(lines, np.sum(left**2, axis=1))

        without, power = leave_out(range(len(whole.model.motions)), whole.without, squares)
        return cls(whole, tuple(without), power)

    def estimates(self, place: int) -> dict[str, ParameterEstimate]:
        """Return what was fitted of an element with the deviations of the jackknife over the motions."""
        floor = _MIN_RELATIVE_SD if len(self.whole.model.families) == 1 else _MIN_RELATIVE_SD_SHARED
        return jackknife_estimates(self.whole.element(place), [fit.element(place) for fit in self.without], floor)


def _choices(
    sets: Sequence[tuple[KindFamily, ...]], predictions: Mapping[tuple[KindFamily, ...], _Prediction], families: int
) -> list[KindChoice]:
    """Return the choice of each element; the sets are those for its families, element by element."""
    errors = HeldOutErrors({some: one.power for some, one in predictions.items()})
    best = errors.best()
    motions = predictions[best].whole.model.motions
    friction = sum(float(np.sum((motion.target / predictions[best].whole.model.scale) ** 2)) for motion in motions)
    found = []
    for place in range(len(best)):
        positions = [motion.traces[place].position for motion in motions]
        largest = int(np.argmax([np.ptp(position) for position in positions]))
        trials = []
        for some in sets[place * families : (place + 1) * families]:
            # Of sets with the same kind here, which differ elsewhere, that which predicts best.
            chosen = errors.best(each for each in predictions if each[place] == some[place])
            one = predictions[chosen]
            trials.append(
                KindTrial(
                    one.whole.element(place),
                    one.whole.seen(place, largest),
                    one.estimates(place),
                    float(np.sqrt(one.power.sum() / friction)),
                    errors.behind(chosen, best),
                )
            )
        found.append(KindChoice(tuple(trials), positions[largest]))
    return found


def jackknife_estimates(
    whole: KindFit, without: Sequence[KindFit], floor: Mapping[str, float]
) -> dict[str, ParameterEstimate]:
    """Return what was fitted with the deviations of the jackknife: how far fits without one motion each lie apart.

    A variance of so few fits is itself uncertain: Student's distribution widens the deviations so that 1.96 of them
    hold 95 %. What is the same in all motions does not show in it: the floor, in parts of c0 and c1, is for that.
    """
    values = whole.numbers()
    rows = np.array([list(fit.numbers().values()) for fit in without])
    student = stats.t.ppf(0.975, len(rows) - 1) / stats.norm.ppf(0.975)
    spread = student * np.sqrt((len(rows) - 1.0) * np.var(rows, axis=0))
    found = {
        name: ParameterEstimate(
            value, float(np.hypot(deviation, floor[name] * value if name in floor else _MIN_SD_OF_PARTS))
        )
        for (name, value), deviation in zip(values.items(), spread, strict=True)
    }
    for name in PRESLIDING:
        value, deviation = found[name].value, found[name].deviation
        if not deviation < LARGEST_DEVIATION * value:
            found[name] = ParameterEstimate.unknown(f"standard deviation {deviation:.2g} at a value of {value:.3g}")
    if whole.family.blocks:
        found[f"bristles.{ATTRACTION}"] = ParameterEstimate.unknown("it does not show in presliding")
    return found


_MAX_MISSED = 0.5  # of the friction torque, by the kind that predicts best, noise included
_MAX_INERTIA_ERROR = 0.1  # relative error of the joint's inertia
_MAX_REACH = 2.0  # of a block, in parts of the travel: there and back, a block with half of it slips


@dataclass(frozen=True, eq=False)
class ElementKind:
    """What is known of the kind of an element's bristles.

    Attributes:
        element: its name.
        reason: why no kind is told; "" where one is.
        choice: what was tried; None where nothing could be.
        moved: the micro-motions that were compared; None where there are none.
    """

    element: str
    reason: str
    choice: KindChoice | None = None
    moved: MovedGroup | None = None

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
        if self.choice is None or not self.decided or self.choice.best.bristles is None:
            return None
        return self.choice.best

    @property
    def bristles(self) -> BristlesPart | None:
        """Return the bristles that the element gets; None is LuGre's."""
        return None if self.trial is None else self.trial.bristles

    @property
    def sources(self) -> tuple[BagSource, ...]:
        """Return the bags that it rests on."""
        return () if self.moved is None else self.moved.sources

    @property
    def text(self) -> str:
        """Return the decision with how sure it is, or why there is none."""
        if self.choice is None or self.reason:
            return f"{self.decision}: {self.reason}"
        return f"{self.decision}, told from the others by {self.choice.margin:.1f} standard errors or more"

    @cached_property
    def largest(self) -> tuple[Array, dict[str, Array]]:
        """Return position, rad from the mean, and torque of the bristles, Nm, of the largest micro-motion compared.

        The torques are the measured one, that of the best kind and those of the best trial of each other kind, by name.
        """
        assert self.choice is not None
        return _compared(self.choice)


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
    for group in joint_groups(arm):
        names = [arm.element_names[e] for e in group.elements]
        found |= {kind.element: kind for kind in _of_group(names, groups.get(group.elements), progress)}
    return tuple(found[name] for name in arm.element_names)


def decisions(kinds: Iterable[ElementKind]) -> list[tuple[str, str]]:
    """Return what became of each element in words, elements of which the same is said together."""
    together: dict[str, list[str]] = {}
    for kind in kinds:
        together.setdefault(kind.text, []).append(kind.element)
    return [(", ".join(names), text) for text, names in together.items()]


def kind_steps(arm: RigidArm) -> int:
    """Return how many steps `choose_kinds` takes."""
    return sum(steps_of(len(group.elements), FAMILIES) for group in joint_groups(arm))


def _of_group(names: Sequence[str], moved: MovedGroup | None, progress: Callable[[str], None]) -> list[ElementKind]:
    least, count = least_motions(len(names)), 0 if moved is None else len(moved.motions)
    if moved is None or count < least or len(names) > MAX_ELEMENTS:
        for _ in range(steps_of(len(names), FAMILIES)):
            progress(f"{listed(names)}: bristles")
        reason = f"{count} micro-oscillations; {least} or more tell kinds apart"
        if len(names) > MAX_ELEMENTS:
            reason = f"{len(names)} elements share joints; accepted: {MAX_ELEMENTS} at most"
        return [ElementKind(name, reason) for name in names]
    choices = choose_kinds_of(
        moved.motions, moved.c0, FAMILIES, lambda place, kind: progress(f"{names[place]}: {kind}")
    )
    return [ElementKind(name, _doubt(one), one, moved) for name, one in zip(names, choices, strict=True)]


def _doubt(choice: KindChoice) -> str:
    """Return why no kind is told; "" if one is."""
    best = choice.best
    if best.missed > _MAX_MISSED:
        return f"even the best kind, {best.family.name}, misses {100.0 * best.missed:.0f} % of the friction torque"
    if choice.kind is None:
        return f"the data do not tell {listed([trial.family.name for trial in choice.possible])} apart"
    if abs(best.fit.inertia) > _MAX_INERTIA_ERROR:
        error = 100.0 * abs(best.fit.inertia)
        return f"the joint's inertia would be {error:.0f} % off the description's: a payload or a rotor may be missing"
    travel = float(np.ptp(choice.position))
    if best.fit.reach > _MAX_REACH * travel:
        return (
            f"Maxwell slip predicts best, but a block would slip only after {1e3 * best.fit.reach:.2g} mrad, and the "
            f"micro-oscillations went through {1e3 * travel:.2g} mrad"
        )
    return ""


def _compared(choice: KindChoice) -> tuple[Array, dict[str, Array]]:
    shown: dict[str, KindTrial] = {}
    for trial in sorted(choice.trials, key=lambda trial: trial.behind):
        shown.setdefault(trial.family.kind, trial)
    torques = {"measured": choice.best.seen[0]}
    torques |= {trial.family.name: trial.seen[1] for trial in shown.values()}
    position = choice.position
    return position - position.mean(), {name: torque - torque.mean() for name, torque in torques.items()}
