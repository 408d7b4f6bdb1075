"""Two methods of learning, by name: a filtered one that needs no model, and the norm-optimal one.

The filtered method is iterative learning control in its simplest form,

    c(t) <- Q [c(t) + gain e(t + lead)],

with a zero-phase low-pass filter Q (Bristow, Tharayil and Alleyne 2006, "A survey of iterative learning control", IEEE
Control Systems Magazine 26): the lead compensates the lag of the position loop; beyond the cut-off, where it no longer
does, nothing is learned.

The norm-optimal method uses the linear response of the joints to offsets of the position set-points along a motion. The
deviations dq of the arm from its nominal motion are linear in the offsets c: the linear time-varying model
of the arm, with M0, C0 and K0 along the motion, and around it the CS7B's PI on the position, D on the
velocity, and a lag T of first order for amplifier, velocity observer and sampling, drive by drive (W is the coupling of
the motors):

    M0 d2q/dt2 + (C0 + F) dq/dt + K0 q = W' tau,          di/dt = Mn ki W (c - q),
    T dtau/dt + tau = Mn kv [kp W (c - q) - W dq/dt] + i.

F is the viscous friction; bristles are neglected, because the next trial measures their effect. Over a set-point this
gives x(k+1) = A(k) x(k) + B(k) c(k) with four states for each of the n joints, constant for SPACING.

It determines the change u of the correction that minimises, over the whole motion,

    sum  (e - C x)' Q (e - C x) + u' R u,         e the last trial's error, x the response to u

(Amann, Owens and Rogers 1996, "Iterative learning control for discrete-time systems with exponential rate of
convergence", IEE Proceedings - Control Theory and Applications 143; by Hakvoort, Aarts, van Dijk and Jonker 2008 on a
Staubli RX90, Control Engineering Practice 16, with lifted matrices, whose cost grows with the cube of the samples, and
in a companion paper in Automatica with state equations). Its solution is a Riccati recursion backwards in time, which
depends on the model alone, and for each trial an adjoint recursion backwards and a run forwards: cost and memory grow
with the number of samples.

Both learn from the joints' errors by the encoders, or from the error of a measured tip, which the Jacobian of the path
relates to the joints.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from rx90_common.arm_dynamics import factorise, solve
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.description.kinematics import jacobian
from rx90_common.kernels.compiled import inlined, kernel
from rx90_emulator.correction.linearise import SPACING, linearise
from rx90_emulator.correction.path import TrajectoryPath
from rx90_emulator.loop.setup import Setup

LEAD_IN = 0.3
"""Time before the path from which errors count, s, gradually: so the error at rest is corrected when the path
begins."""
_MIN_SHARE = 0.05  # of the largest singular value: directions that take 20 times the joints' motion are hardly used
_ORDER = 2  # of the Butterworth filter, which is run forwards and backwards

Update: TypeAlias = Callable[[Array, Array, float], Array]
"""Returns the next offsets for offsets, rad, (n, joints), their error, and a share of the gain. The error is that of
the joints by the encoders, rad, (n, joints), or that of the tip, m, (n, 3)."""


class Method(Protocol):
    """A method of learning; frozen, checked."""

    def prepare(self, setup: Setup, nominal: TrajectoryPath, *, tip: bool) -> Update:
        """Return the update along a motion, from the error of the tip or from those of the encoders."""


@dataclass(frozen=True)
class Filtered:
    """The filtered method.

    Attributes:
        gain: share of an error that is added to the correction, 0 to 2.
        lead: s; None for the lag of the position loop without velocity feed-forward, 1/kp.
        cutoff: of the filter, Hz.

    Raises:
        ConfigError: naming the value and what is accepted.
    """

    gain: float = 1.0
    lead: float | None = None
    cutoff: float = 40.0

    def __post_init__(self) -> None:
        _check(self, gain=(0.0, 2.0, ""), lead=(0.0, 1.0, " s"), cutoff=(0.0, 1e6, " Hz"))

    def prepare(self, setup: Setup, nominal: TrajectoryPath, *, tip: bool) -> Update:
        """Return the update."""
        lead = float(np.mean(1.0 / setup.controller.kp)) if self.lead is None else self.lead
        rows = np.minimum(np.arange(len(nominal.counts)) + round(lead / nominal.period), len(nominal.counts) - 1)
        counted, low_pass = lead_in(nominal)[:, None], zero_phase(self.cutoff, nominal.period)
        inverse = _to_joints(setup, nominal) if tip else None

        def update(offsets: Array, error: Array, share: float) -> Array:
            joints = error if inverse is None else np.einsum("nij,nj->ni", inverse, error)
            return low_pass(offsets + share * self.gain * (joints * counted)[rows])

        return update


@dataclass(frozen=True)
class NormOptimal:
    """The norm-optimal method; both weights are relative to an error of a metre at the tip.

    Attributes:
        effort: weight of a change of the correction, m/rad. A smaller one learns faster and up to higher frequencies,
            relies more on the model, and transmits more noise.
        joints: weight of each joint's own error beside that of the tip, m/rad, with encoders; it also preserves the
            tool's orientation.
        cutoff: of a zero-phase filter of the correction, Hz; None for none.

    Raises:
        ConfigError: naming the value and what is accepted.
    """

    effort: float = 0.1
    joints: float = 0.005
    cutoff: float | None = None

    def __post_init__(self) -> None:
        _check(self, effort=(0.0, 1e3, " m/rad"), joints=(0.0, 1e3, " m/rad"), cutoff=(0.0, 1e6, " Hz"))

    def prepare(self, setup: Setup, nominal: TrajectoryPath, *, tip: bool) -> Update:
        """Return the update."""
        a, b, stride = response(setup, nominal.setpoints)
        slopes = jacobian(setup.robot.chain, nominal.setpoints[::stride, 0])
        by_tip = np.ascontiguousarray(np.swapaxes(slopes[:, :3], 1, 2))
        weight = by_tip @ slopes[:, :3] + (0.0 if tip else self.joints**2) * np.eye(slopes.shape[2])
        counted, point = lead_in(nominal), np.arange(len(nominal.counts)) // stride
        feedback, factors = gains(a, b, stride, weight, self.effort, counted)
        towards = (by_tip if tip else weight)[point] * counted[:, None, None]
        low_pass = None if self.cutoff is None else zero_phase(self.cutoff, nominal.period)

        def update(offsets: Array, error: Array, share: float) -> Array:
            weighted = np.einsum("nij,nj->ni", towards, error)
            changed = offsets + share * best_change(a, b, stride, feedback, factors, weighted)
            return changed if low_pass is None else low_pass(changed)

        return update


def method_named(name: str, **options: float) -> Filtered | NormOptimal:
    """Return the method "norm-optimal" or "filtered", with options instead of the defaults.

    Raises:
        ConfigError: for an option of the other method, and a value that is not accepted.
    """
    method = NormOptimal() if name == "norm-optimal" else Filtered()
    for option in options:
        if not hasattr(method, option):
            raise ConfigError(f"the method {name} has no option {option!r}; accepted: {', '.join(vars(method))}")
    return replace(method, **options)  # type: ignore[arg-type]


def lead_in(nominal: TrajectoryPath) -> Array:
    """Return the weights of the errors of set-points, 0 to 1, shape (n,)."""
    counts = nominal.counts.astype(np.float64)
    begin = int(np.argmax(nominal.counts))
    rows = min(round(LEAD_IN / nominal.period), begin)
    counts[begin - rows : begin] = np.arange(rows) / max(rows, 1)
    return counts


def zero_phase(cutoff: float, period: float) -> Callable[[Array], Array]:
    """Return a low-pass filter of rows, run forwards and backwards, which extends its input by its last value.

    Raises:
        ConfigError: if the cut-off is not below half the rate.
    """
    if not cutoff < 0.5 / period:
        raise ConfigError(f"cutoff is {cutoff:g} Hz; accepted: below {0.5 / period:g} Hz, half the rate of set-points")
    sections = butter(_ORDER, cutoff, fs=1.0 / period, output="sos")
    return lambda rows: np.ascontiguousarray(sosfiltfilt(sections, rows, axis=0, padtype="constant"))


def _to_joints(setup: Setup, nominal: TrajectoryPath) -> Array:
    """Return the damped pseudo-inverse of the tip's Jacobian along the motion, rad/m, shape (n, joints, 3)."""
    slopes = jacobian(setup.robot.chain, nominal.setpoints[:, 0])[:, :3]
    square = slopes @ np.swapaxes(slopes, 1, 2)
    damping = (_MIN_SHARE**2 * np.linalg.eigvalsh(square)[:, -1])[:, None, None] * np.eye(3)
    return np.asarray(np.swapaxes(slopes, 1, 2) @ np.linalg.inv(square + damping))


def _check(method: object, **ranges: tuple[float, float, str]) -> None:
    for name, (low, high, unit) in ranges.items():
        value = getattr(method, name)
        if value is not None and not low < value <= high:
            raise ConfigError(f"{name} is {value:g}{unit}; accepted: a number > {low:g}, up to {high:g}")


_HALVINGS, _TERMS = 5, 5  # of the matrix exponential: scaled, a Taylor polynomial, squared


def response(setup: Setup, setpoints: Array) -> tuple[Array, Array, int]:
    """Return A, shape (points, 4n, 4n), B, shape (points, 4n, n), and the number of set-points that each is valid for.

    The states are deviations of the joints and their velocities, integrators, and torques of the drives.

    Args:
        setup: robot, drives, friction, controller, rates.
        setpoints: of the nominal motion, shape (m, 3, n).
    """
    controller, period = setup.controller, setup.rates.position_period
    stride = max(1, round(SPACING / period))
    at = slice(None, None, stride)
    linear = linearise(setup.robot, setup.drives, setpoints[at, 0], setpoints[at, 1], setpoints[at, 2])
    turns, elements, joints = setup.drives.turning.turns, setup.drives.turning.element_matrix, setpoints.shape[2]
    viscous = elements.T @ np.diag([element.c2 for element in setup.friction.elements]) @ elements
    # The velocity observer, critically damped, lags by twice its time constant; a set-point is constant for its period.
    lag = (1.0 / controller.current_bandwidth + 2.0 / setup.drives.velocity_bandwidth) / (2.0 * math.pi)
    lag += 0.5 * setup.rates.period
    proportional, derivative = (
        np.diag(controller.inertia * gain) @ turns for gain in (controller.kv * controller.kp, controller.kv)
    )
    integral = np.diag(controller.inertia * controller.ki) @ turns
    inverse = np.linalg.inv(linear.mass)
    q, v, i, tau, c = (slice(k, k + joints) for k in range(0, 5 * joints, joints))
    one = np.eye(joints)
    rates = np.zeros((len(inverse), 5 * joints, 5 * joints))  # of the states, and of the offsets, which are constant
    rates[:, q, v] = one
    rates[:, v, q], rates[:, v, v] = -inverse @ linear.stiffness, -inverse @ (linear.damping + viscous)
    rates[:, v, tau] = inverse @ turns.T
    rates[:, i, q], rates[:, i, c] = -integral, integral
    rates[:, tau, q], rates[:, tau, c], rates[:, tau, v] = -proportional / lag, proportional / lag, -derivative / lag
    rates[:, tau, i], rates[:, tau, tau] = one / lag, -one / lag
    scaled, still = rates * (period / 2**_HALVINGS), np.eye(5 * joints)
    step = still
    for term in range(_TERMS, 0, -1):
        step = still + scaled @ step / term
    for _ in range(_HALVINGS):
        step = step @ step
    states = slice(4 * joints)
    return np.ascontiguousarray(step[:, states, states]), np.ascontiguousarray(step[:, states, c]), stride


def gains(
    a: Array, b: Array, stride: int, error: Array, change: float, counted: Array
) -> tuple[Array, NDArray[np.void]]:
    """Return the feedback K, shape (m, n, 4n), and the factors of R + B' P B, shape (m,): the Riccati recursion.

    Args:
        a: A, shape (points, 4n, 4n).
        b: B, shape (points, 4n, n).
        stride: set-points from one of them to the next.
        error: Q of the joints, m^2/rad^2, shape (points, n, n).
        change: square root of R, m/rad.
        counted: weight of the error of a set-point, 0 to 1, shape (m,).
    """
    joints = b.shape[2]
    # As records, the form that `factorise` and `solve` take.
    factors = np.empty(len(counted), np.dtype([("factor", np.float64, (joints, joints))]))
    return _gains(a, b, stride, error, change, counted, factors), factors


@kernel
def _gains(
    a: Array, b: Array, stride: int, error: Array, change: float, counted: Array, factors: NDArray[np.void]
) -> Array:
    count, states, joints = len(counted), a.shape[1], b.shape[2]
    feedback = np.empty((count, joints, states))
    cost, carried = np.zeros((states, states)), np.empty((states, states))
    closed, pushed = np.empty((states, states)), np.empty((states, joints))
    weight, column = np.empty((joints, joints)), np.empty(joints)
    for k in range(count - 1, -1, -1):
        point = min(k // stride, len(a) - 1)
        step, push = a[point], b[point]
        _times(cost, push, pushed)  # P B
        _transposed_times(push, pushed, weight)
        for i in range(joints):
            weight[i, i] += change * change
        factorise(weight, factors[k].factor)
        _transposed_times(pushed, step, feedback[k])
        for j in range(states):
            for i in range(joints):
                column[i] = feedback[k, i, j]
            solve(factors[k].factor, column)
            for i in range(joints):
                feedback[k, i, j] = column[i]
        _times(push, feedback[k], closed)
        for i in range(states):
            for j in range(states):
                closed[i, j] = step[i, j] - closed[i, j]
        _times(cost, closed, carried)
        _transposed_times(step, carried, cost)  # A' P (A - B K)
        for i in range(joints):
            for j in range(joints):
                cost[i, j] += counted[k] * error[point, i, j]
        for i in range(states):
            for j in range(i):
                cost[i, j] = cost[j, i] = 0.5 * (cost[i, j] + cost[j, i])
    return feedback


@kernel
def best_change(a: Array, b: Array, stride: int, feedback: Array, factors: NDArray[np.void], weighted: Array) -> Array:
    """Return the change of the correction, rad, shape (m, n).

    Args:
        a: A, shape (points, 4n, 4n).
        b: B, shape (points, 4n, n).
        stride: set-points from one of them to the next.
        feedback: K of `gains`.
        factors: of `gains`.
        weighted: C' Q e of the last trial, m^2/rad, shape (m, n): 0 where the error does not count.
    """
    count, states, joints = len(weighted), a.shape[1], b.shape[2]
    change, now, then = np.empty((count, joints)), np.zeros((states, 1)), np.zeros((states, 1))
    pushed, drawn = np.empty((joints, 1)), np.empty((states, 1))
    for k in range(count - 1, -1, -1):  # the adjoint
        point = min(k // stride, len(a) - 1)
        _transposed_times(b[point], now, pushed)
        _transposed_times(a[point], now, then)
        _transposed_times(feedback[k], pushed, drawn)
        for i in range(states):
            now[i, 0] = then[i, 0] - drawn[i, 0] + (weighted[k, i] if i < joints else 0.0)
        change[k] = pushed[:, 0]
        solve(factors[k].factor, change[k])
    now[:] = 0.0
    for k in range(count):  # the response
        point = min(k // stride, len(a) - 1)
        _times(feedback[k], now, pushed)
        for i in range(joints):
            change[k, i] -= pushed[i, 0]
            pushed[i, 0] = change[k, i]
        _times(a[point], now, then)
        _times(b[point], pushed, drawn)
        for i in range(states):
            now[i, 0] = then[i, 0] + drawn[i, 0]
    return change


@inlined
def _times(left: Array, right: Array, product: Array) -> None:
    """Write a product; for these sizes faster than a call of BLAS, and the same bits with every BLAS."""
    for i in range(left.shape[0]):
        for j in range(right.shape[1]):
            product[i, j] = 0.0
        for k in range(left.shape[1]):
            share = left[i, k]
            for j in range(right.shape[1]):
                product[i, j] += share * right[k, j]


@inlined
def _transposed_times(left: Array, right: Array, product: Array) -> None:
    """Write the product of a transposed matrix with another."""
    for i in range(left.shape[1]):
        for j in range(right.shape[1]):
            product[i, j] = 0.0
    for k in range(left.shape[0]):
        for i in range(left.shape[1]):
            share = left[k, i]
            for j in range(right.shape[1]):
                product[i, j] += share * right[k, j]
