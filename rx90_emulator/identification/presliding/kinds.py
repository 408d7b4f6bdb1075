"""Select the kind of an element's bristles by cross-validation over its micro-motions, where the data suffice.

Each kind is fitted to all micro-motions but one, which it then predicts, in turn. The residual of the predicted
motions, line by line of the spectrum, is the measure of the prediction.

A kind is ruled out if the logarithm of its residual power in a line, noise included, exceeds that of the best kind by
more than three standard errors, in the mean over the lines. If every other kind is ruled out, the best one is the
element's; else the data cannot decide.

Elements that share joints are compared together, because only sums of their torques are measured: all sets of kinds are
fitted to all motions, and for each kind of each element the set that fits best is cross-validated. So a kind of an
element is selected only if its other kinds predict worse with any kinds of its neighbours.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy import stats
from scipy.optimize import least_squares

from rx90_common.base.arrays import Array
from rx90_common.base.quoting import listed
from rx90_common.friction.held_out import HeldOutErrors, leave_out
from rx90_common.friction.parts.bristles import BristlesPart, MaxwellSlip
from rx90_emulator.identification.arm import RigidArm, joint_groups
from rx90_emulator.identification.estimates import LARGEST_DEVIATION, PRESLIDING, ParameterEstimate
from rx90_emulator.identification.presliding.bristle_motion import (
    ATTRACTION,
    FAMILIES,
    GroupModel,
    KindFamily,
    KindMotion,
)
from rx90_emulator.identification.presliding.fit import PreslidingFit
from rx90_emulator.identification.records import BagSource

MIN_MOTIONS: Final = 3
"""Least number of micro-motions of a joint for a prediction."""
MAX_ELEMENTS: Final = 3
"""Largest number of elements that are compared together; each further one triples the sets of kinds."""
DISTINGUISHABLE_SE: Final = 3.0
"""Standard errors by which a kind must predict worse than the best one to be ruled out."""
_MIN_RELATIVE_SD = {"c0": 0.002, "c1": 0.01}  # residuals do not show encoder steps, nor errors of 10 us in time
_MIN_RELATIVE_SD_SHARED = {"c0": 0.02, "c1": 0.05}  # for elements that share joints: others' errors are the same in all
_MIN_SD_OF_PARTS = 0.02  # of shares: errors of the sliding regime are the same in all motions
_MAX_RESIDUAL_SHARE = 0.5  # of the friction torque, by the kind that predicts best, noise included
_MAX_INERTIA_ERROR = 0.1  # relative error of the joint's inertia
_MAX_REACH = 2.0  # of a block, over the travel: on the way back a block with half of it slips
_STARTS = (-0.8, -0.4, 0.0, 0.4, 0.8)  # start deflections of fits, over those of steady sliding
_DAMPING_RATIO_S = 1e-3  # s, c1 over c0 at the start of a fit
_MAX_EVALUATIONS, _MAX_REFINEMENTS = 15, 6  # of the residuals, without Jacobian: from a guess, and from a near solution
_SHARED_EFFORT = 0.6  # factor on them where elements share joints: a fit takes long, and there are many
_TOLERANCE = 1e-4  # relative, of the parameters and of the residual power


@dataclass(frozen=True, eq=False)
class GroupFit:
    """Bristles of given kinds of all e elements of a group, fitted to its motions by Levenberg-Marquardt.

    Attributes:
        model: the kinds, and the motions.
        x: its parameters.
        cost: residual power, the prior's included, over that of the scale.
    """

    model: GroupModel
    x: Array
    cost: float

    @classmethod
    def of(cls, families: Sequence[KindFamily], motions: Sequence[KindMotion], c0: Array) -> GroupFit:
        """Fit kinds of the elements to a group's motions from the kinds' guesses and a c0, Nm/rad, shape (e,)."""
        scale = np.median(np.abs(np.concatenate([motion.target for motion in motions])), axis=0) + 1e-12
        model = GroupModel(tuple(families), tuple(motions), scale, _DAMPING_RATIO_S * c0)
        every = [family.guesses() for family in families]
        if len(families) > 1:  # for elements that share joints only each kind's middle guess: there are enough fits
            every = [[np.mean(guesses, axis=0)] for guesses in every]
        place, found = model.inertial, []
        rest = np.zeros(place.stop - place.start + len(motions) * len(families))
        for shapes in itertools.product(*every):
            own = [np.concatenate([[np.log(c), 1.0], shape]) for c, shape in zip(c0, shapes, strict=True)]
            x = np.concatenate([*own, rest])
            # The best of a few start deflections, one element after the other.
            for index, column in itertools.product(range(len(motions)), range(len(families))):
                own_start = np.arange(x.size) == place.stop + index * len(families) + column
                tried = [np.where(own_start, start, x) for start in _STARTS]
                x = tried[int(np.argmin([np.sum(model.of_motion(each, index) ** 2) for each in tried]))]
            found.append(cls._solved(model, x, _MAX_EVALUATIONS))
        return min(found, key=lambda fit: fit.cost)

    @classmethod
    def _solved(cls, model: GroupModel, x: Array, most: int) -> GroupFit:
        effort = 1.0 if len(model.families) == 1 else _SHARED_EFFORT
        result = model.minimised(x, round(effort * most), _TOLERANCE, _TOLERANCE)
        return cls(model, result.x, 2.0 * float(result.cost))

    def without(self, index: int) -> GroupFit:
        """Return the fit to all motions but one."""
        motions, place = self.model.motions, self.model.inertial.stop
        starts = np.delete(self.model.starts(self.x), index, axis=0)
        model = replace(self.model, motions=(*motions[:index], *motions[index + 1 :]))
        return self._solved(model, np.concatenate([self.x[:place], starts.ravel()]), _MAX_REFINEMENTS)

    def left_over(self, motion: KindMotion, starts: Array) -> Array:
        """Return the residual spectrum of another motion in units of the scale, shape (r, k).

        The start deflections are fitted to it, from `starts`, shape (e,), on.
        """
        model, fixed = replace(self.model, motions=(motion,)), self.x[: self.model.inertial.stop]

        def residual(x: Array) -> Array:
            return model.residual(np.concatenate([fixed, x]))

        def slopes(x: Array) -> Array:
            return model.jacobian(np.concatenate([fixed, x]))[:, len(fixed) :]

        guesses = [starts, *(np.full(len(starts), each) for each in _STARTS)]
        first = guesses[int(np.argmin([np.sum(residual(x) ** 2) for x in guesses]))]
        best = least_squares(residual, first, slopes, method="lm", max_nfev=_MAX_EVALUATIONS, xtol=_TOLERANCE).x
        return model.of_motion(np.concatenate([fixed, best]), 0)

    def bristles(self, place: int) -> BristlesPart | None:
        """Return the bristles of the element with index `place` in the group; None for LuGre's."""
        return self.model.kind(self.x[self.model.places[place]], place)

    def numbers(self, place: int) -> dict[str, float]:
        """Return the fitted values of an element by their names: c0, Nm/rad, c1, Nm s/rad, bristles.share[0]."""
        c0, c1 = self.model.values(self.x)[place].tolist()
        part = self.bristles(place)
        own = {} if part is None else {f"bristles.{name}": value for name, value in part.numbers().items()}
        return {"c0": c0, "c1": c1, **own}

    def reach(self, place: int) -> float:
        """Return the largest deflection at which a block of an element slips, rad; 0 without blocks."""
        part = self.bristles(place)
        if not isinstance(part, MaxwellSlip):
            return 0.0
        coulomb = self.model.motions[0].traces[place].element.tau_c_positive
        return float(np.max(np.divide(part.share, part.stiffness))) * coulomb / self.numbers(place)["c0"]

    def friction_torques(self, place: int, index: int) -> tuple[Array, Array]:
        """Return an element's torque along a motion, measured less all others' and fitted, Nm, each (b,)."""
        motion = self.model.motions[index]
        remaining = motion.measured @ np.concatenate([[1.0], -self.x[self.model.inertial]])
        torques = [self.model.torque(self.x, index, n)[:, 0] for n in range(len(motion.traces))]
        for n, torque in enumerate(torques):
            if n != place:
                remaining = remaining - np.outer(torque, motion.inputs[n])
        row = motion.inputs[place]
        return np.asarray(remaining @ row / (row @ row)), torques[place]


@dataclass(frozen=True, eq=False)
class KindTrial:
    """The trial of a kind of bristles.

    Attributes:
        family: the kind.
        bristles: fitted to all motions; None for LuGre's.
        friction_torques: of the element along its largest motion, measured less the others' fitted ones, and fitted,
            block means, Nm, each shape (b,).
        estimates: of c0, c1 and the kind's own numbers; the deviations are those of the jackknife over the motions.
        missed: RMS residual in predicted motions over the RMS of the friction torque.
        behind: standard errors by which it predicts worse than the best kind; 0 for that one.
        inertia: largest relative error of the joints' inertia.
        reach: largest deflection at which a block slips, rad; 0 without blocks.
    """

    family: KindFamily
    bristles: BristlesPart | None
    friction_torques: tuple[Array, Array]
    estimates: dict[str, ParameterEstimate]
    missed: float
    behind: float
    inertia: float = 0.0
    reach: float = 0.0

    @property
    def distinguishable(self) -> bool:
        """Return whether the data rule it out against the best kind."""
        return self.behind > DISTINGUISHABLE_SE


@dataclass(frozen=True, eq=False)
class ElementKind:
    """The kinds of bristles that were tried for an element, and the decision.

    Attributes:
        element: its name.
        trials: by kind, in the order of the families that were tried; empty if nothing could be compared.
        position: along the element's largest motion, rad, block means, shape (b,).
        lacking: why nothing could be compared; "" otherwise.
        sources: the bags that were used.
    """

    element: str
    trials: tuple[KindTrial, ...] = ()
    position: Array = field(default_factory=lambda: np.zeros(0))
    lacking: str = ""
    sources: tuple[BagSource, ...] = ()

    @property
    def best(self) -> KindTrial:
        """Return the trial that predicts best."""
        return min(self.trials, key=lambda trial: trial.behind)

    @property
    def possible(self) -> tuple[KindTrial, ...]:
        """Return the trials that the data do not rule out, the best one included."""
        return tuple(trial for trial in self.trials if not trial.distinguishable)

    @property
    def kind(self) -> str | None:
        """Return "LuGre", "elasto-plastic" or "Maxwell slip"; None if the data cannot decide."""
        kinds = {trial.family.kind for trial in self.possible}
        return kinds.pop() if len(kinds) == 1 else None

    @property
    def margin(self) -> float:
        """Return the standard errors between the best trial and the best one of another kind."""
        others = [trial.behind for trial in self.trials if trial.family.kind != self.best.family.kind]
        return min(others, default=0.0)

    @property
    def reason(self) -> str:
        """Return why no kind was selected; "" if one was."""
        if not self.trials:
            return self.lacking
        best, travel = self.best, float(np.ptp(self.position))
        if best.missed > _MAX_RESIDUAL_SHARE:
            return f"even the best kind, {best.family.name}, misses {100.0 * best.missed:.0f} % of the friction torque"
        if self.kind is None:
            return f"the data do not distinguish {listed([trial.family.name for trial in self.possible])}"
        if best.inertia > _MAX_INERTIA_ERROR:
            error = f"{100.0 * best.inertia:.0f} % off the description's"
            return f"the joint's inertia would be {error}: a payload or a rotor may be missing"
        if best.reach > _MAX_REACH * travel:
            return (
                f"Maxwell slip predicts best, but a block would slip only after {1e3 * best.reach:.2g} mrad, and "
                f"the micro-oscillations went through {1e3 * travel:.2g} mrad"
            )
        return ""

    @property
    def decided(self) -> bool:
        """Return whether the data decide, for LuGre or another kind."""
        return bool(self.trials) and not self.reason

    @property
    def decision(self) -> str:
        """Return "LuGre", "elasto-plastic", "Maxwell slip", "cannot tell", or "not compared"."""
        if not self.trials:
            return "not compared"
        return self.best.family.kind if self.decided else "cannot tell"

    @property
    def trial(self) -> KindTrial | None:
        """Return the trial whose bristles replace LuGre's; None if LuGre's stay."""
        return self.best if self.decided and self.best.bristles is not None else None

    @property
    def text(self) -> str:
        """Return the decision with its margin, or why there is none."""
        if self.reason:
            return f"{self.decision}: {self.reason}"
        return f"{self.decision}, better than the others by {self.margin:.1f} standard errors or more"

    @property
    def largest(self) -> tuple[Array, dict[str, Array]]:
        """Return position, rad from the mean, and torque of the bristles, Nm, of the largest micro-motion compared.

        The torques are the measured one, that of the best kind and those of the best trial of each other kind, by name.
        """
        shown: dict[str, KindTrial] = {}
        for trial in sorted(self.trials, key=lambda trial: trial.behind):
            shown.setdefault(trial.family.kind, trial)
        torques = {"measured": self.best.friction_torques[0]} | {
            one.family.name: one.friction_torques[1] for one in shown.values()
        }
        return self.position - self.position.mean(), {name: each - each.mean() for name, each in torques.items()}


def choose_kinds(
    fit: PreslidingFit, arm: RigidArm, progress: Callable[[str], None] = lambda _: None
) -> tuple[ElementKind, ...]:
    """Return the kind of bristles of each element, in the arm's order.

    Args:
        fit: with LuGre's bristles, of the arm.
        arm: whose elements these are.
        progress: called `kind_steps(arm)` times, with the name of the next step.
    """
    groups = {moved.elements: moved for moved in fit.groups}
    found: dict[int, ElementKind] = {}
    for elements in (group.elements for group in joint_groups(arm)):
        names, moved = [arm.element_names[e] for e in elements], groups.get(elements)
        least, count = max(MIN_MOTIONS, 2 * len(names)), 0 if moved is None else len(moved.motions)
        if moved is not None and count >= least and len(names) <= MAX_ELEMENTS:
            compared = choose_kinds_of(moved.motions, moved.c0, names, FAMILIES, progress)
            found |= {e: replace(one, sources=moved.sources) for e, one in zip(elements, compared, strict=True)}
            continue
        for _ in range(steps_of(len(names), FAMILIES)):
            progress(f"{listed(names)}: bristles")
        reason = f"{count} micro-oscillations; {least} or more tell kinds apart"
        if len(names) > MAX_ELEMENTS:
            reason = f"{len(names)} elements share joints; accepted: {MAX_ELEMENTS} at most"
        found |= {e: ElementKind(name, lacking=reason) for e, name in zip(elements, names, strict=True)}
    return tuple(found[e] for e in sorted(found))


def kind_steps(arm: RigidArm) -> int:
    """Return how many steps `choose_kinds` takes."""
    return sum(steps_of(len(group.elements), FAMILIES) for group in joint_groups(arm))


def steps_of(elements: int, families: Sequence[KindFamily]) -> int:
    """Return how often `choose_kinds_of` calls `progress`."""
    searched = len(_middle(families)) ** elements if 1 < elements <= MAX_ELEMENTS else 0
    return searched + elements * len(families)


def _middle(families: Sequence[KindFamily]) -> dict[str, KindFamily]:
    """Return the middle family of each kind."""
    kinds = itertools.groupby(families, key=lambda family: family.kind)
    return {kind: some[(len(some) - 1) // 2] for kind, some in ((kind, list(some)) for kind, some in kinds)}


def choose_kinds_of(
    motions: Sequence[KindMotion],
    c0: Array,
    names: Sequence[str],
    families: Sequence[KindFamily] = FAMILIES,
    progress: Callable[[str], None] = lambda _: None,
) -> list[ElementKind]:
    """Return the selected kinds of bristles of the elements of a group of joints.

    Args:
        motions: micro-motions of the group of e elements, 2 e or more, and at least MIN_MOTIONS.
        c0: a first guess, Nm/rad, such as that of the fit with LuGre's bristles, shape (e,).
        names: of the elements.
        families: kinds to try, those of one kind one after the other.
        progress: called `steps_of(e, families)` times, with the names of an element and of a kind before the trial of
            the kind.
    """
    places, middle = range(len(c0)), _middle(families)
    fits: dict[tuple[KindFamily, ...], GroupFit] = {}
    if len(c0) > 1:
        for tried in itertools.product(middle.values(), repeat=len(c0)):
            progress(f"{names[0]}: {', '.join(family.name for family in tried)}")
            fits[tried] = GroupFit.of(tried, motions, c0)
    searched = list(fits)
    without: dict[tuple[KindFamily, ...], list[GroupFit]] = {}
    power: dict[tuple[KindFamily, ...], Array] = {}
    for place, family in itertools.product(places, families):
        progress(f"{names[place]}: {family.name}")
        own = middle[family.kind]
        # The best-fitting set among those with the family at this index.
        best = min((some for some in searched if some[place] is own), key=lambda some: fits[some].cost, default=(own,))
        chosen = (*best[:place], family, *best[place + 1 :])
        if chosen not in power:
            whole = fits[chosen] = fits.get(chosen) or GroupFit.of(chosen, motions, c0)
            starts = whole.model.starts(whole.x)

            def squares(fit: GroupFit, index: int, starts: Array = starts) -> Array:
                """Return a fit's squared residual in each spectral line of a motion, shape (lines,)."""
                lines = np.unique(motions[index].line, return_inverse=True)[1]
                residual = fit.left_over(motions[index], starts[index])
                return np.bincount(lines, np.sum(residual**2, axis=1)).astype(np.float64)

            without[chosen], power[chosen] = leave_out(range(len(motions)), whole.without, squares)
    errors = HeldOutErrors(power)
    best = errors.best()
    model = fits[best].model
    friction = sum(float(np.sum((motion.target / model.scale) ** 2)) for motion in model.motions)
    floor, found = _MIN_RELATIVE_SD if len(c0) == 1 else _MIN_RELATIVE_SD_SHARED, []
    for place in places:
        positions = [motion.traces[place].position for motion in model.motions]
        largest = int(np.argmax([np.ptp(position) for position in positions]))
        trials = []
        for family in families:
            # The best-predicting set among those with this kind here and different kinds elsewhere.
            chosen = errors.best(each for each in power if each[place] == family)
            whole, rows = fits[chosen], [fit.numbers(place) for fit in without[chosen]]
            trials.append(
                KindTrial(
                    family,
                    whole.bristles(place),
                    whole.friction_torques(place, largest),
                    jackknife_estimates(whole.numbers(place), rows, floor),
                    float(np.sqrt(power[chosen].sum() / friction)),
                    errors.behind(chosen, best),
                    float(np.abs(whole.x[whole.model.inertial]).max()),
                    whole.reach(place),
                )
            )
        found.append(ElementKind(names[place], tuple(trials), positions[largest]))
    return found


def jackknife_estimates(
    whole: Mapping[str, float], without: Sequence[Mapping[str, float]], floor: Mapping[str, float]
) -> dict[str, ParameterEstimate]:
    """Return the fitted values with the deviations of the jackknife: the scatter of fits without one motion each.

    A variance of so few fits is itself uncertain: Student's distribution widens the deviations so that 1.96 of them
    cover 95 %. Errors that are the same in all motions do not show: the floor, in units of c0 and c1, accounts for
    them.
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
