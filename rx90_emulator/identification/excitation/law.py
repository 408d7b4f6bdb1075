"""The friction law of one element in the form of the fit: linear and non-linear parameters, and columns along a motion.

Equations 17 to 19 and the viscous exponent, with the bristle's torque over the Coulomb torque u = c0 z / tau_c:

    tau_f = tau_c u + c1 dz/dt + c2 |v|^alpha sign(v)
    du/dt = stiffness (v - |v| u / h(v)),  h(v) = 1 + rise exp(-(|v| / omega_s)^delta)

tau_c, c2 and c1 are linear; alpha, rise = tau_s / tau_c - 1, omega_s, delta and stiffness = c0 / tau_c, the inverse of
the presliding distance, are not. Without a bristle u is sign(v) h(v). A difference of tau_c between the directions is a
constant torque, which cannot be distinguished from a joint's offset; tau_c is the mean of both directions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from rx90_common.base.arrays import Array, Index
from rx90_common.friction.bristle import decay
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.elementary import exponential
from rx90_common.kernels.lanes import Number, absolute, fma, load, select, store
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.problem import ExcitationProblem

COULOMB, VISCOUS, DAMPING = 0, 1, 2
"""Indices of the linear parameters tau_c, c2 and c1."""
LINEAR = ("tau_c", "c2", "c1")
SHAPED = {"alpha": VISCOUS, "rise": COULOMB, "omega_s": COULOMB, "delta": COULOMB, "stiffness": COULOMB}
"""The other parameters, with the linear parameter whose torque each of them shapes."""
FITTED = (*LINEAR, *SHAPED)
"""All parameters of an element in the fit, with the logarithms of omega_s and stiffness in place of these."""


class Part(Enum):
    """Parts that an element's friction may have beside Coulomb and viscous friction."""

    EXPONENT = "viscous exponent"
    STRIBECK = "Stribeck rise"
    BRISTLE = "bristle"
    DAMPING = "bristle damping"

    @classmethod
    def named(cls, name: str) -> Part:
        """Return the part with a name of command lines and Python code: in small letters, with hyphens."""
        return next(part for part in cls if part.value.lower().replace(" ", "-") == name)

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
PART_OF = {name: part for part, names in _SHAPE_OF.items() for name in names}
"""The part to which each parameter of a shape belongs."""
_LOGARITHMIC = frozenset({"omega_s", "stiffness"})


@dataclass(frozen=True)
class ElementShape:
    """The non-linear parameters of an element; the defaults are those of a part that is off.

    Attributes:
        parts: the element's parts.
        alpha: viscous exponent, 1.
        rise: static over Coulomb torque, less 1.
        omega_s: Stribeck velocity, rad/s.
        delta: Stribeck exponent, 1.
        stiffness: bristle stiffness over Coulomb torque, 1/rad.
        fixed: names of parameters that the data do not determine: they keep their values although their part is on.
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
        """Return the names of the free parameters, in the order of `values`."""
        return tuple(name for name, part in PART_OF.items() if part in self.parts and name not in self.fixed)

    @property
    def values(self) -> Array:
        """Return the free parameters in the form of the fit: logarithms of omega_s and stiffness."""
        pairs = [(name, getattr(self, name)) for name in self.free]
        return np.array([math.log(value) if name in _LOGARITHMIC else value for name, value in pairs])

    def with_values(self, values: Array) -> ElementShape:
        """Return the shape with other free parameters, in the form of `values`."""
        pairs = zip(self.free, values.tolist(), strict=True)
        changed: dict[str, Any] = {name: math.exp(x) if name in _LOGARITHMIC else x for name, x in pairs}
        return replace(self, **changed)

    def without(self, part: Part) -> ElementShape:
        """Return the shape without a part; bristle damping is removed with the bristle."""
        gone = {part, Part.DAMPING} if part is Part.BRISTLE else {part}
        neutral: dict[str, Any] = {name: getattr(_NEUTRAL, name) for name in part.shape}
        return replace(self, parts=self.parts - gone, fixed=self.fixed - set(part.shape), **neutral)

    def with_free(self, name: str) -> ElementShape:
        """Return the shape with one more free parameter, its value unchanged."""
        part = PART_OF[name]
        closed = frozenset() if part in self.parts else frozenset(part.shape)
        return replace(self, parts=self.parts | {part}, fixed=(self.fixed | closed) - {name})


_NEUTRAL = ElementShape()
_REST = 1e-300  # rad/s
LARGEST_POWER = math.log(700.0)
"""Largest logarithm of (|v| / omega_s)^delta: beyond it a Stribeck rise has faded."""


class Speeds(NamedTuple):
    """Velocities, rad/s, shape (m,), and the logarithms of their absolute values, bounded to be finite at rest."""

    velocity: Array
    logarithm: Array

    @classmethod
    def of(cls, velocity: Array) -> Speeds:
        """Return velocities with the logarithms that all shapes use."""
        return cls(velocity, np.log(np.maximum(np.abs(velocity), _REST)))


def viscous(shape: ElementShape, speeds: Speeds) -> tuple[Array, Array]:
    """Return |v|^alpha sign(v) and its derivative by alpha, each of shape (m,)."""
    column = np.sign(speeds.velocity) * np.exp(shape.alpha * speeds.logarithm)
    return column, column * speeds.logarithm


def coulomb(shape: ElementShape, speeds: Speeds) -> tuple[Array, dict[str, Array]]:
    """Return sign(v) h(v) and its derivatives by the parameters of a Stribeck part, where there is one, each (m,).

    The curve is that of `rx90_common.friction.element`, here from the logarithm of the speed, computed only once.
    """
    sign = np.sign(speeds.velocity)
    if Part.STRIBECK not in shape.parts:
        return sign, {}
    over = speeds.logarithm - math.log(shape.omega_s)
    ratio = np.exp(np.minimum(shape.delta * over, LARGEST_POWER))
    rest = np.exp(-ratio)
    slope = shape.rise * rest * ratio
    slopes = {"rise": rest, "omega_s": slope * shape.delta, "delta": -slope * over}
    return sign * (1.0 + shape.rise * rest), {name: sign * values for name, values in slopes.items()}


@inlined
def _product(speed: Number, logarithm: Number, rise: float, begin: float, delta: float, reach: float) -> Number:
    """Return the bristle's rate |v| / g times the step; `reach` is its factor without |v| and h."""
    product = reach * absolute(speed)
    if rise == 0.0:
        return product
    power = delta * (logarithm - begin)
    faded = select(power < LARGEST_POWER, power, LARGEST_POWER)
    return product / (1.0 + rise * exponential(-exponential(faded)))


@kernel
def deflect_bristles(speed: Array, logarithm: Array, parameters: Array, step: float, result: Array) -> None:
    """Deflect bristles from rest, by steps that are exact for a constant velocity.

    Terms that depend on the velocity alone are computed for eight steps in parallel; only the deflection is sequential.
    to the next.

    Args:
        speed: constant velocity of each step, rad/s, shape (m,).
        logarithm: of its absolute value, shape (m,).
        parameters: rise, ln omega_s, delta and stiffness of each bristle, shape (b, 4).
        step: s.
        result: receives u = c0 z / tau_c and dz/dt, rad/s, means over the two steps around each sample, shape (b, 2,
            m).
    """
    count = len(speed)
    whole = count - count % 8
    products = np.empty(count)
    phis = np.empty(count)
    psis = np.empty(count)
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
        torque = result[number, 0]
        rate = result[number, 1]
        u = 0.0
        for row in range(count):
            # u_1 = u + (stiffness v step - x u) phi, written so that few operations depend on u.
            push = reach * speed[row]
            phi = phis[row]
            started = push - products[row] * u
            torque[row] = u + started * psis[row]
            rate[row] = started * phi
            u = fma(1.0 - products[row] * phi, u, push * phi)
        for row in range(count - 1):
            torque[row] = 0.5 * (torque[row] + torque[row + 1])
            rate[row] = 0.5 * (rate[row] + rate[row + 1])
        for row in range(count):
            rate[row] /= reach


_VISIBLE = 0.02  # least presliding distance that shows, as a share of the way within a period after a reversal
_DIFFERENCE_STEP = 1e-4  # of the bristle's parameters in the form of the fit: their derivatives are differences


class ElementMotion(NamedTuple):
    """Motion of one element in one run, at its full rate.

    Attributes:
        run: the run.
        velocity: at the samples, rad/s, shape (m,).
        mean: mean velocities over the step that ends at each sample.
        at_torque: velocities where the torque was recorded.
    """

    run: FilteredRun
    velocity: Array
    mean: Speeds
    at_torque: Speeds

    @classmethod
    def of(cls, run: FilteredRun, share: Array) -> ElementMotion:
        """Return the motion of an element that turns with the joints in these proportions, shape (n,)."""
        mean = np.diff(run.position @ share, prepend=run.position[:1] @ share) / (1.0 / run.rate)
        return cls(run, run.velocity @ share, Speeds.of(mean), Speeds.of(run.torque_velocity @ share))

    def columns(self, shape: ElementShape) -> dict[int, Array]:
        """Return the factors of the linear parameters, and derivatives by the free parameters, unless they are all 0.

        The bristle's steps give means over each step; the mean of the two around a sample belongs to its time.

        Returns:
            Arrays of shape (m,) by index: that in LINEAR, and three further ones for each free parameter.
        """
        width = len(LINEAR)
        after = {name: width * (k + 1) for k, name in enumerate(shape.free)}
        column, by_alpha = viscous(shape, self.at_torque)
        found = {VISCOUS: column}
        if "alpha" in after:
            found[after["alpha"] + VISCOUS] = by_alpha
        if Part.BRISTLE not in shape.parts:
            found[COULOMB], by_stribeck = coulomb(shape, self.at_torque)
            found |= {after[name] + COULOMB: slope for name, slope in by_stribeck.items() if name in after}
        found = {place: self.run.evened(values) for place, values in found.items()}
        if Part.BRISTLE not in shape.parts:
            return found
        names = [name for name in shape.free if name != "alpha"]
        steps = _DIFFERENCE_STEP * np.eye(len(after))[[shape.free.index(name) for name in names]]
        shapes = [shape, *(shape.with_values(shape.values + step) for step in steps)]
        parameters = np.array([(one.rise, math.log(one.omega_s), one.delta, one.stiffness) for one in shapes])
        result = np.empty((len(shapes), 2, len(self.velocity)))
        deflect_bristles(*self.mean, parameters, 1.0 / self.run.rate, result)
        places = (COULOMB, DAMPING) if Part.DAMPING in shape.parts else (COULOMB,)
        for k, place in enumerate(places):
            found[place] = result[0, k]
            slopes = (result[1:, k] - result[0, k]) / _DIFFERENCE_STEP
            found |= {after[name] + place: slope for name, slope in zip(names, slopes, strict=True)}
        return found


def overall(ranges: tuple[tuple[float, float], tuple[float, float]]) -> tuple[float, float]:
    """Return the least and the greatest speed of the ranges of both directions; (0, 0) means no data."""
    moved = [pair for pair in ranges if pair[1] > 0.0]
    return min((low for low, _ in moved), default=0.0), max((high for _, high in moved), default=0.0)


@dataclass(frozen=True, eq=False)
class ElementRows:
    """The rows of a problem that one element acts on.

    Attributes:
        motions: of the element, run by run.
        rows: of the problem, shape (s,).
        place: index of each of them among the filtered samples of all runs, shape (s,).
        factor: joint torque over element torque, shape (s,).
    """

    motions: tuple[ElementMotion, ...]
    rows: Index
    place: Index
    factor: Array

    def columns(self, shape: ElementShape) -> Array:
        """Return the joint torques per unit of the linear parameters, shape (s, 3), followed by their derivatives.

        Each free parameter of the shape adds three columns: the shape is (s, 3 (1 + number of free parameters)).
        """
        low = np.zeros((sum(len(one.run.rows) for one in self.motions), len(LINEAR) * (1 + len(shape.free))))
        first = 0
        for motion in self.motions:
            # Only columns that are not 0 are filtered, each contiguous in memory.
            columns = motion.columns(shape)
            last = first + len(motion.run.rows)
            low[first:last, list(columns)] = motion.run.parallel(np.array(list(columns.values())).T)
            first = last
        return np.asarray(low[self.place] * self.factor[:, None])

    @cached_property
    def speeds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the least and the greatest speed with data in each direction, rad/s; (0, 0) without data.

        The outermost percent at both ends is excluded.
        """
        velocity = np.concatenate([one.velocity[one.run.rows] for one in self.motions])[self.place]
        ranges = []
        for speed in (velocity[velocity > 0.0], -velocity[velocity < 0.0]):
            low, high = np.percentile(speed, (1.0, 99.0)) if len(speed) else (0.0, 0.0)
            ranges.append((float(low), float(high)))
        return ranges[0], ranges[1]

    @cached_property
    def speed_range(self) -> tuple[float, float]:
        """Return the least and the greatest speed with data in any direction, rad/s."""
        return overall(self.speeds)

    @cached_property
    def shortest_presliding(self) -> float:
        """Return the least presliding distance that the rows can determine, rad.

        After a reversal at acceleration a, an element moves by a t^2 / 2 within the period t of the torque's bandwidth;
        a bristle that slides after a small share of this looks like a step to the filtered torque, as Coulomb friction
        does.
        """
        distances = []
        for run, velocity, *_ in self.motions:
            acceleration = float(np.sqrt(np.mean(np.gradient(velocity, 1.0 / run.rate) ** 2)))
            distances.append(_VISIBLE * 0.5 * acceleration / run.bandwidths.torque**2)
        return max(min(distances), 1e-7)


def element_rows(problem: ExcitationProblem) -> tuple[ElementRows, ...]:
    """Return the rows of each element of a problem, in the arm's order."""
    found = []
    for share in problem.arm.element_matrix:
        rows = np.flatnonzero(share[problem.joint])
        motions = tuple(ElementMotion.of(run, share) for run in problem.runs)
        found.append(ElementRows(motions, rows, problem.sample[rows], share[problem.joint[rows]]))
    return tuple(found)


def coulomb_viscous(problem: ExcitationProblem) -> Array:
    """Return two columns for each element: sign(v) and v, the torques per tau_c and c2; shape (r, 2 n_el).

    The sign is of the filtered velocity at the full rate, where the torque was recorded, and is filtered with it.
    """
    columns = joint_columns(problem, [ElementShape()] * len(problem.arm.element_names))
    return np.asarray(columns[:, :, [COULOMB, VISCOUS]].reshape(len(problem), -1))


def joint_columns(problem: ExcitationProblem, shapes: Sequence[ElementShape]) -> Array:
    """Return the joint torques per unit of tau_c, c2 and c1 of each element with its shape, shape (r, n_el, 3)."""
    found = np.zeros((len(problem), len(shapes), len(LINEAR)))
    for e, (rows, shape) in enumerate(zip(element_rows(problem), shapes, strict=True)):
        found[rows.rows, e] = rows.columns(replace(shape, fixed=frozenset(FITTED)))
    return found
