"""Norm-optimal learning.

The method uses the linear response of the joints to offsets of the position set-points along a motion. The
deviations dq of the arm from its nominal motion are linear in the offsets c: a linear time-varying
model, with M0, C0 and K0 along the motion, and around it the CS7B's PI on the position, D on the
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

It learns from the joints' errors by the encoders, or from the error of a measured tip, which the Jacobian of the path
relates to the joints.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.description.kinematics import jacobian
from rx90_emulator.correction.path import TrajectoryPath
from rx90_emulator.loop.setup import Setup

SPACING = 0.01
"""From one point of the linearisation to the next, s."""
LEAD_IN = 0.3
"""Time before the path from which errors count, s, gradually: so the error at rest is corrected when the path
begins."""
_JOINTS = 0.005  # m/rad: weight of a joint's own error, with encoders; it also preserves the tool's orientation
_LARGEST_EFFORT = 1e3  # m/rad

Update: TypeAlias = Callable[[Array, Array, float], Array]
"""Returns the next offsets for offsets, rad, (n, joints), their error, and a share of the gain. The error is that of
the joints by the encoders, rad, (n, joints), or that of the tip, m, (n, 3)."""


class Linearisation(NamedTuple):
    """Derivatives of the inverse dynamics M a + h along a motion; h holds Coriolis, centrifugal and gravity torques.

    Attributes:
        mass: M0 = M(q0), rotors included, kg m^2, shape (n, joints, joints).
        damping: C0 = dh/dv, Nm s/rad, shape (n, joints, joints).
        stiffness: K0 = d(M a0 + h)/dq, gravity and spring included, Nm/rad, shape (n, joints, joints).
    """

    mass: Array
    damping: Array
    stiffness: Array


def linearise(setup: Setup, setpoints: Array) -> Linearisation:
    """Return M0, C0 and K0 at n points of a motion.

    Args:
        setup: the arm.
        setpoints: position rad, velocity rad/s, acceleration rad/s^2, shape (n, 3, joints).
    """
    model = setup.robot.model
    data = model.createData()
    count, _, joints = setpoints.shape
    mass = np.empty((count, joints, joints))
    damping = np.empty_like(mass)
    stiffness = np.empty_like(mass)
    for n, state in enumerate(setpoints):
        by_position, by_velocity, by_acceleration = pin.computeRNEADerivatives(model, data, *state)
        upper = np.triu(by_acceleration)
        mass[n] = upper + np.triu(upper, 1).T
        damping[n] = by_velocity
        stiffness[n] = by_position
    # The rotors' inertia is the same in every pose, so it adds to M0 alone; the spring gives k cos(q) to K0.
    mass += setup.drives.rotor_matrix
    diagonal = np.arange(joints)
    stiffness[:, diagonal, diagonal] += setup.drives.spring_torque * np.cos(setpoints[:, 0])
    return Linearisation(mass, damping, stiffness)


@dataclass(frozen=True)
class NormOptimal:
    """The method.

    Attributes:
        effort: weight of a change of the correction, relative to an error of a metre at the tip, m/rad. A smaller one
            learns faster and up to higher frequencies, relies more on the model, and transmits more noise.

    Raises:
        ConfigError: naming the value and what is accepted.
    """

    effort: float = 0.1

    def __post_init__(self) -> None:
        if not 0.0 < self.effort <= _LARGEST_EFFORT:
            raise ConfigError(
                f"effort is {self.effort:g} m/rad; accepted: a number > 0, up to {_LARGEST_EFFORT:g}"
            )

    def prepare(self, setup: Setup, nominal: TrajectoryPath, *, tip: bool) -> Update:
        """Return the update along a motion, from the error of the tip or from those of the encoders."""
        a, b, stride = response(setup, nominal.setpoints)
        slopes = jacobian(setup.robot.chain, nominal.setpoints[::stride, 0])
        by_tip = np.swapaxes(slopes[:, :3], 1, 2)
        weight = by_tip @ slopes[:, :3] + (0.0 if tip else _JOINTS**2) * np.eye(slopes.shape[2])
        counted = lead_in(nominal)
        point = np.arange(len(nominal.counts)) // stride
        feedback, inverse = gains(a, b, stride, weight, self.effort, counted)
        towards = (by_tip if tip else weight)[point] * counted[:, None, None]

        def update(offsets: Array, error: Array, share: float) -> Array:
            weighted = np.einsum("nij,nj->ni", towards, error)
            return offsets + share * best_change(a, b, stride, feedback, inverse, weighted)

        return update


def lead_in(nominal: TrajectoryPath) -> Array:
    """Return the weights of the errors of set-points, 0 to 1, shape (n,)."""
    counts = nominal.counts.astype(np.float64)
    begin = int(np.argmax(nominal.counts))
    rows = min(round(LEAD_IN / nominal.period), begin)
    counts[begin - rows : begin] = np.arange(rows) / max(rows, 1)
    return counts


def response(setup: Setup, setpoints: Array) -> tuple[Array, Array, int]:
    """Return A, shape (points, 4n, 4n), B, shape (points, 4n, n), and the number of set-points that each is valid for.

    The states are deviations of the joints and their velocities, integrators, and torques of the drives.

    Args:
        setup: robot, drives, friction, controller, rates.
        setpoints: of the nominal motion, shape (m, 3, n).
    """
    controller = setup.controller
    servo = controller.servo
    period = setup.rates.position_period
    stride = max(1, round(SPACING / period))
    linear = linearise(setup, setpoints[::stride])
    turns = setup.drives.turning.turns
    elements = setup.drives.turning.element_matrix
    joints = setpoints.shape[2]
    viscous = elements.T @ np.diag([element.c2 for element in setup.friction.elements]) @ elements
    # The velocity observer, critically damped, lags by twice its time constant; a set-point is constant for its period.
    lag = (1.0 / controller.current_loop.bandwidth + 2.0 / setup.drives.velocity_bandwidth) / (
        2.0 * math.pi
    )
    lag += 0.5 * setup.rates.period
    proportional = np.diag(controller.inertia * np.multiply(servo.kv, servo.kp)) @ turns
    derivative = np.diag(controller.inertia * servo.kv) @ turns
    integral = np.diag(controller.inertia * servo.ki) @ turns
    inverse = np.linalg.inv(linear.mass)
    q, v, i, tau, c = (slice(k, k + joints) for k in range(0, 5 * joints, joints))
    one = np.eye(joints)
    # of the states, and of the offsets, which are constant
    rates = np.zeros((len(inverse), 5 * joints, 5 * joints))
    rates[:, q, v] = one
    rates[:, v, q] = -inverse @ linear.stiffness
    rates[:, v, v] = -inverse @ (linear.damping + viscous)
    rates[:, v, tau] = inverse @ turns.T
    rates[:, i, q] = -integral
    rates[:, i, c] = integral
    rates[:, tau, q] = -proportional / lag
    rates[:, tau, c] = proportional / lag
    rates[:, tau, v] = -derivative / lag
    rates[:, tau, i] = one / lag
    rates[:, tau, tau] = -one / lag
    from scipy.linalg import expm  # takes a while

    step = expm(rates * period)
    states = slice(4 * joints)
    return step[:, states, states], step[:, states, c], stride


def gains(
    a: Array, b: Array, stride: int, error: Array, change: float, counted: Array
) -> tuple[Array, Array]:
    """Return the feedback K, shape (m, n, 4n), and the inverses of R + B' P B, shape (m, n, n): the Riccati recursion.

    Args:
        a: A, shape (points, 4n, 4n).
        b: B, shape (points, 4n, n).
        stride: set-points from one of them to the next.
        error: Q of the joints, m^2/rad^2, shape (points, n, n).
        change: square root of R, m/rad.
        counted: weight of the error of a set-point, 0 to 1, shape (m,).
    """
    count = len(counted)
    joints = b.shape[2]
    feedback = np.empty((count, joints, a.shape[1]))
    inverse = np.empty((count, joints, joints))
    effort = change**2 * np.eye(joints)  # R
    cost = np.zeros(a.shape[1:])
    for k in reversed(range(count)):
        point = min(k // stride, len(a) - 1)
        step = a[point]
        push = b[point]
        pushed = cost @ push  # P B
        inverse[k] = np.linalg.inv(push.T @ pushed + effort)
        feedback[k] = inverse[k] @ (pushed.T @ step)
        cost = step.T @ (cost @ (step - push @ feedback[k]))  # A' P (A - B K)
        cost[:joints, :joints] += counted[k] * error[point]
        cost = 0.5 * (cost + cost.T)
    return feedback, inverse


def best_change(
    a: Array, b: Array, stride: int, feedback: Array, inverse: Array, weighted: Array
) -> Array:
    """Return the change of the correction, rad, shape (m, n).

    Args:
        a: A, shape (points, 4n, 4n).
        b: B, shape (points, 4n, n).
        stride: set-points from one of them to the next.
        feedback: K of `gains`.
        inverse: of `gains`.
        weighted: C' Q e of the last trial, m^2/rad, shape (m, n): 0 where the error does not count.
    """
    count, joints = weighted.shape
    change = np.empty((count, joints))
    state = np.zeros(a.shape[1])
    for k in reversed(range(count)):  # the adjoint
        point = min(k // stride, len(a) - 1)
        pushed = b[point].T @ state
        state = a[point].T @ state - feedback[k].T @ pushed
        state[:joints] += weighted[k]
        change[k] = inverse[k] @ pushed
    state = np.zeros(a.shape[1])
    for k in range(count):  # the response
        point = min(k // stride, len(a) - 1)
        change[k] -= feedback[k] @ state
        state = a[point] @ state + b[point] @ change[k]
    return change
