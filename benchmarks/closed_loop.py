"""Speed of the closed loop on one core, beside MuJoCo, Pinocchio and the same tick as plain loops.

    python -m benchmarks.closed_loop

The task is the reference line at 4 kHz with everything on: coupling, spring, seven LuGre elements, quantised
encoders, saturation, loops at two rates. The peers get the same arm, which is checked, the same set-points and the
same law in plain Python; MuJoCo's bare loop in C gets no law at all. One tick of plant and law, with nothing recorded,
is also measured as plain loops (benchmarks.plain_loops), compiled by numba with the same options. Times are CPU times
of the one thread that works, and all take turns, so that other load on the machine affects all of them.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dposv

from benchmarks.hybrid_reference import Work
from benchmarks.mujoco_lugre import mass_and_bias as mujoco_mass_and_bias
from benchmarks.mujoco_lugre import mujoco_arm
from benchmarks.plain_loops import run_lanes, run_plain
from benchmarks.report import in_turns, merge, print_times, ratios, timed
from rx90_common.arm_dynamics import mass_and_bias
from rx90_common.base.arrays import Array
from rx90_common.description.coupling import RX_WRIST
from rx90_common.friction.parts.part import LINEAR_SPEED
from rx90_emulator.loop.setup import Setup


class PythonDrives:
    """Resolvers with their converters, from joint positions to what the controller measures."""

    def __init__(self, setup: Setup, position: Sequence[float]) -> None:
        drives, rates = setup.drives, setup.rates
        self._gear = drives.gear.tolist()
        self._resolution = np.full(len(self._gear), 2.0 * np.pi / drives.encoder_counts).tolist()
        pole = float(np.exp(-2.0 * np.pi * drives.velocity_bandwidth * rates.period))
        self._period = rates.period
        self._position_gain = 1.0 - pole**2
        self._velocity_gain = (1.0 - pole) ** 2 / rates.period
        self._observer = self._angles(position)
        self.position = self._counts(self._observer)
        self.velocity = [0.0] * 6

    def sample(self, q: Sequence[float]) -> None:
        """Sample the resolvers at joint positions, rad, and move the observer on by a tick."""
        angles = self._angles(q)
        self.position = self._counts(angles)
        for i in range(6):
            predicted = self._observer[i] + self._period * self.velocity[i]
            innovation = angles[i] - predicted
            self._observer[i] = predicted + self._position_gain * innovation
            self.velocity[i] += self._velocity_gain * innovation

    def _angles(self, q: Sequence[float]) -> list[float]:
        turns = [*q[:5], q[4] + q[5]]
        return [gear * turn for gear, turn in zip(self._gear, turns, strict=True)]

    def _counts(self, angles: Sequence[float]) -> list[float]:
        return [
            round(angle / step) * step for angle, step in zip(angles, self._resolution, strict=True)
        ]


class PythonLaw:
    """The six servo controllers of section 5, motor side."""

    def __init__(self, setup: Setup) -> None:
        record = setup.controller.record(setup.robot, setup.drives, setup.rates)[0]
        names = [name for name in record.dtype.names or () if name != "current_gain"]
        self._constants = {name: record[name].tolist() for name in names}
        self._current_gain = float(record["current_gain"])
        self._velocity_reference = [0.0] * 6
        self._integrator = [0.0] * 6
        self._held = [0.0] * 6
        self._current = [0.0] * 6
        self._limited = [0] * 6

    def position_loop(self, setpoint: Sequence[Sequence[float]], position: Sequence[float]) -> None:
        """Run PI and feed-forward for joint set-points, shape (3, 6), and motor positions, rad."""
        c = self._constants
        for i in range(6):
            gear = c["gear"][i]
            if i == 5:
                reference, speed, acceleration = (gear * (row[4] + row[5]) for row in setpoint)
            else:
                reference, speed, acceleration = (gear * row[i] for row in setpoint)
            error = reference - position[i]
            if error * self._limited[i] <= 0.0:
                bound = c["integrator_limit"][i]
                self._integrator[i] = min(
                    bound, max(-bound, self._integrator[i] + c["integral"][i] * error)
                )
            sign = min(1.0, max(-1.0, speed / c["coulomb_velocity"][i]))
            viscous = c["viscous"][i] * math.copysign(abs(speed) ** c["viscous_exponent"][i], speed)
            forward = c["inertia"][i] * acceleration + c["coulomb"][i] * sign + viscous
            self._held[i] = c["proportional"][i] * error + self._integrator[i] + forward
            self._velocity_reference[i] = c["velocity_weight"][i] * speed

    def velocity_loop(self, velocity: Sequence[float]) -> list[float]:
        """Run D and the current loop for motor velocities, rad/s; return motor torques, Nm."""
        c, torques = self._constants, []
        derivative, constant, peaks, steps = (
            c["derivative"],
            c["torque_constant"],
            c["peak_current"],
            c["current_step"],
        )
        for i in range(6):
            damping = derivative[i] * (self._velocity_reference[i] - velocity[i])
            asked = (self._held[i] + damping) / constant[i]
            peak, step = peaks[i], steps[i]
            self._limited[i] = (asked > peak) - (asked < -peak)
            change = self._current_gain * (min(peak, max(-peak, asked)) - self._current[i])
            self._current[i] += min(step, max(-step, change))
            torques.append(constant[i] * self._current[i])
        return torques


_ELEMENT_INPUT = RX_WRIST.element_matrix
"""Input velocities of the friction elements for joint velocities."""


class PinocchioArm:
    """Semi-implicit Euler steps of the arm, the bristles exact for the velocity at the start of a step.

    Attributes:
        q: joint positions, rad.
        v: joint velocities, rad/s.
        z: bristle deflections, rad, shape (7,).
    """

    def __init__(self, setup: Setup, position: ArrayLike) -> None:
        self._model = setup.robot.model
        self._data = self._model.createData()
        # Rotor 6 couples joints 5 and 6, which Pinocchio's armature, a diagonal, and with it aba, cannot say.
        self._rotor = setup.drives.rotor_matrix
        self._spring = setup.drives.spring_torque
        self._to_joint = _ELEMENT_INPUT[[0, 1, 2, 3, 4, 6]].T * setup.drives.gear
        self._period = setup.rates.period
        elements = setup.friction.elements
        self._c0, self._c1, self._c2, self._alpha, self._omega_s, self._omega_d, self._delta = (
            np.array(
                [(e.c0, e.c1, e.c2, e.alpha, e.omega_s, e.omega_d, e.delta) for e in elements]
            ).T
        )
        self._coulomb = np.array([(e.tau_c.positive, e.tau_c.negative) for e in elements]).T
        self._static = np.array([(e.tau_s.positive, e.tau_s.negative) for e in elements]).T
        self.q, self.v, self.z = np.array(position, dtype=np.float64), np.zeros(6), np.zeros(7)

    def mass_and_bias(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return M, its upper triangle alone, shape (6, 6), and h with gravity and spring, shape (6,)."""
        mass = pin.crba(self._model, self._data, q) + self._rotor
        bias = pin.nonLinearEffects(self._model, self._data, q, v)
        bias += self._spring * np.sin(q)
        return mass, bias

    def step(self, motor: Sequence[float]) -> None:
        """Hold motor torques, Nm, for one tick."""
        torque = self._to_joint @ motor - _ELEMENT_INPUT.T @ self._friction(_ELEMENT_INPUT @ self.v)
        mass, bias = self.mass_and_bias(self.q, self.v)
        _, acceleration, _ = dposv(mass, torque - bias)
        self.v += self._period * acceleration
        self.q += self._period * self.v

    def _friction(self, velocity: Array) -> Array:
        """Advance the bristles; return equation 18, Nm, its mean over the step."""
        forward, speed = velocity >= 0, np.abs(velocity)
        coulomb = np.where(forward, self._coulomb[0], self._coulomb[1])
        static = np.where(forward, self._static[0], self._static[1])
        sliding = coulomb + (static - coulomb) * np.exp(-((speed / self._omega_s) ** self._delta))
        # kept from 0, where 0 / 0 would follow
        x = self._c0 * speed / sliding * self._period + 1e-12
        z_dot = velocity - self._c0 * speed / sliding * self.z
        phi = -np.expm1(-x) / x
        advance = self._period * z_dot * phi
        mean = self.z + self._period * z_dot * (1.0 - phi) / x
        self.z = self.z + advance
        damping = self._c1 * np.exp(-((velocity / self._omega_d) ** 2))
        viscous = self._c2 * velocity * np.maximum(speed, LINEAR_SPEED) ** (self._alpha - 1.0)
        return np.asarray(self._c0 * mean + damping * z_dot * phi + viscous)


ROUNDS = 9
PYTHON_TICKS = 4000
C_TICKS = 40_000
LANES, PLAIN = "one tick, lanes", "one tick, plain loops"
MOVING = 1.0
"""From when on the peers run, s: the arm moves there."""


def check_same_arm(setup: Setup, samples: int = 50) -> None:
    """Compare the mass matrix and the bias torques of the three arms at random states.

    Raises:
        RuntimeError: if they differ by more than rounding.
    """
    plant = setup.plant()
    model = mujoco_arm(setup)
    data, pinocchio = mujoco.MjData(model), PinocchioArm(setup, np.zeros(6))
    rng = np.random.default_rng(1)
    for _ in range(samples):
        q = rng.uniform(setup.robot.lower, setup.robot.upper)
        v = rng.uniform(-1.0, 1.0, 6) * setup.robot.max_velocity
        ours = np.empty((6, 6)), np.empty(6)
        mass_and_bias(plant.constants[0]["arm"], plant.state[0]["body"], q, v, *ours)
        peers = {
            "MuJoCo": mujoco_mass_and_bias(model, data, q, v),
            "Pinocchio": pinocchio.mass_and_bias(q, v),
        }
        for name, theirs in peers.items():
            for what, a, b in zip(("mass matrix", "bias"), ours, theirs, strict=True):
                miss = np.abs(np.triu(a - b)).max()
                if not miss < 1e-9 * np.abs(a).max():
                    raise RuntimeError(
                        f"the arm in {name} is another: its {what} is off by {miss:g}"
                    )


class Ticks:
    """Plant and law over the whole line, with lanes or as plain loops, and nothing around them."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._setpoints = work.setpoints(0.0, round(work.duration * work.setup.rates.base_hz))

    def run(self, kernel: Callable[..., None]) -> tuple[float, Array]:
        """Run one of both kernels; return s per tick and the joint positions on position ticks, rad, shape (m, 6)."""
        plant, controller = self._work.setup.plant(), self._work.setup.cs7b()
        plant.reset(self._work.start)
        controller.reset(plant.motor_states()[0])
        ratio, q = self._work.setup.rates.ratio, np.empty((len(self._setpoints), 6))
        began = time.process_time()
        kernel(
            plant.constants,
            plant.state,
            controller.law,
            controller.state,
            self._setpoints,
            ratio,
            q,
        )
        return (time.process_time() - began) / (len(q) * ratio), q

    def check(self, accepted: float = 5e-7) -> None:
        """Compare both paths; rounding may move the moment at which a position counts.

        Raises:
            RuntimeError: if they part by more than `accepted`, rad.
        """
        miss = np.abs(self.run(run_lanes)[1] - self.run(run_plain)[1]).max()
        if not miss < accepted:
            raise RuntimeError(
                f"the plain loops move another way: {miss:g} rad off; accepted: below {accepted:g}"
            )


def run_with_python_law(
    work: Work,
    setpoints: Array,
    position: Callable[[], Sequence[float]],
    step: Callable[[list[float]], None],
) -> float:
    """Run a peer under the law in plain Python; return s per tick."""
    ratio = work.setup.rates.ratio
    rows = setpoints.tolist()
    drives, law = PythonDrives(work.setup, position()), PythonLaw(work.setup)
    began = time.process_time()
    for tick in range(len(rows) * ratio):
        if tick % ratio == 0:
            law.position_loop(rows[tick // ratio], drives.position)
        step(law.velocity_loop(drives.velocity))
        drives.sample(position())
    return (time.process_time() - began) / (len(rows) * ratio)


class MujocoPeers:
    """MuJoCo's arm, moving as the set-points do where they begin."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._setpoints = work.setpoints(MOVING, PYTHON_TICKS)
        self._model = mujoco_arm(work.setup)
        self._data = mujoco.MjData(self._model)

    def from_python(self) -> float:
        """Step it from Python under the law; return s per tick."""
        model, data = self._model, self._data
        self._reset()
        control = data.ctrl

        def step(torques: list[float]) -> None:
            control[:6] = torques
            mujoco.mj_step(model, data)

        seconds = run_with_python_law(self._work, self._setpoints, data.qpos.tolist, step)
        _check_tracking("MuJoCo", data.qpos, self._setpoints)
        return seconds

    def bare(self) -> float:
        """Run its own loop in C under constant torques; return s per tick."""
        self._reset()
        began = time.process_time()
        mujoco.mj_step(self._model, self._data, nstep=C_TICKS)
        return (time.process_time() - began) / C_TICKS

    def _reset(self) -> None:
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:], self._data.qvel[:] = self._setpoints[0, 0], self._setpoints[0, 1]


class PinocchioPeer:
    """Pinocchio's arm, moving as the set-points do where they begin."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._setpoints = work.setpoints(MOVING, PYTHON_TICKS)

    def from_python(self) -> float:
        """Step it from Python under the law; return s per tick."""
        arm = PinocchioArm(self._work.setup, self._setpoints[0, 0])
        arm.v[:] = self._setpoints[0, 1]
        seconds = run_with_python_law(self._work, self._setpoints, arm.q.tolist, arm.step)
        _check_tracking("Pinocchio", arm.q, self._setpoints)
        return seconds


def _check_tracking(name: str, q: Array, setpoints: Array) -> None:
    miss = np.abs(q - setpoints[-1, 0]).max()
    if not miss < 2e-3:
        raise RuntimeError(
            f"{name} does not follow the line: {miss:g} rad off; accepted: below 0.002"
        )


def measure(rounds: int = ROUNDS) -> dict[str, list[float]]:
    """Return the times per tick of all rounds, s, by who ran."""
    work = Work.load()
    check_same_arm(work.setup)
    ticks = Ticks(work)
    ticks.check()
    peers, pinocchio = MujocoPeers(work), PinocchioPeer(work)
    runs = {
        "this project": timed(work.run, work.duration * work.setup.rates.base_hz),
        "MuJoCo from Python": peers.from_python,
        "MuJoCo, bare C loop": peers.bare,
        "Pinocchio from Python": pinocchio.from_python,
        LANES: lambda: ticks.run(run_lanes)[0],
        PLAIN: lambda: ticks.run(run_plain)[0],
    }
    return in_turns(runs, rounds)


def main() -> int:
    """Measure, print the table and merge the figures."""
    times = measure()
    period = Setup.load().rates.period
    ratio = ratios(times, "this project")
    median = print_times("closed loop at 4 kHz", times, "this project", period)
    merge(
        {
            "closed_loop_real_time_factor": period / median["this project"],
            "closed_loop_us_per_tick": median["this project"] * 1e6,
            "versus_mujoco_python": ratio["MuJoCo from Python"],
            "versus_mujoco_c": ratio["MuJoCo, bare C loop"],
            "tick_lanes_us": median[LANES] * 1e6,
            "tick_plain_loops_us": median[PLAIN] * 1e6,
            "versus_plain_loops": ratios(times, LANES)[PLAIN],
        }
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
