"""What a drive supervises: the following error and the speed of each joint. Beyond a limit it cuts the power."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from rx90_common.base.arrays import Array, Record
from rx90_common.description.wrist import to_joint
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lanes import Lanes, absolute, any_lane, append, first, lane, load, select

_PARAMETERS = {
    "inertia": "servo.inertia",
    "derivative": "servo.kv",
    "proportional": "servo.kp",
    "integral": "servo.ki",
    "integrator_limit": "servo.integrator_limit",
    "coulomb": "feed_forward.coulomb_torque",
    "viscous": "feed_forward.viscous_friction",
}
"""Constants of the law by the parameter that makes them; those that go into others come first."""
_ABSURD = 1e100
_LARGEST = float(np.finfo(np.float64).max)


@inlined
def not_finite(torque: Lanes) -> bool:
    """Return whether one of six torques is infinite or NaN."""
    return any_lane(select(absolute(torque) <= _LARGEST, 0.0, 1.0) > 0.0)


@inlined
def beyond_limits(law: Any, error: Lanes, velocity: Lanes) -> bool:
    """Return whether a joint is beyond a limit, or a value is NaN; six lanes, motor side.

    Args:
        law: constants, a record of CONTROLLER_DTYPE.
        error: position errors, rad.
        velocity: measured velocities, rad/s.
    """
    # Motor 6 turns with joints 5 and 6 together.
    share = law.gear[5] / law.gear[4]
    following = append(first(error, 5), lane(error, 5) - share * lane(error, 4))
    speed = append(first(velocity, 5), lane(velocity, 5) - share * lane(velocity, 4))
    # The comparisons are false for NaN too.
    fast = select(absolute(speed) <= load(law.over_speed, 6), 0.0, 1.0)
    return any_lane(select(absolute(following) <= load(law.following_error, 6), fast, 1.0) > 0.0)


class DriveFault(NamedTuple):
    """Why the supervision cut the power.

    Attributes:
        joint: name of the joint.
        quantity: "following error", "speed" or "torque".
        value: of it, in `unit`.
        limit: the most that is accepted.
        unit: "rad", "rad/s" or "Nm".
        time: of the measurement, s.
        parameter: what made the law give no finite torque; empty for a limit.
    """

    joint: str
    quantity: str
    value: float
    limit: float
    unit: str
    time: float
    parameter: str = ""

    @classmethod
    def of(cls, names: Sequence[str], laws: Record, states: Record, time: float) -> DriveFault:
        """Return what is furthest beyond its limit after a position loop that found something there at `time`, s."""
        law, state = laws[0], states[0]
        candidates = (
            ("following error", "rad", state["error"], law["following_error"]),
            ("speed", "rad/s", state["reference"][1] - state["velocity_error"], law["over_speed"]),
        )
        worst, found = -1.0, None
        for quantity, unit, motor, motor_limit in candidates:
            value = _joint_side(law["gear"], motor)
            limit = motor_limit / np.abs(law["gear"])
            share = np.nan_to_num(np.abs(value) / limit, nan=np.inf)
            joint = int(np.argmax(share))
            if share[joint] > worst:
                worst = float(share[joint])
                found = cls(names[joint], quantity, float(value[joint]), float(limit[joint]), unit, time)
        assert found is not None
        return found

    @classmethod
    def of_torque(cls, names: Sequence[str], laws: Record, states: Record, time: float) -> DriveFault:
        """Return the first joint whose torque is not finite after a velocity loop that found one at `time`, s."""
        law, torque = laws[0], states[0]["command"]
        motor = int(np.argmin(np.isfinite(torque)))
        absurd = [name for constant, name in _PARAMETERS.items() if not abs(law[constant][motor]) < _ABSURD]
        other = "the feed-forward's model" if law["model"]["parts"] else "a measured state"
        parameter = absurd[0] if absurd else other
        return cls(names[motor], "torque", float(torque[motor]), np.inf, "Nm", time, parameter)

    def __str__(self) -> str:
        """Return it as one line with the value and what is accepted."""
        if self.parameter:
            return (
                f"{self.joint}: torque {self.value:g} {self.unit} at {self.time:.6g} s, by {self.parameter}; "
                "accepted: finite torques"
            )
        return (
            f"{self.joint}: {self.quantity} {self.value:.4g} {self.unit} at {self.time:.6g} s; accepted: up to "
            f"{self.limit:.4g} {self.unit}"
        )


def _joint_side(gear: Array, motor: Array) -> Array:
    joint = np.empty(6)
    to_joint(np.ascontiguousarray(gear), np.ascontiguousarray(motor), joint)
    return joint
