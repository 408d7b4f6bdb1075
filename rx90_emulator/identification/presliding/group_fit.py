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
from typing import NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from rx90_common.base.arrays import Array
from rx90_common.friction.parts.bristles import BristlesPart, MaxwellSlip
from rx90_emulator.identification.presliding.bristle_motion import ATTRACTION, KindFamily, KindMotion

INERTIA_SD = 0.05
"""Prior standard deviation of the errors of the mass matrix in parts of sqrt(M_jj M_ii)."""
_START_SD = 1.0  # prior standard deviation of a start deflection over that of steady sliding
_MAX_START = 1.2  # of it
_STARTS = (-0.8, -0.4, 0.0, 0.4, 0.8)
_DAMPING_RATIO_S = 1e-3  # s, c1 over c0 where a fit begins
_MAX_EVALUATIONS, _MAX_REFINEMENTS = 15, 6  # of the residuals, Jacobian apart: from a guess, and from a solution nearby
_SHARED_EFFORT = 0.6  # of them, where elements share joints: a fit is long, and there are many
_TOLERANCE = 1e-4  # relative, of the parameters and of the residual power
_PARAMETER_STEP = 1e-4  # step of difference quotients, of parameters of the order of 1


@dataclass(frozen=True, eq=False)
class KindFit:
    """Bristles of a kind of one element, fitted to some motions.

    Attributes:
        family: the kind.
        c0: Nm/rad.
        shape: the numbers of the kind's own, as `KindFamily.bristles` takes them.
        c1: Nm s/rad.
        inertia: largest relative error of the joints' inertia.
        coulomb: Coulomb torque of the element, Nm.
    """

    family: KindFamily
    c0: float
    shape: Array
    c1: float
    inertia: float
    coulomb: float

    @property
    def bristles(self) -> BristlesPart | None:
        """Return the bristles; None is LuGre's."""
        return self.family.bristles(self.shape, self.coulomb)

    @property
    def reach(self) -> float:
        """Return the largest deflection at which a block slips, rad; 0 without blocks."""
        part = self.bristles
        if not isinstance(part, MaxwellSlip):
            return 0.0
        return float(np.max(np.divide(part.share, part.stiffness))) * self.coulomb / self.c0

    def numbers(self) -> dict[str, float]:
        """Return what was fitted by its names: c0, c1, bristles.share[0]; what only goes with it is left out."""
        part = self.bristles
        own = {} if part is None else {f"bristles.{name}": value for name, value in part.numbers().items()}
        own.pop(f"bristles.{ATTRACTION}", None)
        return {"c0": self.c0, "c1": self.c1, **own}


class _One(NamedTuple):
    """The numbers of one element: ln c0, the damping, and the kind's own."""

    stiffness: float
    damping: float
    shape: Array


@dataclass(frozen=True)
class _Layout:
    """What stands where in the parameters of a fit.

    First ln c0, the damping, and the kind's own numbers, element by element; then the errors of the inertia, in parts
    of sqrt(M_jj M_ii); then the start deflections in parts of those of steady sliding, motion by motion.

    Attributes:
        families: e of them.
        pairs: errors of the inertia.
    """

    families: tuple[KindFamily, ...]
    pairs: int

    @cached_property
    def sizes(self) -> list[int]:
        """Return how many belong to each element."""
        return [2 + family.count for family in self.families]

    @property
    def bristles(self) -> int:
        """Return how many are the elements'; they come first."""
        return sum(self.sizes)

    @property
    def shared(self) -> int:
        """Return how many belong to all motions; they come before the start deflections."""
        return self.bristles + self.pairs

    def elements(self, x: Array) -> list[_One]:
        """Return the numbers of each element."""
        ends = np.cumsum(self.sizes)
        return [_One(x[a], x[a + 1], x[a + 2 : b]) for a, b in zip(ends - self.sizes, ends, strict=True)]

    def inertia(self, x: Array) -> Array:
        """Return the relative errors of the inertia, shape (pairs,)."""
        return x[self.bristles : self.shared]

    def starts(self, x: Array) -> Array:
        """Return the start deflections of M motions, in parts of those of steady sliding, shape (M, e)."""
        return x[self.shared :].reshape(-1, len(self.families))


@dataclass(frozen=True, eq=False)
class GroupResidual:
    """What bristles of given kinds of the e elements of a group leave over of M motions, as a function of parameters.

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
    def layout(self) -> _Layout:
        """Return what stands where in the parameters."""
        return _Layout(self.families, int(self.motions[0].inertial.shape[2]))

    def values(self, x: Array) -> Array:
        """Return c0, Nm/rad, and c1, Nm s/rad, shape (e, 2)."""
        return np.array([(_exp(one.stiffness), self._c1(one, n)) for n, one in enumerate(self.layout.elements(x))])

    def of_motion(self, x: Array, index: int) -> Array:
        """Return the residual spectrum of a motion in parts of the scale, shape (r, k)."""
        motion = self.motions[index]
        left = motion.target - motion.inertial @ self.layout.inertia(x)
        for n, (one, start) in enumerate(zip(self.layout.elements(x), self.layout.starts(x)[index], strict=True)):
            torque = self._spectra(one, n, index, start) @ (1.0, self._c1(one, n))
            left = left - np.outer(torque, motion.inputs[n])
        return np.asarray(left / self.scale)

    def of_all(self, x: Array) -> Array:
        """Return the residual spectra of all motions in parts of the scale, shape (sum of r, k)."""
        return np.vstack([self.of_motion(x, index) for index in range(len(self.motions))])

    def residual(self, x: Array) -> Array:
        """Return the residuals of all motions, then those of the prior."""
        return np.concatenate([self.of_all(x).ravel(), x[self.layout.bristles :] / self._prior_sd(x)])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of `residual`."""
        rows = [-(self._slopes(x, i) / self.scale[:, None]).reshape(-1, x.size) for i in range(len(self.motions))]
        prior_sd = self._prior_sd(x)
        return np.vstack([*rows, np.eye(len(prior_sd), x.size, self.layout.bristles) / prior_sd[:, None]])

    def minimised(self, x: Array, most: int, xtol: float, ftol: float) -> OptimizeResult:
        """Return the least squares that begin at such parameters, with so many evaluations of the residuals at most."""
        return least_squares(self.residual, x, self.jacobian, method="lm", max_nfev=most, xtol=xtol, ftol=ftol)

    def torque(self, x: Array, index: int, n: int) -> Array:
        """Return block means of the torque, Nm, and of its part that c0 gives, of the bristles of element n; (b, 2)."""
        one, start = self.layout.elements(x)[n], self.layout.starts(x)[index, n]
        trace = self.motions[index].traces[n]
        both = trace.bristles(self._kind(one, n), _exp(one.stiffness), self._clipped(start))
        return np.column_stack([both @ (1.0, self._c1(one, n)), both[:, 0]])

    def friction(self, x: Array, index: int) -> Array:
        """Return block means of the friction torque at the joints along a motion, Nm, shape (b, k)."""
        motion = self.motions[index]
        total = [self.torque(x, index, n)[:, 0] + trace.viscous for n, trace in enumerate(motion.traces)]
        return np.column_stack(total) @ motion.inputs

    def with_first_starts(self, x: Array) -> Array:
        """Return parameters with start deflections that fit best of a few, one element after the other."""
        count = len(self.families)
        for index in range(len(self.motions)):
            for n in range(count):
                column = self.layout.shared + index * count + n
                tried = [np.where(np.arange(x.size) == column, start, x) for start in _STARTS]
                x = min(tried, key=lambda each: float(np.sum(self.of_motion(each, index) ** 2)))
        return x

    def _prior_sd(self, x: Array) -> Array:
        """Return the prior's standard deviations of the errors of the inertia and of the start deflections."""
        return np.repeat([INERTIA_SD, self.start_sd], [self.layout.pairs, x.size - self.layout.shared])

    def _kind(self, one: _One, n: int) -> BristlesPart | None:
        return self.families[n].bristles(one.shape, self.motions[0].traces[n].element.tau_c_positive)

    def _c1(self, one: _One, n: int) -> float:
        return _exp(one.damping) if self.unit is None else float(one.damping * self.unit[n])

    def _clipped(self, start: float) -> float:
        return float(np.clip(start, -self.max_start, self.max_start))

    def _spectra(self, one: _One, n: int, index: int, start: float) -> Array:
        trace = self.motions[index].traces[n]
        return trace.spectra(self._kind(one, n), _exp(one.stiffness), self._clipped(start))

    def _slopes(self, x: Array, index: int) -> Array:
        """Return the derivatives of a motion's torques by the parameters, Nm, shape (r, k, parameters)."""
        motion, layout = self.motions[index], self.layout
        found, first = np.zeros((*motion.target.shape, x.size)), 0
        stiffer = np.log1p(_PARAMETER_STEP) if self.unit is None else _PARAMETER_STEP
        for n, (one, start) in enumerate(zip(layout.elements(x), layout.starts(x)[index], strict=True)):
            c1, row = self._c1(one, n), motion.inputs[n]
            here = self._spectra(one, n, index, start)
            others = [one._replace(shape=one.shape + _PARAMETER_STEP * unit) for unit in np.eye(one.shape.size)]
            moved = [(one._replace(stiffness=one.stiffness + stiffer), start), *((other, start) for other in others)]
            moved.append((one, start + _PARAMETER_STEP))
            by_stiffness, *by_shape, by_start = (
                (self._spectra(each, n, index, at) - here) @ (1.0, c1) / _PARAMETER_STEP for each, at in moved
            )
            by_damping = here[:, 1] * (c1 if self.unit is None else self.unit[n])
            last = first + layout.sizes[n]
            found[:, :, first:last] = np.column_stack([by_stiffness, by_damping, *by_shape])[:, None, :] * row[:, None]
            found[:, :, layout.shared + index * len(self.families) + n] = np.outer(by_start, row)
            first = last
        found[:, :, first : layout.shared] = motion.inertial
        return found


def symmetric(pairs: Array, joints: int) -> Array:
    """Return what is known of each pair of k joints, shape (k (k + 1) / 2,), as a symmetric matrix, shape (k, k)."""
    matrix = np.zeros((joints, joints))
    matrix[np.triu_indices(joints)] = pairs
    return np.asarray(matrix + np.triu(matrix, 1).T)


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

    model: GroupResidual
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
        model = GroupResidual(tuple(families), tuple(motions), scale, _DAMPING_RATIO_S * c0)
        rest, found = np.zeros(model.layout.pairs + len(motions) * len(families)), []
        for shapes in _guesses(families):
            parts = [np.concatenate([[np.log(c), 1.0], shape]) for c, shape in zip(c0, shapes, strict=True)]
            first = model.with_first_starts(np.concatenate([*parts, rest]))
            found.append(cls._solved(model, first, _MAX_EVALUATIONS))
        return min(found, key=lambda fit: fit.cost)

    @classmethod
    def _solved(cls, model: GroupResidual, x: Array, most: int) -> GroupFit:
        effort = 1.0 if len(model.families) == 1 else _SHARED_EFFORT
        result = model.minimised(x, round(effort * most), _TOLERANCE, _TOLERANCE)
        return cls(model, result.x, 2.0 * float(result.cost))

    def without(self, index: int) -> GroupFit:
        """Return the fit to all motions but one."""
        layout, motions = self.model.layout, self.model.motions
        starts = np.delete(layout.starts(self.x), index, axis=0)
        model = replace(self.model, motions=(*motions[:index], *motions[index + 1 :]))
        return self._solved(model, np.concatenate([self.x[: layout.shared], starts.ravel()]), _MAX_REFINEMENTS)

    def left_over(self, motion: KindMotion, starts: Array) -> Array:
        """Return the residual spectrum of another motion from the start deflections that fit it best.

        Args:
            motion: of the group.
            starts: where the search for them begins, shape (e,).

        Returns:
            Torques in parts of the scale, shape (r, k).
        """
        model, shared = replace(self.model, motions=(motion,)), self.model.layout.shared
        fixed = self.x[:shared]

        def residual(x: Array) -> Array:
            return model.residual(np.concatenate([fixed, x]))

        def slopes(x: Array) -> Array:
            return model.jacobian(np.concatenate([fixed, x]))[:, shared:]

        guesses = [starts, *(np.full(len(starts), each) for each in _STARTS)]
        first = min(guesses, key=lambda x: float(np.sum(residual(x) ** 2)))
        best = least_squares(residual, first, slopes, method="lm", max_nfev=_MAX_EVALUATIONS, xtol=_TOLERANCE).x
        return model.of_motion(np.concatenate([fixed, best]), 0)

    def starts_of(self, index: int) -> Array:
        """Return the start deflections in a motion, shape (e,)."""
        return np.asarray(self.model.layout.starts(self.x)[index])

    def element(self, place: int) -> KindFit:
        """Return what was fitted of the element at a place in the group."""
        one = self.model.layout.elements(self.x)[place]
        c0, c1 = self.model.values(self.x)[place].tolist()
        coulomb = self.model.motions[0].traces[place].element.tau_c_positive
        inertia = float(np.abs(self.model.layout.inertia(self.x)).max())
        return KindFit(self.model.families[place], c0, one.shape, c1, inertia, coulomb)

    def seen(self, place: int, index: int) -> tuple[Array, Array]:
        """Return the torque of an element along a motion, the measured one less all others', and its own, Nm.

        Both are block means, shape (b,).
        """
        motion = self.model.motions[index]
        left = motion.measured @ np.concatenate([[1.0], -self.model.layout.inertia(self.x)])
        torques = [self.model.torque(self.x, index, n)[:, 0] for n in range(len(motion.traces))]
        for n, torque in enumerate(torques):
            if n != place:
                left = left - np.outer(torque, motion.inputs[n])
        row = motion.inputs[place]
        return np.asarray(left @ row / (row @ row)), torques[place]


def _guesses(families: Sequence[KindFamily]) -> list[tuple[Array, ...]]:
    """Return where fits begin: of elements that share joints each kind's guess in the middle, there are enough fits."""
    every = [family.guesses() for family in families]
    if len(families) > 1:
        every = [[np.mean(guesses, axis=0)] for guesses in every]
    return list(itertools.product(*every))
