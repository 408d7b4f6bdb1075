"""The friction law of one element as the fit writes it: what is linear, what is not, and its derivatives.

Equations 17 to 19 and the viscous exponent, with the bristle's torque over the Coulomb torque u = c0 z / tau_c:

    tau_f = tau_c u + c1 dz/dt + c2 |v|^alpha sign(v)
    du/dt = stiffness (v - |v| u / h(v)),  h(v) = 1 + rise exp(-(|v| / omega_s)^delta)

Linear are tau_c, c2 and c1; not linear are alpha, rise = tau_s / tau_c - 1, omega_s, delta and stiffness = c0 / tau_c,
the inverse of the presliding distance. Without a bristle u is sign(v) h(v). A difference of tau_c between the
directions is a constant torque, which no motion tells from a joint's offset; tau_c is the mean of both directions.

Compiled deflection of bristles along one motion, several of different parameters at a time.

What the linear parameters of an element multiply along recorded motions: filtered rows, and their derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.friction.bristle import decay
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.elementary import exponential
from rx90_common.kernels.lanes import Number, absolute, fma, load, select, store
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.problem import ExcitationProblem

COULOMB, VISCOUS, DAMPING = 0, 1, 2
"""Places of the linear parameters tau_c, c2 and c1."""
LINEAR = ("tau_c", "c2", "c1")
FITTED = (*LINEAR, "alpha", "rise", "omega_s", "delta", "stiffness")
"""All parameters of an element as the fit writes them: omega_s and stiffness stand for their logarithms."""


class Part(Enum):
    """What an element's friction may have beside Coulomb and viscous friction."""

    EXPONENT = "viscous exponent"
    STRIBECK = "Stribeck rise"
    BRISTLE = "bristle"
    DAMPING = "bristle damping"

    @property
    def shape(self) -> tuple[str, ...]:
        """Return the names of its parameters in ElementShape."""
        return _SHAPE_OF[self]


_SHAPE_OF = {
    Part.EXPONENT: ("alpha",),
    Part.STRIBECK: ("rise", "omega_s", "delta"),
    Part.BRISTLE: ("stiffness",),
    Part.DAMPING: (),
}
_LOGARITHMIC = frozenset({"omega_s", "stiffness"})


@dataclass(frozen=True)
class ElementShape:
    """The parameters of an element that are not linear; the defaults are those of a part that is off.

    Attributes:
        parts: which parts the element has.
        alpha: viscous exponent, 1.
        rise: static over Coulomb torque, less 1.
        omega_s: Stribeck velocity, rad/s.
        delta: Stribeck exponent, 1.
        stiffness: bristle stiffness over Coulomb torque, 1/rad.
        fixed: names of those that the data do not tell: they stay as they are, though their part is there.
    """

    parts: frozenset[Part] = frozenset()
    alpha: float = 1.0
    rise: float = 0.0
    omega_s: float = math.inf
    delta: float = 1.0
    stiffness: float = math.inf
    fixed: frozenset[str] = frozenset()

    @property
    def free(self) -> tuple[str, ...]:
        """Return the names of the parameters that its parts leave open, in the order of `values`."""
        return tuple(n for part in Part if part in self.parts for n in part.shape if n not in self.fixed)

    @property
    def values(self) -> Array:
        """Return the free parameters as the fit writes them: logarithms of omega_s and stiffness."""
        return np.array([_written(name, getattr(self, name)) for name in self.free])

    def with_values(self, values: Array) -> ElementShape:
        """Return the shape with other free parameters, written as `values`."""
        changed: dict[str, Any] = {n: _read(n, float(x)) for n, x in zip(self.free, values, strict=True)}
        return replace(self, **changed)

    def without(self, part: Part) -> ElementShape:
        """Return the shape without a part; bristle damping goes with the bristle."""
        gone = {part, Part.DAMPING} if part is Part.BRISTLE else {part}
        neutral: dict[str, Any] = {name: getattr(_NEUTRAL, name) for name in part.shape}
        return replace(self, parts=self.parts - gone, fixed=self.fixed - set(part.shape), **neutral)

    def opened(self, name: str) -> ElementShape:
        """Return the shape with a parameter among its free ones, its value as it is."""
        part = next(part for part in Part if name in part.shape)
        closed = frozenset() if part in self.parts else frozenset(part.shape)
        return replace(self, parts=self.parts | {part}, fixed=(self.fixed | closed) - {name})


_NEUTRAL = ElementShape()
_REST = 1e-300  # rad/s
LARGEST_POWER = math.log(700.0)
"""Of (|v| / omega_s)^delta, its logarithm: beyond, a Stribeck rise has faded."""


def _written(name: str, value: float) -> float:
    return math.log(value) if name in _LOGARITHMIC else value


def _read(name: str, value: float) -> float:
    return math.exp(value) if name in _LOGARITHMIC else value


@dataclass(frozen=True, eq=False)
class Speeds:
    """Velocities, rad/s, shape (m,), and what all shapes make use of."""

    velocity: Array

    @cached_property
    def sign(self) -> Array:
        """Return their signs, shape (m,)."""
        return np.asarray(np.sign(self.velocity))

    @cached_property
    def logarithm(self) -> Array:
        """Return the logarithms of their sizes, shape (m,), bounded from below so that rest gives no infinity."""
        return np.asarray(np.log(np.maximum(np.abs(self.velocity), _REST)))


def stribeck_factor(shape: ElementShape, speeds: Speeds) -> tuple[Array, dict[str, Array]]:
    """Return h and its derivatives by rise, ln omega_s and delta where the shape has a Stribeck part, each (m,)."""
    if Part.STRIBECK not in shape.parts:
        return np.ones_like(speeds.velocity), {}
    over = speeds.logarithm - math.log(shape.omega_s)
    ratio = np.exp(np.minimum(shape.delta * over, LARGEST_POWER))
    decay = np.exp(-ratio)
    slope = shape.rise * decay * ratio
    return 1.0 + shape.rise * decay, {"rise": decay, "omega_s": slope * shape.delta, "delta": -slope * over}


def viscous(shape: ElementShape, speeds: Speeds) -> tuple[Array, Array]:
    """Return |v|^alpha sign(v) and its derivative by alpha, each of shape (m,)."""
    column = speeds.sign * np.exp(shape.alpha * speeds.logarithm)
    return column, column * speeds.logarithm


def steady_columns(shape: ElementShape, velocity: Array) -> tuple[Array, dict[str, Array]]:
    """Return what the linear parameters multiply in steady sliding, and its derivatives.

    Args:
        shape: of the element.
        velocity: rad/s, shape (m,).

    Returns:
        Columns of LINEAR, shape (m, 3), and their derivatives by each other parameter in FITTED.
    """
    speeds = Speeds(velocity)
    factor, by_stribeck = stribeck_factor(shape, speeds)
    column, by_alpha = viscous(shape, speeds)
    derivatives = {name: np.zeros((len(velocity), 3)) for name in FITTED[len(LINEAR) :]}
    derivatives["alpha"][:, VISCOUS] = by_alpha
    for name, slope in by_stribeck.items():
        derivatives[name][:, COULOMB] = speeds.sign * slope
    return np.column_stack([speeds.sign * factor, column, np.zeros_like(velocity)]), derivatives


def bristle_parameters(shape: ElementShape) -> tuple[float, float, float, float]:
    """Return rise, ln omega_s, delta and stiffness in 1/rad, as `deflect_bristles` takes them."""
    return shape.rise, math.log(shape.omega_s), shape.delta, shape.stiffness


@inlined
def _product(speed: Number, logarithm: Number, rise: float, begin: float, delta: float, reach: float) -> Number:
    """Return the bristle's rate |v| / g times the step, of which `reach` is the part without |v| and h."""
    product = reach * absolute(speed)
    if rise == 0.0:
        return product
    power = delta * (logarithm - begin)
    faded = select(power < LARGEST_POWER, power, LARGEST_POWER)
    return product / (1.0 + rise * exponential(-exponential(faded)))


@kernel
def deflect_bristles(speed: Array, logarithm: Array, parameters: Array, step: float, result: Array) -> None:
    """Deflect bristles from rest, by steps that are exact for a velocity that is held.

    What depends on the velocity alone is computed for eight steps side by side; only the deflection goes from one step
    to the next.

    Args:
        speed: held over each step, rad/s, shape (m,).
        logarithm: of its size, shape (m,).
        parameters: rise, ln omega_s, delta and stiffness of each bristle, shape (b, 4).
        step: s.
        result: takes u = c0 z / tau_c and dz/dt, rad/s, means over the two steps around each sample, shape (b, 2, m).
    """
    count = len(speed)
    whole = count - count % 8
    products, phis, psis = np.empty(count), np.empty(count), np.empty(count)
    for number in range(len(parameters)):
        rise, begin, delta, stiffness = parameters[number]
        reach = stiffness * step
        for row in range(0, whole, 8):
            several = _product(load(speed[row:], 8), load(logarithm[row:], 8), rise, begin, delta, reach)
            both = decay(several)
            store(products[row:], several)
            store(phis[row:], both[0])
            store(psis[row:], both[1])
        for row in range(whole, count):
            products[row] = _product(speed[row], logarithm[row], rise, begin, delta, reach)
            phis[row], psis[row] = decay(products[row])
        torque, rate = result[number, 0], result[number, 1]
        u = 0.0
        for row in range(count):
            # u_1 = u + (stiffness v step - x u) phi, written so that few operations wait for u.
            push, phi = reach * speed[row], phis[row]
            started = push - products[row] * u
            torque[row] = u + started * psis[row]
            rate[row] = started * phi
            u = fma(1.0 - products[row] * phi, u, push * phi)
        for row in range(count - 1):
            torque[row] = 0.5 * (torque[row] + torque[row + 1])
            rate[row] = 0.5 * (rate[row] + rate[row + 1])
        for row in range(count):
            rate[row] /= reach


_VISIBLE = 0.02  # share of the way of a period after a reversal that a presliding distance must have, to be seen
_DIFFERENCE_STEP = 1e-4  # of the bristle's parameters, as the fit writes them: their derivatives are differences


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
            found[after[name] + COULOMB], found[after[name] + DAMPING] = (there - here) / _DIFFERENCE_STEP
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
    """Return a shape with one free parameter moved by _DIFFERENCE_STEP."""
    values = shape.values
    values[shape.free.index(name)] += _DIFFERENCE_STEP
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
            _VISIBLE * 0.5 * float(np.sqrt(np.mean(np.gradient(m.velocity, m.step) ** 2))) / run.bandwidths.torque**2
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
