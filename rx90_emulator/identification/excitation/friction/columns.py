"""What the linear parameters of an element multiply along recorded motions: filtered rows, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.friction.bristles import bristle_parameters, deflect_bristles
from rx90_emulator.identification.excitation.friction.law import (
    COULOMB,
    DAMPING,
    LINEAR,
    VISCOUS,
    ElementShape,
    Part,
    Speeds,
    stribeck_factor,
    viscous,
)
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_SHOWN = 0.02  # share of the way of a period after a reversal that a presliding distance must have, to be seen
_DIFFERENCE = 1e-4  # of the bristle's parameters, as the fit writes them: their derivatives are differences


@dataclass(frozen=True, eq=False)
class ElementMotion:
    """Motion of one element in one run, at its full rate.

    Attributes:
        run: that it is of.
        velocity: at the samples, rad/s, shape (m,).
        mean: over the step that ends at each sample, rad/s, shape (m,).
        at_torque: velocity where the torque was recorded, rad/s, shape (s,).
    """

    run: FilteredRun
    velocity: Array
    mean: Array
    at_torque: Array

    @classmethod
    def of(cls, run: FilteredRun, share: Array) -> ElementMotion:
        """Return the motion of an element that turns with the joints by these shares, shape (n,)."""
        mean = np.diff(run.position @ share, prepend=run.position[:1] @ share) / (1.0 / run.rate)
        return cls(run, run.velocity @ share, mean, run.torque_velocity @ share)

    @property
    def step(self) -> float:
        """Return the time between two samples, s."""
        return 1.0 / self.run.rate

    @cached_property
    def speeds(self) -> tuple[Speeds, Speeds]:
        """Return the velocities where the torque was recorded, and the means over the steps, as shapes use them."""
        return Speeds(self.at_torque), Speeds(self.mean)

    def columns(self, shape: ElementShape) -> dict[int, Array]:
        """Return what the linear parameters multiply, and derivatives by the free parameters, as far as not all 0.

        Returns:
            Arrays of shape (m,) by their place: that in LINEAR, three further for each free parameter.
        """
        width = len(LINEAR)
        after = {name: width * (k + 1) for k, name in enumerate(shape.free)}
        speeds = self.speeds[0]
        column, by_alpha = viscous(shape, speeds)
        found = {VISCOUS: column}
        if "alpha" in after:
            found[after["alpha"] + VISCOUS] = by_alpha
        if Part.BRISTLE not in shape.parts:
            factor, slopes = stribeck_factor(shape, speeds)
            found[COULOMB] = speeds.sign * factor
            found |= {after[name] + COULOMB: speeds.sign * slopes[name] for name in slopes if name in after}
        found = {place: self.run.evened(values) for place, values in found.items()}
        if Part.BRISTLE not in shape.parts:
            return found
        names = [name for name in shape.free if name != "alpha"]
        here, *moved = self._bristles([shape, *(_moved(shape, name) for name in names)])
        found[COULOMB], found[DAMPING] = here
        for name, there in zip(names, moved, strict=True):
            found[after[name] + COULOMB], found[after[name] + DAMPING] = (there - here) / _DIFFERENCE
        return found if Part.DAMPING in shape.parts else {k: v for k, v in found.items() if k % width != DAMPING}

    def _bristles(self, shapes: Sequence[ElementShape]) -> Array:
        """Return u = c0 z / tau_c, and dz/dt in rad/s, for each of b shapes, shape (b, 2, m).

        The simulation's steps are exact for a velocity that is held; they give means over each step, and the mean of
        the two steps around a sample belongs to its time.
        """
        result = np.empty((len(shapes), 2, len(self.mean)))
        parameters = np.array([bristle_parameters(shape) for shape in shapes])
        deflect_bristles(self.mean, self.speeds[1].logarithm, parameters, self.step, result)
        return result


def _moved(shape: ElementShape, name: str) -> ElementShape:
    """Return a shape with one free parameter moved by _DIFFERENCE."""
    values = shape.values
    values[shape.free.index(name)] += _DIFFERENCE
    return shape.with_values(values)


@dataclass(frozen=True, eq=False)
class ElementRows:
    """The rows of a problem that one element acts on.

    Attributes:
        motions: of the element, run by run.
        rows: of the problem, shape (s,).
        place: of each of them among the filtered samples of all runs, shape (s,).
        factor: joint torque over element torque, shape (s,).
        speed: velocity of the element at each, rad/s, shape (s,).
    """

    problem: ExcitationProblem
    motions: tuple[ElementMotion, ...]
    rows: NDArray[np.int64]
    place: NDArray[np.int64]
    factor: Array
    speed: Array

    def columns(self, shape: ElementShape) -> tuple[Array, dict[str, Array]]:
        """Return the joint torques per unit of the linear parameters, shape (s, 3), and their derivatives."""
        width = len(LINEAR)
        low = np.zeros((sum(len(run.rows) for run in self.problem.runs), width * (1 + len(shape.free))))
        first = 0
        for run, motion in zip(self.problem.runs, self.motions, strict=True):
            # Only what is not 0 is filtered, each column in one piece of memory.
            columns = motion.columns(shape)
            last = first + len(run.rows)
            low[first:last, list(columns)] = run.parallel(np.array(list(columns.values())).T)
            first = last
        rows = low[self.place] * self.factor[:, None]
        return rows[:, :width], {n: rows[:, width * (k + 1) : width * (k + 2)] for k, n in enumerate(shape.free)}

    @cached_property
    def speeds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the least and the greatest speed with data in each direction, rad/s; (0, 0) without data.

        The outermost percent at both ends is no range of data.
        """
        ranges = []
        for sign in (1.0, -1.0):
            speed = np.abs(self.speed[sign * self.speed > 0.0])
            low, high = np.percentile(speed, (1.0, 99.0)) if len(speed) else (0.0, 0.0)
            ranges.append((float(low), float(high)))
        return ranges[0], ranges[1]

    @cached_property
    def speed_range(self) -> tuple[float, float]:
        """Return the least and the greatest speed with data in any direction, rad/s."""
        ranges = [pair for pair in self.speeds if pair[1] > 0.0]
        return min((low for low, _ in ranges), default=0.0), max((high for _, high in ranges), default=0.0)

    @cached_property
    def shortest_presliding(self) -> float:
        """Return the least presliding distance that the rows can show, rad.

        After a reversal at acceleration a an element passes a t^2 / 2 within the period t of the torque's bandwidth; a
        bristle that slides after a small share of this is a step to the filtered torque, as Coulomb friction is.
        """
        distances = [
            _SHOWN * 0.5 * float(np.sqrt(np.mean(np.gradient(m.velocity, m.step) ** 2))) / run.bandwidths.torque**2
            for m, run in zip(self.motions, self.problem.runs, strict=True)
        ]
        return max(min(distances), 1e-7)


def element_rows(problem: ExcitationProblem) -> tuple[ElementRows, ...]:
    """Return the rows of each element of a problem, in the arm's order."""
    matrix = problem.arm.element_matrix
    starts = np.cumsum([0, *(len(run.rows) for run in problem.runs)])
    return tuple(_rows_of(problem, row, starts[problem.run] + problem.place) for row in matrix)


def _rows_of(problem: ExcitationProblem, share: Array, place: NDArray[np.int64]) -> ElementRows:
    motions = tuple(ElementMotion.of(run, share) for run in problem.runs)
    velocity = np.concatenate([m.velocity[run.rows] for m, run in zip(motions, problem.runs, strict=True)])
    factor = share[problem.joint]
    rows = np.flatnonzero(factor)
    return ElementRows(problem, motions, rows, place[rows], factor[rows], velocity[place[rows]])
