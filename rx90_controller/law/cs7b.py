"""The one control law, compiled, and the controller around it: measured motor states in, motor torques out.

The law is SISO servo controllers, one for each motor, as in section 5 and figure 4 of the paper. Blocks of the paper:
PI on the position error and FF from the set-points at the position rate, D on the measured velocity and C, the current
loop with its amplifier, at the base rate. All quantities are on the motor side, because each controller serves one
motor. Motors are lanes. The drives' supervision compares following errors and speeds
of the joints with their limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array, Record, record_type
from rx90_common.base.rates import Rates
from rx90_common.description.coupling import (
    ArmSize,
    joints_as_motors_have_them,
    to_joint,
    to_joint_torque,
    to_motor,
)
from rx90_common.description.drives import DriveParameters
from rx90_common.description.robot import RobotModel
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.elementary import signed_power
from rx90_common.kernels.lanes import Lanes, absolute, any_lane, load, select, size, store
from rx90_controller.law.model import (
    FRESH,
    add_model_torque,
    begin_parts,
    cool_model,
    hand_over,
    model_state_dtype,
)
from rx90_controller.law.parameters import CS7BParameters
from rx90_controller.trajectory import TrajectoryGenerator

_LARGEST = float(np.finfo(np.float64).max)


@cache
def law_state_dtype(arm: ArmSize) -> np.dtype[np.void]:
    """Return the type of the state of a control law."""
    n = arm.joints
    return record_type(
        model=model_state_dtype(arm),
        reference=(3, n),  # motor-side position, velocity, acceleration set-points
        offset=n,  # of the position set-point, motor side, rad; workspace
        error=n,  # position error at the last position tick
        velocity_error=n,
        integrator=n,
        position_torque=n,  # PI block, held between position ticks
        feed_forward=n,  # FF block, held between position ticks
        commanded=n,  # current commanded to the amplifier, within its limit, A
        current=n,
        command=n,  # torque constant times current
        limited=n,  # sign of the amplifier's saturation in the last tick, 0 if none
        saturated=n,  # ticks in saturation
    )


@inlined
def clip(x: Lanes, bound: Lanes) -> Lanes:
    """Return x limited to +-bound; NaN stays NaN."""
    return select(x > bound, bound, select(x < -bound, -bound, x))


@inlined
def _beyond_limits(law: Any, error: Lanes, velocity: Lanes) -> bool:
    """Return whether a joint is beyond a limit, or NaN, by position errors and velocities of the motors."""
    following = joints_as_motors_have_them(law.gear, error)
    speed = joints_as_motors_have_them(law.gear, velocity)
    n = size(law.over_speed)
    # The comparisons are false for NaN too.
    fast = select(absolute(speed) <= load(law.over_speed, n), 0.0, 1.0)
    return any_lane(select(absolute(following) <= load(law.following_error, n), fast, 1.0) > 0.0)


@kernel
def law_reset(states: Record) -> None:
    """Begin anew: as `law_release`, and the joints of the model are as warm as its file has them at the start."""
    law_release(states)
    states[0].model.friction.warm = 0


@kernel
def law_release(states: Record) -> None:
    """Set integrators, currents and errors to zero; the next position tick does so with the model's bristles."""
    state = states[0]
    state.integrator[:] = state.position_torque[:] = state.feed_forward[:] = 0.0
    state.error[:] = state.velocity_error[:] = 0.0
    state.commanded[:] = state.current[:] = state.command[:] = 0.0
    state.limited[:] = state.saturated[:] = 0
    state.reference[:] = 0.0
    state.model.parts = FRESH


@kernel
def position_loop(
    laws: Record, states: Record, setpoint: Array, position: Array, velocity: Array
) -> bool:
    """Run PI, FF, with the torque of a model of arm and friction, and the supervision for one position tick.

    Args:
        laws: constants, shape (1,), of `controller_dtype`.
        states: state, shape (1,), of `law_state_dtype`, advanced in place.
        setpoint: joint position rad, velocity rad/s, acceleration rad/s^2, shape (3, n); with a fourth row, an offset
            of the position, rad, that only PI sees.
        position: motor positions by the encoders, rad, shape (n,).
        velocity: measured motor velocities, rad/s, shape (n,); for the supervision and the velocity error that is
            published.

    Returns:
        Whether the following error or the speed of a joint is beyond its limit: the drives are to be switched off.
    """
    law = laws[0]
    state = states[0]
    other_parts = law.model.parts != state.model.parts
    if other_parts:
        begin_parts(state)
    for k in range(3):
        to_motor(law.gear, setpoint[k], state.reference[k])
    n = size(state.error)
    requested = load(state.reference[0], n)
    if setpoint.shape[0] > 3:
        to_motor(law.gear, setpoint[3], state.offset)
        offset = load(state.offset, n)
        # none leaves the bits, also those of -0
        requested = select(offset == 0.0, requested, requested + offset)
    error = requested - load(position, n)
    integrator = load(state.integrator, n)
    # Anti-windup: no integration further into the amplifier's saturation.
    advanced = clip(integrator + load(law.integral, n) * error, load(law.integrator_limit, n))
    integrator = select(error * load(state.limited, n) <= 0.0, advanced, integrator)
    speed = load(state.reference[1], n)
    # The sign function, made continuous: a set-point that crosses zero must not switch the torque back and forth.
    sign = clip(speed / load(law.coulomb_velocity, n), 1.0)
    viscous = load(law.viscous, n) * signed_power(speed, load(law.viscous_exponent, n))
    inertial = load(law.inertia, n) * load(state.reference[2], n)
    measured = load(velocity, n)
    store(state.error, error)
    store(state.velocity_error, speed - measured)
    store(state.integrator, integrator)
    store(state.position_torque, load(law.proportional, n) * error + integrator)
    store(state.feed_forward, inertial + load(law.coulomb, n) * sign + viscous)
    if law.model.parts != 0:
        add_model_torque(law, state, setpoint)
    if other_parts:
        hand_over(law, state)
    return _beyond_limits(law, error, measured)


@kernel
def velocity_loop(laws: Record, states: Record, velocity: Array) -> bool:
    """Run D and C for one base tick and write `command`, motor torques in Nm, into the state.

    D's damping, the amplifier's limit, and C, the current loop of first order with limited slew.

    Args:
        laws: constants, shape (1,), of `controller_dtype`.
        states: state, shape (1,), of `law_state_dtype`, advanced in place.
        velocity: measured motor velocities, rad/s, shape (n,).

    Returns:
        Whether a torque is not finite: the drives are to be switched off.
    """
    law = laws[0]
    state = states[0]
    n = size(state.current)
    weighted = load(law.velocity_weight, n) * load(state.reference[1], n)
    damping = load(law.derivative, n) * (weighted - load(velocity, n))
    peak = load(law.peak_current, n)
    constant = load(law.torque_constant, n)
    requested = (load(state.position_torque, n) + load(state.feed_forward, n) + damping) / constant
    limited = select(requested > peak, 1.0, select(requested < -peak, -1.0, 0.0 * requested))
    commanded = clip(requested, peak)
    current = load(state.current, n)
    current = current + clip(law.current_gain * (commanded - current), load(law.current_step, n))
    command = constant * current
    store(state.commanded, commanded)
    store(state.current, current)
    store(state.command, command)
    store(state.limited, limited)
    store(state.saturated, load(state.saturated, n) + limited * limited)
    return any_lane(select(absolute(command) <= _LARGEST, 0.0, 1.0) > 0.0)


@kernel
def joints_of(laws: Record, motor: Array, joint: Array) -> None:
    """Write positions (or velocities, or errors) of the joints for those of the motors, shape (n,)."""
    to_joint(laws[0].gear, motor, joint)


@kernel
def joint_torques_of(laws: Record, motor: Array, joint: Array) -> None:
    """Write the joint torques that motor torques make, Nm, shape (n,)."""
    to_joint_torque(laws[0].gear, motor, joint)


_LOOKAHEAD = 64  # set-points that are sampled at once


class DriveFault(NamedTuple):
    """Why the supervision cut the power.

    Attributes:
        joint: name of the joint.
        quantity: "following error", "speed" or "torque".
        value: of it, in `unit`.
        limit: the most that is accepted; infinite for a torque, which has to be finite.
        unit: "rad", "rad/s" or "Nm".
        time: of the measurement, s.
    """

    joint: str
    quantity: str
    value: float
    limit: float
    unit: str
    time: float

    @classmethod
    def of(cls, names: Sequence[str], laws: Record, states: Record, time: float) -> DriveFault:
        """Return the largest violation after a position loop that found one at `time`, s."""
        law = laws[0]
        state = states[0]
        gear = law["gear"]["ratio"] if law["gear"].dtype.names else law["gear"]
        limits = np.array([law["following_error"], law["over_speed"]]) / np.abs(gear)
        motors = np.array([state["error"], state["reference"][1] - state["velocity_error"]])
        values = np.empty_like(motors)
        for row in range(2):
            joints_of(laws, motors[row], values[row])
        share = np.nan_to_num(np.abs(values) / limits, nan=np.inf)
        row, joint = divmod(int(share.argmax()), len(names))
        quantity, unit = (("following error", "rad"), ("speed", "rad/s"))[row]
        value = float(values[row, joint])
        return cls(names[joint], quantity, value, float(limits[row, joint]), unit, time)

    def __str__(self) -> str:
        """Return it as one line with the value and the limit."""
        accepted = (
            f"up to {self.limit:.4g} {self.unit}" if self.limit < np.inf else "finite torques"
        )
        return f"{self.joint}: {self.quantity} {self.value:.4g} {self.unit} at {self.time:.6g} s; accepted: {accepted}"


class CS7B:
    """Servo controllers, one for each motor, behind one trajectory generator.

    Attributes:
        joint_names: names of the joints.
        tick: number of the next base tick.
        trajectory: the set-point generator.
        law: compiled constants, shape (1,), of `controller_dtype`; may be written to between two ticks.
        state: compiled state, shape (1,), of `law_state_dtype`.
        command: motor torques of the last step, Nm, shape (n,); always the same view of the state.
        setpoint: that of the last position tick: position rad, velocity rad/s, acceleration rad/s^2, shape (3, n).
        offset: of the position set-point by a correction, rad, shape (n,); None without a correction.
        fault: the violation that the supervision has found since the last reset, or None; the owner then switches off.
    """

    def __init__(
        self, robot: RobotModel, drives: DriveParameters, parameters: CS7BParameters, rates: Rates
    ) -> None:
        self.joint_names = robot.joint_names
        self.rates = rates
        self.law = parameters.record(robot, drives, rates)
        self.state: Record = np.zeros(1, law_state_dtype(drives.turning.size))
        self._joints = n = len(robot.joint_names)
        self.trajectory = TrajectoryGenerator(
            parameters.limits(robot), rates.position_period, np.zeros(n)
        )
        self.tick = 0
        # Set-points ahead, from a position tick on, of a revision of the generator.
        self._ahead = np.zeros((0, 3, n))
        self._ahead_from = 0
        self._ahead_revision = self.trajectory.revision
        # Fixed memory: the messages of every tick are read from there.
        self._reference = np.zeros((3, n))
        self._error = np.zeros((3, n))
        self._details = np.zeros((3, n))
        self.command: Array = self.state["command"][0]
        self.setpoint = np.zeros((3, n))
        self.offset: Array | None = None
        self._measured: tuple[Array, Array, Array | None] = (np.zeros(n), np.zeros(n), None)
        self._currents_err = drives.current_sensor.used
        self.fault: DriveFault | None = None

    def reset(self, position: Array, tick: int = 0) -> None:
        """Begin anew: hold the measured motor positions, rad, shape (n,), from base tick `tick` on."""
        law_reset(self.state)
        self._hold(position, tick)

    def release(self, position: Array, tick: int) -> None:
        """Let the motion end without torque and hold the positions from a later tick on; the model's joints cool."""
        law_release(self.state)
        before = self.position_tick
        self._hold(position, tick)
        cool_model(self.law, self.state, self.position_tick - before)

    def _hold(self, position: Array, tick: int) -> None:
        self.fault = None
        hold = np.empty(self._joints)
        joints_of(self.law, np.ascontiguousarray(position), hold)
        self.trajectory.reset(hold)
        self.tick = tick

    def skip(self, count: int) -> None:
        """Let `count` ticks of the position loop pass without set-points: a running trajectory comes later."""
        cool_model(self.law, self.state, count)
        self.tick += count * self.rates.ratio
        self.trajectory.delay(count, self.position_tick)

    def warm_up(self) -> None:
        """Compile, or load, every kernel that a run calls, and discharge the controller."""
        rest = np.zeros(self._joints)
        self.reset(rest)
        for _ in range(self.rates.ratio + 1):
            self.step(rest, rest)
        self.reference()
        self.tracking_error()
        self.details()
        self.trajectory.warm_up()
        self.release(rest, self.tick)
        self.reset(rest)

    @property
    def position_tick(self) -> int:
        """Return the number of the next tick of the position loop."""
        return -(-self.tick // self.rates.ratio)

    @property
    def on_position_tick(self) -> bool:
        """Return whether the next base tick runs the position loop."""
        return self.tick % self.rates.ratio == 0

    def step(self, position: Array, velocity: Array, torque: Array | None = None) -> Array:
        """Run the loops that are due in this tick; return `command`: motor torques, torque constant times current.

        Args:
            position: motor positions by the encoders, rad, shape (n,).
            velocity: measured motor velocities, rad/s, shape (n,).
            torque: reported by the drives, Nm, shape (n,), if they report it; for `details` alone.
        """
        tick, slow = divmod(self.tick, self.rates.ratio)
        if slow == 0:
            row = tick - self._ahead_from
            revision = self.trajectory.revision
            if self._ahead_revision != revision or not 0 <= row < len(self._ahead):
                self._ahead = self.trajectory.corrected(tick, _LOOKAHEAD)
                self._ahead_from = tick
                self._ahead_revision = revision
                row = 0
            corrected = self._ahead[row]
            self.setpoint = corrected[:3]
            self.offset = corrected[3] if len(corrected) > 3 else None
            self._measured = (position, velocity, torque)
            self._reference[:2], self._details[0] = self.setpoint[:2], self.setpoint[2]
            if position_loop(self.law, self.state, corrected, position, velocity):
                self.note_fault()
        if velocity_loop(self.law, self.state, velocity) and self.fault is None:
            motor = int(np.argmin(np.isfinite(self.command)))
            time = self.tick * self.rates.period
            self.fault = DriveFault(
                self.joint_names[motor], "torque", float(self.command[motor]), np.inf, "Nm", time
            )
        self.tick += 1
        return self.command

    def note_fault(self) -> None:
        """Keep the first fault, found by the supervision in the present tick."""
        if self.fault is None:
            self.fault = DriveFault.of(
                self.joint_names, self.law, self.state, self.tick * self.rates.period
            )

    @property
    def saturated(self) -> NDArray[np.int64]:
        """Return for how many ticks each amplifier was at its limit, shape (n,)."""
        return np.array(self.state["saturated"][0], dtype=np.int64)

    def reference(self) -> tuple[Array, Array, Array]:
        """Return set-point rad, its velocity rad/s and feed-forward torque Nm, joint side, shape (n,).

        Always the same arrays, brought up to date by this call.
        """
        position, velocity, torque = self._reference
        joint_torques_of(self.law, self.state["feed_forward"][0], torque)
        return position, velocity, torque

    def measured(self) -> tuple[Array, Array]:
        """Return positions rad and velocities rad/s of the joints in the last position tick, new arrays of shape (n,).

        To be called before the arrays given to `step` change.
        """
        position = np.empty(self._joints)
        velocity = np.empty(self._joints)
        joints_of(self.law, self._measured[0], position)
        joints_of(self.law, self._measured[1], velocity)
        return position, velocity

    def tracking_error(self) -> tuple[Array, Array, Array]:
        """Return position error rad, velocity error rad/s, commanded torque Nm, joint side, shape (n,).

        Always the same arrays, brought up to date by this call.
        """
        position, velocity, torque = self._error
        joints_of(self.law, self.state["error"][0], position)
        joints_of(self.law, self.state["velocity_error"][0], velocity)
        joint_torques_of(self.law, self.state["command"][0], torque)
        return position, velocity, torque

    def details(self) -> tuple[Array, Array, Array]:
        """Return set-point acceleration rad/s^2, joints; commanded and motor current A, motors; each shape (n,).

        The motor current is the drives' report if their current sensors have errors, else the law's own.
        Always the same arrays, updated by this call, which must come before the arrays given to `step` change.
        """
        acceleration, commanded, current = self._details
        commanded[:] = self.state["commanded"][0]
        reported = self._measured[2] if self._currents_err else None
        current[:] = (
            self.state["current"][0]
            if reported is None
            else reported / self.law["torque_constant"][0]
        )
        return acceleration, commanded, current
