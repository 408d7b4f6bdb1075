"""The auxiliary simulation of instrumental variables: the identified arm follows what the real one was told to.

Its motion is like the recorded one and has nothing of its noise. The simulated controller is a stated one, for nobody
knows the real one: it compensates weight and velocity terms exactly, and answers an error of position e and velocity
de/dt with the acceleration omega^2 e + 2 omega de/dt. Friction it does not compensate, as in the real loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.signal import bilinear, butter, lfilter, sosfiltfilt

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.excitation.problem import ExcitationProblem, Motion

_STEP = 2e-3  # s, at most
_AT_REST = 1e-3  # rad/s: below, friction is taken as proportional to the velocity
_LOOPS = (3.0, 5.0, 8.0, 12.0, 20.0, 30.0, 50.0)  # Hz, of the controllers that are tried
_SMOOTH = 0.25  # bandwidth of a path that stands in for set-points, over that of the torque
_FASTEST = 1e3  # rad/s: no arm is
_LEAST_MASS = 1e-6  # kg, of a link of the simulated arm: its other parameters are divided by it

Friction = Callable[[Array], Array]
"""Torque of each element at the elements' velocities, both of shape (n_el,)."""


@dataclass(frozen=True, eq=False)
class Controller:
    """What the simulated arm follows, and how.

    Attributes:
        bandwidth: omega / 2 pi, Hz.
        targets: of each run, positions, rad, shape (m, n).
        recorded: whether all targets are recorded set-points; else measured paths stand in.
    """

    bandwidth: float
    targets: tuple[Array, ...]
    recorded: bool

    @classmethod
    def of(cls, runs: Sequence[FilteredRun]) -> Controller:
        """Take the recorded set-points, where all runs have them, and the bandwidth that leads nearest to the path.

        Without set-points the measured path, low-passed at a quarter of the torque's bandwidth, stands in: most of the
        noise of velocities and accelerations lies above.
        """
        known = [run.reference for run in runs if run.reference is not None]
        recorded = len(known) == len(runs)
        targets = tuple(known) if recorded else tuple(_smooth(run) for run in runs)
        misses = [
            sum(float(np.sum((_followed(target, run.rate, loop) - run.position) ** 2)) for run, target in pairs)
            for loop in _LOOPS
            for pairs in [list(zip(runs, targets, strict=True))]
        ]
        return cls(_LOOPS[int(np.argmin(misses))], targets, recorded)

    def __str__(self) -> str:
        """Return what is followed, and how, in words."""
        what = "the recorded set-points" if self.recorded else "the measured path, low-passed (no set-points)"
        return f"the simulated arm follows {what} with a bandwidth of {self.bandwidth:g} Hz"


def _smooth(run: FilteredRun) -> Array:
    sections = butter(4, _SMOOTH * run.bandwidths.torque, fs=run.rate, output="sos")
    return np.asarray(sosfiltfilt(sections, run.position, axis=0))


def _followed(target: Array, rate: float, loop: float) -> Array:
    """Return the path of an arm without friction."""
    omega = 2.0 * math.pi * loop
    top, bottom = bilinear([2.0 * omega, omega**2], [1.0, 2.0 * omega, omega**2], rate)
    return np.asarray(lfilter(top, bottom, target - target[0], axis=0) + target[0])


def ideal_motions(problem: ExcitationProblem, controller: Controller) -> list[Motion]:
    """Return the motion of an arm without friction in each run, which needs no parameters: a start."""
    result = []
    for run, target in zip(problem.runs, controller.targets, strict=True):
        path = _followed(target, run.rate, controller.bandwidth)
        velocity = np.gradient(path, run.time, axis=0)
        result.append((path, velocity, np.gradient(velocity, run.time, axis=0)))
    return result


def simulated_motions(
    problem: ExcitationProblem, parameters: Array, friction: Friction, controller: Controller
) -> list[Motion]:
    """Return the motion of the simulated arm in each run, at the run's samples.

    Args:
        problem: with the arm and the runs.
        parameters: of the base, shape (b,).
        friction: of the elements.
        controller: of the simulation.

    Raises:
        IdentificationError: if the simulation diverges, as with inertias that no arm has.
    """
    model, rotor = _arm(problem, parameters)
    elements = problem.arm.element_matrix
    return [
        _simulated(model, rotor, elements, friction, (target, run, controller.bandwidth))
        for run, target in zip(problem.runs, controller.targets, strict=True)
    ]


def _arm(problem: ExcitationProblem, parameters: Array) -> tuple[Any, Array]:
    """Return a model that moves as the base parameters say, and the rotors' share of its mass matrix.

    Standard parameters are those of the description, the leading ones of each group corrected such that the group has
    the identified value. Single links need not be possible; the mass matrix is that of the base parameters.
    """
    base, n = problem.base, len(problem.arm.names)
    standard = problem.columns.values()
    standard[list(base.leading)] += parameters - base.combination @ standard
    model = problem.arm.model.copy()
    for k, values in enumerate(standard[: 10 * n].reshape(n, 10), 1):
        values[0] = max(values[0], _LEAST_MASS)
        model.inertias[k] = pin.Inertia.FromDynamicParameters(values)
    turns = problem.arm.coupling
    return model, turns.T @ np.diag(standard[10 * n : 11 * n]) @ turns


def _simulated(
    model: Any, rotor: Array, elements: Array, friction: Friction, task: tuple[Array, FilteredRun, float]
) -> Motion:
    """Return position, velocity and acceleration of one run.

    The step is implicit in friction and control, so that neither limits it:
    M ((1 + 2 w h + w^2 h^2) v' - v - h (w^2 (q_r - q) + 2 w v_r)) = -h E^T D E v', D the friction over the velocity.
    """
    target, run, bandwidth = task
    omega = 2.0 * math.pi * bandwidth
    count = math.ceil((run.time[-1] - run.time[0]) / _STEP)
    grid = np.linspace(run.time[0], run.time[-1], count + 1)
    h = float(grid[1] - grid[0])
    path = np.column_stack([np.interp(grid, run.time, column) for column in target.T])
    speed = np.gradient(path, h, axis=0)
    stiff = 1.0 + 2.0 * omega * h + (omega * h) ** 2
    data = model.createData()
    q, v = path[0].copy(), speed[0].copy()
    result = np.zeros((3, count + 1, len(q)))
    result[0, 0], result[1, 0] = q, v
    for k in range(1, count + 1):
        mass = _mass(model, data, q) + rotor
        inputs = elements @ v
        inputs = np.where(np.abs(inputs) < _AT_REST, np.where(inputs < 0.0, -_AT_REST, _AT_REST), inputs)
        damping = (elements.T * (friction(inputs) / inputs)) @ elements
        wanted = v + h * (omega**2 * (path[k] - q) + 2.0 * omega * speed[k])
        after = np.linalg.solve(stiff * mass + h * damping, mass @ wanted)
        if not np.abs(after).max() < _FASTEST:
            raise IdentificationError("the simulation of the identified arm diverges; accepted: positive inertias")
        q = q + h * after
        result[:, k] = q, after, (after - v) / h
        v = after
    at_samples = [np.column_stack([np.interp(run.time, grid, c) for c in values.T]) for values in result]
    return at_samples[0], at_samples[1], at_samples[2]


def _mass(model: Any, data: Any, position: Array) -> Array:
    """Return the links' mass matrix."""
    place = position if model.nq == model.nv else pin.integrate(model, pin.neutral(model), position)
    upper = np.triu(pin.crba(model, data, place))
    return np.asarray(upper + np.triu(upper, 1).T)
