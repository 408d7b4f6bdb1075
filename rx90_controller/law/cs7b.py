"""The controller as the nodes and the closed loop use it: measured motor states in, motor torques out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array, Record
from rx90_common.base.rates import Rates
from rx90_common.description.drives import DriveParameters
from rx90_common.description.robot import RobotModel
from rx90_controller.law.loops import (
    joint_torques_of,
    joints_of,
    law_release,
    law_reset,
    law_state_dtype,
    position_loop,
    velocity_loop,
)
from rx90_controller.law.model import cool_model
from rx90_controller.law.parameters import CS7BParameters
from rx90_controller.trajectory import TrajectoryGenerator

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
        law, state = laws[0], states[0]
        found = []
        for quantity, unit, motor, motor_limit in (
            ("following error", "rad", state["error"], law["following_error"]),
            ("speed", "rad/s", state["reference"][1] - state["velocity_error"], law["over_speed"]),
        ):
            gear = law["gear"]["ratio"] if law["gear"].dtype.names else law["gear"]
            value, limit = np.empty(len(names)), motor_limit / np.abs(gear)
            joints_of(laws, np.ascontiguousarray(motor), value)
            share = np.nan_to_num(np.abs(value) / limit, nan=np.inf)
            k = int(np.argmax(share))
            fault = cls(names[k], quantity, float(value[k]), float(limit[k]), unit, time)
            found.append((float(share[k]), fault))
        return max(found, key=lambda each: each[0])[1]

    def __str__(self) -> str:
        """Return it as one line with the value and the limit."""
        accepted = f"up to {self.limit:.4g} {self.unit}" if self.limit < np.inf else "finite torques"
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

    def __init__(self, robot: RobotModel, drives: DriveParameters, parameters: CS7BParameters, rates: Rates) -> None:
        self.joint_names = robot.joint_names
        self.rates = rates
        self.law = parameters.record(robot, drives, rates)
        self.state: np.ndarray[Any, Any] = np.zeros(1, law_state_dtype(drives.turning.size))
        self._joints = n = len(robot.joint_names)
        self.trajectory = TrajectoryGenerator(parameters.limits(robot), rates.position_period, np.zeros(n))
        self.tick = 0
        # Set-points ahead, from a position tick on, of a revision of the generator.
        self._ahead, self._ahead_from, self._ahead_revision = np.zeros((0, 3, n)), 0, self.trajectory.revision
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
            row, revision = tick - self._ahead_from, self.trajectory.revision
            if self._ahead_revision != revision or not 0 <= row < len(self._ahead):
                self._ahead = self.trajectory.corrected(tick, _LOOKAHEAD)
                self._ahead_from, self._ahead_revision, row = tick, revision, 0
            corrected = self._ahead[row]
            self.setpoint, self.offset = corrected[:3], corrected[3] if len(corrected) > 3 else None
            self._measured = (position, velocity, torque)
            self._reference[:2], self._details[0] = self.setpoint[:2], self.setpoint[2]
            if position_loop(self.law, self.state, corrected, position, velocity):
                self.note_fault()
        if velocity_loop(self.law, self.state, velocity) and self.fault is None:
            motor, time = int(np.argmin(np.isfinite(self.command))), self.tick * self.rates.period
            self.fault = DriveFault(self.joint_names[motor], "torque", float(self.command[motor]), np.inf, "Nm", time)
        self.tick += 1
        return self.command

    def note_fault(self) -> None:
        """Keep the first fault, found by the supervision in the present tick."""
        if self.fault is None:
            self.fault = DriveFault.of(self.joint_names, self.law, self.state, self.tick * self.rates.period)

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
        position, velocity = np.empty(self._joints), np.empty(self._joints)
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
        commanded[:], reported = self.state["commanded"][0], self._measured[2] if self._currents_err else None
        current[:] = self.state["current"][0] if reported is None else reported / self.law["torque_constant"][0]
        return acceleration, commanded, current
