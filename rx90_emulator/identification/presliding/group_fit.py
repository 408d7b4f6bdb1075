"""Fit bristles of given kinds to micro-motions of the joints that share their elements.

All numbers of all elements are found together by least squares (Levenberg-Marquardt), with errors of the joints'
inertia and a start deflection of each element in each motion. All micro-oscillations are made at one pose, so whatever
the description of the links lacks is a constant error of the mass matrix.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from rx90_common.base.arrays import Array
from rx90_common.friction.parts.bristles import BristlesPart, MaxwellSlip
from rx90_emulator.identification.presliding.bristle_motion import KindFamily, KindMotion

INERTIA_SD = 0.05
"""Prior standard deviation of the errors of the mass matrix in parts of sqrt(M_jj M_ii)."""
_START_SD, _MAX_START = 1.0, 1.2  # of a start deflection over that of steady sliding: prior deviation, and at most
_STARTS = (-0.8, -0.4, 0.0, 0.4, 0.8)
_DAMPING_RATIO_S = 1e-3  # s, c1 over c0 where a fit begins
_MAX_EVALUATIONS, _MAX_REFINEMENTS = 15, 6  # of the residuals, Jacobian apart: from a guess, and from a solution nearby
_SHARED_EFFORT = 0.6  # of them, where elements share joints: a fit is long, and there are many
_TOLERANCE = 1e-4  # relative, of the parameters and of the residual power
_PARAMETER_STEP = 1e-4  # step of difference quotients, of parameters of the order of 1


@dataclass(frozen=True, eq=False)
class GroupModel:
    """What bristles of given kinds of the e elements of a group leave over of M motions, as a function of parameters x.

    x holds ln c0, the damping, and the kind's own numbers, element by element; then the errors of the inertia, in parts
    of sqrt(M_jj M_ii); then the start deflections in parts of those of steady sliding, motion by motion.

    Attributes:
        families: of the elements.
        motions: M of them.
        scale: torque to which residuals are compared, Nm, shape (k,).
        unit: of c1 among the parameters, Nm s/rad, shape (e,); None where ln c1 stands there.
        start_sd: prior standard deviation of a start deflection over that of steady sliding.
        max_start: of it, at most.
    """

    families: tuple[KindFamily, ...]
    motions: tuple[KindMotion, ...]
    scale: Array
    unit: Array | None = None
    start_sd: float = _START_SD
    max_start: float = _MAX_START

    @cached_property
    def places(self) -> list[slice]:
        """Return where the parameters of each element stand."""
        ends = np.cumsum([0, *(2 + family.count for family in self.families)]).tolist()
        return [slice(a, b) for a, b in itertools.pairwise(ends)]

    @property
    def inertial(self) -> slice:
        """Return where the errors of the inertia stand: behind the elements', before the start deflections."""
        first = self.places[-1].stop
        return slice(first, first + int(self.motions[0].inertial.shape[2]))

    def starts(self, x: Array) -> Array:
        """Return the start deflections of the motions, in parts of those of steady sliding, shape (M, e)."""
        return x[self.inertial.stop :].reshape(-1, len(self.families))

    def values(self, x: Array) -> Array:
        """Return c0, Nm/rad, and c1, Nm s/rad, shape (e, 2)."""
        return np.array([(_exp(x[place][0]), self._c1(x[place], n)) for n, place in enumerate(self.places)])

    def of_motion(self, x: Array, index: int) -> Array:
        """Return the residual spectrum of a motion in parts of the scale, shape (r, k)."""
        motion = self.motions[index]
        left = motion.target - motion.inertial @ x[self.inertial]
        for n, (place, start) in enumerate(zip(self.places, self.starts(x)[index], strict=True)):
            torque = self._spectra(x[place], n, index, start) @ (1.0, self._c1(x[place], n))
            left = left - np.outer(torque, motion.inputs[n])
        return np.asarray(left / self.scale)

    def of_all(self, x: Array) -> Array:
        """Return the residual spectra of all motions in parts of the scale, shape (sum of r, k)."""
        return np.vstack([self.of_motion(x, index) for index in range(len(self.motions))])

    def residual(self, x: Array) -> Array:
        """Return the residuals of all motions, then those of the prior."""
        return np.concatenate([self.of_all(x).ravel(), x[self.inertial.start :] / self._prior_sd(x)])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of `residual`."""
        rows = [-(self._slopes(x, i) / self.scale[:, None]).reshape(-1, x.size) for i in range(len(self.motions))]
        prior_sd = self._prior_sd(x)
        return np.vstack([*rows, np.eye(len(prior_sd), x.size, self.inertial.start) / prior_sd[:, None]])

    def minimised(self, x: Array, most: int, xtol: float, ftol: float) -> OptimizeResult:
        """Return the least squares that begin at such parameters, with so many evaluations of the residuals at most."""
        return least_squares(self.residual, x, self.jacobian, method="lm", max_nfev=most, xtol=xtol, ftol=ftol)

    def torque(self, x: Array, index: int, n: int) -> Array:
        """Return block means of the torque, Nm, and of its part that c0 gives, of the bristles of element n; (b, 2)."""
        own, trace = x[self.places[n]], self.motions[index].traces[n]
        both = trace.bristles(self.kind(own, n), _exp(own[0]), self._clipped(self.starts(x)[index, n]))
        return np.column_stack([both @ (1.0, self._c1(own, n)), both[:, 0]])

    def friction(self, x: Array, index: int) -> Array:
        """Return block means of the friction torque at the joints along a motion, Nm, shape (b, k)."""
        motion = self.motions[index]
        total = [self.torque(x, index, n)[:, 0] + trace.viscous for n, trace in enumerate(motion.traces)]
        return np.column_stack(total) @ motion.inputs

    def _prior_sd(self, x: Array) -> Array:
        place = self.inertial
        return np.repeat([INERTIA_SD, self.start_sd], [place.stop - place.start, x.size - place.stop])

    def kind(self, own: Array, n: int) -> BristlesPart | None:
        """Return the bristles of element n by its parameters; None is LuGre's."""
        return self.families[n].bristles(own[2:], self.motions[0].traces[n].element.tau_c_positive)

    def _c1(self, own: Array, n: int) -> float:
        return _exp(own[1]) if self.unit is None else float(own[1] * self.unit[n])

    def _clipped(self, start: float) -> float:
        return float(np.clip(start, -self.max_start, self.max_start))

    def _spectra(self, own: Array, n: int, index: int, start: float) -> Array:
        trace = self.motions[index].traces[n]
        return trace.spectra(self.kind(own, n), _exp(own[0]), self._clipped(start))

    def _slopes(self, x: Array, index: int) -> Array:
        """Return the derivatives of a motion's torques by the parameters, Nm, shape (r, k, parameters)."""
        motion, found = self.motions[index], np.zeros((*self.motions[index].target.shape, x.size))
        stiffer = np.log1p(_PARAMETER_STEP) if self.unit is None else _PARAMETER_STEP
        for n, (place, start) in enumerate(zip(self.places, self.starts(x)[index], strict=True)):
            own = x[place]
            c1, row, here = self._c1(own, n), motion.inputs[n], self._spectra(own, n, index, start)
            steps = np.diag(np.r_[stiffer, 0.0, np.full(own.size - 2, _PARAMETER_STEP)])
            changed = [(own + step, start) for k, step in enumerate(steps) if k != 1]
            by_stiffness, *by_shape, by_start = (
                (self._spectra(each, n, index, at) - here) @ (1.0, c1) / _PARAMETER_STEP
                for each, at in [*changed, (own, start + _PARAMETER_STEP)]
            )
            by_damping = here[:, 1] * (c1 if self.unit is None else self.unit[n])
            found[:, :, place] = np.column_stack([by_stiffness, by_damping, *by_shape])[:, None, :] * row[:, None]
            found[:, :, self.inertial.stop + index * len(self.families) + n] = np.outer(by_start, row)
        found[:, :, self.inertial] = motion.inertial
        return found


def _exp(logarithm: float) -> float:
    return float(np.exp(np.clip(logarithm, -20.0, 25.0)))


@dataclass(frozen=True, eq=False)
class GroupFit:
    """Bristles of given kinds of all e elements of a group, fitted to its motions.

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
        """Fit kinds to motions from the kinds' guesses, of which the best fit counts.

        Args:
            families: of the elements.
            motions: of one group.
            c0: where the fit begins, Nm/rad, shape (e,).
        """
        scale = np.median(np.abs(np.concatenate([motion.target for motion in motions])), axis=0) + 1e-12
        model = GroupModel(tuple(families), tuple(motions), scale, _DAMPING_RATIO_S * c0)
        every = [family.guesses() for family in families]
        if len(families) > 1:  # of elements that share joints each kind's guess in the middle: there are enough fits
            every = [[np.mean(guesses, axis=0)] for guesses in every]
        place = model.inertial
        rest, found = np.zeros(place.stop - place.start + len(motions) * len(families)), []
        for shapes in itertools.product(*every):
            own = [np.concatenate([[np.log(c), 1.0], shape]) for c, shape in zip(c0, shapes, strict=True)]
            x = np.concatenate([*own, rest])
            # Start deflections that fit best of a few, one element after the other.
            for index, n in itertools.product(range(len(motions)), range(len(families))):
                column = np.arange(x.size) == place.stop + index * len(families) + n
                tried = [np.where(column, start, x) for start in _STARTS]
                x = min(tried, key=lambda each: float(np.sum(model.of_motion(each, index) ** 2)))
            found.append(cls._solved(model, x, _MAX_EVALUATIONS))
        return min(found, key=lambda fit: fit.cost)

    @classmethod
    def _solved(cls, model: GroupModel, x: Array, most: int) -> GroupFit:
        effort = 1.0 if len(model.families) == 1 else _SHARED_EFFORT
        result = model.minimised(x, round(effort * most), _TOLERANCE, _TOLERANCE)
        return cls(model, result.x, 2.0 * float(result.cost))

    def without(self, index: int) -> GroupFit:
        """Return the fit to all motions but one."""
        starts = np.delete(self.model.starts(self.x), index, axis=0)
        model = replace(self.model, motions=(*self.model.motions[:index], *self.model.motions[index + 1 :]))
        shared = self.x[: self.model.inertial.stop]
        return self._solved(model, np.concatenate([shared, starts.ravel()]), _MAX_REFINEMENTS)

    def left_over(self, motion: KindMotion, starts: Array) -> Array:
        """Return the residual spectrum of another motion from the start deflections that fit it best.

        Args:
            motion: of the group.
            starts: where the search for them begins, shape (e,).

        Returns:
            Torques in parts of the scale, shape (r, k).
        """
        model, shared = replace(self.model, motions=(motion,)), self.model.inertial.stop
        fixed = self.x[:shared]

        def residual(x: Array) -> Array:
            return model.residual(np.concatenate([fixed, x]))

        def slopes(x: Array) -> Array:
            return model.jacobian(np.concatenate([fixed, x]))[:, shared:]

        guesses = [starts, *(np.full(len(starts), each) for each in _STARTS)]
        first = min(guesses, key=lambda x: float(np.sum(residual(x) ** 2)))
        best = least_squares(residual, first, slopes, method="lm", max_nfev=_MAX_EVALUATIONS, xtol=_TOLERANCE).x
        return model.of_motion(np.concatenate([fixed, best]), 0)

    def bristles(self, place: int) -> BristlesPart | None:
        """Return the bristles of the element at a place in the group; None is LuGre's."""
        return self.model.kind(self.x[self.model.places[place]], place)

    def numbers(self, place: int) -> dict[str, float]:
        """Return what was fitted of an element by its names: c0, Nm/rad, c1, Nm s/rad, bristles.share[0]."""
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

    def seen(self, place: int, index: int) -> tuple[Array, Array]:
        """Return the torque of an element along a motion, the measured one less all others', and its own, Nm.

        Both are block means, shape (b,).
        """
        motion = self.model.motions[index]
        left = motion.measured @ np.concatenate([[1.0], -self.x[self.model.inertial]])
        torques = [self.model.torque(self.x, index, n)[:, 0] for n in range(len(motion.traces))]
        for n, torque in enumerate(torques):
            if n != place:
                left = left - np.outer(torque, motion.inputs[n])
        row = motion.inputs[place]
        return np.asarray(left @ row / (row @ row)), torques[place]
