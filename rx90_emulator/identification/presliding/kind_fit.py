"""Fit bristles of given kinds to micro-motions of the joints that share their elements.

All numbers of all elements are found together by least squares (Levenberg-Marquardt), with errors of the joints'
inertia and a start deflection of each element in each motion.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from rx90_common.base.arrays import Array
from rx90_common.friction.parts.bristles import BristlesPart, MaxwellSlip
from rx90_emulator.identification.presliding.kind_model import ATTRACTION, KindFamily, KindMotion

_INERTIA_SD = 0.05  # prior standard deviation of its relative errors
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
    """The numbers of one element: ln c0, c1, and the kind's own."""

    stiffness: float
    damping: float
    shape: Array

    def moved(self, column: int) -> _One:
        """Return it a little further in the number of a column: ln c0, or the kind's own."""
        if column == 0:
            return self._replace(stiffness=self.stiffness + _PARAMETER_STEP)
        return self._replace(shape=self.shape + _PARAMETER_STEP * (np.arange(self.shape.size) == column - 1))


@dataclass(frozen=True)
class _Layout:
    """What stands where in the parameters of a fit.

    First ln c0, c1 in a unit of its own, and the kind's own numbers, element by element; then the errors of the
    inertia; then the start deflections, motion by motion.

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
class GroupTorque:
    """What bristles of given kinds of the e elements of a group leave over of M motions, as a function of parameters.

    Attributes:
        families: of the elements.
        unit: of c1 among the parameters, Nm s/rad, shape (e,).
        motions: M of them.
        scale: torque to which residuals are compared, Nm, shape (k,).
    """

    families: tuple[KindFamily, ...]
    unit: Array
    motions: tuple[KindMotion, ...]
    scale: Array

    @cached_property
    def layout(self) -> _Layout:
        """Return what stands where in the parameters."""
        return _Layout(self.families, int(self.motions[0].inertial.shape[2]))

    def bristles(self, one: _One, n: int) -> tuple[BristlesPart | None, float]:
        """Return the bristles of element n, None is LuGre's, and their c0, Nm/rad."""
        coulomb = self.motions[0].traces[n].element.tau_c_positive
        return self.families[n].bristles(one.shape, coulomb), float(np.exp(np.clip(one.stiffness, -20.0, 25.0)))

    def of_motion(self, x: Array, index: int) -> Array:
        """Return the residual spectrum of a motion in parts of the scale, shape (r, k)."""
        motion = self.motions[index]
        left = motion.target - motion.inertial @ self.layout.inertia(x)
        for n, (one, start) in enumerate(zip(self.layout.elements(x), self.layout.starts(x)[index], strict=True)):
            left = left - np.outer(self._spectrum(one, n, index, start), motion.inputs[n])
        return np.asarray(left / self.scale)

    def residual(self, x: Array) -> Array:
        """Return the residuals of all motions, then those of the prior."""
        parts = [self.of_motion(x, index).ravel() for index in range(len(self.motions))]
        return np.concatenate([*parts, self.layout.inertia(x) / _INERTIA_SD, x[self.layout.shared :] / _START_SD])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of `residual`."""
        rows = [-(self._slopes(x, i) / self.scale[:, None]).reshape(-1, x.size) for i in range(len(self.motions))]
        first, pairs = self.layout.bristles, self.layout.pairs
        own = np.zeros((x.size - first, x.size))
        own[:, first:] = np.diag(np.where(np.arange(len(own)) < pairs, 1.0 / _INERTIA_SD, 1.0 / _START_SD))
        return np.vstack([*rows, own])

    def solved(self, x: Array, most: int) -> GroupFit:
        """Return the fit that begins at such parameters, with so many evaluations of the residuals at most."""
        if len(self.families) > 1:
            most = round(_SHARED_EFFORT * most)
        result = least_squares(
            self.residual, x, self.jacobian, method="lm", max_nfev=most, xtol=_TOLERANCE, ftol=_TOLERANCE
        )
        return GroupFit(self, result.x, 2.0 * float(result.cost))

    def with_first_starts(self, x: Array) -> Array:
        """Return parameters with start deflections that fit best of a few, one element after the other."""
        count = len(self.families)
        for index in range(len(self.motions)):
            for n in range(count):
                column = self.layout.shared + index * count + n
                tried = [np.where(np.arange(x.size) == column, start, x) for start in _STARTS]
                x = min(tried, key=lambda each: float(np.sum(self.of_motion(each, index) ** 2)))
        return x

    def _spectrum(self, one: _One, n: int, index: int, start: float) -> Array:
        torque = self.motions[index].traces[n].spectra(*self.bristles(one, n), _clipped(start))
        return np.asarray(torque @ (1.0, one.damping * self.unit[n]))

    def _slopes(self, x: Array, index: int) -> Array:
        """Return the derivatives of a motion's torques by the parameters, Nm, shape (r, k, parameters)."""
        motion, layout = self.motions[index], self.layout
        found, first = np.zeros((*motion.target.shape, x.size)), 0
        for n, (one, start) in enumerate(zip(layout.elements(x), layout.starts(x)[index], strict=True)):
            here = self._spectrum(one, n, index, start)
            moved = [one.moved(c) for c in range(1 + self.families[n].count)]
            slopes = [(self._spectrum(each, n, index, start) - here) / _PARAMETER_STEP for each in moved]
            slopes.insert(1, self._spectrum(one._replace(damping=one.damping + 1.0), n, index, start) - here)
            last = first + layout.sizes[n]
            found[:, :, first:last] = np.column_stack(slopes)[:, None, :] * motion.inputs[n][:, None]
            by_start = (self._spectrum(one, n, index, start + _PARAMETER_STEP) - here) / _PARAMETER_STEP
            found[:, :, layout.shared + index * len(self.families) + n] = np.outer(by_start, motion.inputs[n])
            first = last
        found[:, :, first : layout.shared] = motion.inertial
        return found


@dataclass(frozen=True, eq=False)
class GroupFit:
    """Bristles of given kinds of all e elements of a group, fitted to its motions.

    Attributes:
        model: the kinds, and the motions.
        x: its parameters.
        cost: residual power, the prior's included, over that of the scale.
    """

    model: GroupTorque
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
        model = GroupTorque(tuple(families), _DAMPING_RATIO_S * c0, tuple(motions), scale)
        rest, found = np.zeros(model.layout.pairs + len(motions) * len(families)), []
        for shapes in _guesses(families):
            parts = [np.concatenate([[np.log(c), 1.0], shape]) for c, shape in zip(c0, shapes, strict=True)]
            found.append(model.solved(model.with_first_starts(np.concatenate([*parts, rest])), _MAX_EVALUATIONS))
        return min(found, key=lambda fit: fit.cost)

    def without(self, index: int) -> GroupFit:
        """Return the fit to all motions but one."""
        layout, motions = self.model.layout, self.model.motions
        starts = np.delete(layout.starts(self.x), index, axis=0)
        model = replace(self.model, motions=(*motions[:index], *motions[index + 1 :]))
        return model.solved(np.concatenate([self.x[: layout.shared], starts.ravel()]), _MAX_REFINEMENTS)

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
        coulomb = self.model.motions[0].traces[place].element.tau_c_positive
        inertia = float(np.abs(self.model.layout.inertia(self.x)).max())
        damping = one.damping * float(self.model.unit[place])
        return KindFit(self.model.families[place], float(np.exp(one.stiffness)), one.shape, damping, inertia, coulomb)

    def seen(self, place: int, index: int) -> tuple[Array, Array]:
        """Return the torque of an element along a motion, the measured one less all others', and its own, Nm.

        Both are block means, shape (b,).
        """
        layout, motion = self.model.layout, self.model.motions[index]
        left = motion.measured @ np.concatenate([[1.0], -layout.inertia(self.x)])
        torques = []
        for n, (one, start) in enumerate(zip(layout.elements(self.x), self.starts_of(index), strict=True)):
            both = motion.traces[n].bristles(*self.model.bristles(one, n), _clipped(start))
            torques.append(both @ (1.0, one.damping * self.model.unit[n]))
            if n != place:
                left = left - np.outer(torques[n], motion.inputs[n])
        row = motion.inputs[place]
        return np.asarray(left @ row / (row @ row)), torques[place]


def _guesses(families: Sequence[KindFamily]) -> list[tuple[Array, ...]]:
    """Return where fits begin: of elements that share joints each kind's guess in the middle, there are enough fits."""
    every = [family.guesses() for family in families]
    if len(families) > 1:
        every = [[np.mean(guesses, axis=0)] for guesses in every]
    return list(itertools.product(*every))


def _clipped(start: float) -> float:
    return float(np.clip(start, -_MAX_START, _MAX_START))
