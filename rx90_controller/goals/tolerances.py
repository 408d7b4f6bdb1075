"""How far the arm may be from the path, and from the goal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rx90_common.base.arrays import Array


@dataclass(frozen=True)
class Tolerances:
    """Tolerances of six joints; infinite where there is none.

    Attributes:
        names: of the joints.
        path: of position rad, velocity rad/s and acceleration rad/s^2 along the path, shape (3, 6).
        goal: likewise at its end.
        goal_time: how long after its end the goal may take to be reached, s; infinite for "for ever".
    """

    names: tuple[str, ...]
    path: Array
    goal: Array
    goal_time: float

    @classmethod
    def defaults(
        cls,
        names: Sequence[str],
        *,
        goal_time: float = 0.0,
        stopped_velocity_tolerance: float = 0.01,
        trajectory: Mapping[str, float] | None = None,
        goal: Mapping[str, float] | None = None,
    ) -> Tolerances:
        """Return the tolerances that joint_trajectory_controller's parameters `constraints.*` stand for.

        Args:
            names: of the joints.
            goal_time: `constraints.goal_time`, s; 0 for "for ever".
            stopped_velocity_tolerance: `constraints.stopped_velocity_tolerance`, rad/s, of every joint at the goal;
                0 for none.
            trajectory: `constraints.<joint>.trajectory`, rad, of the position along the path; 0 or absent for none.
            goal: `constraints.<joint>.goal`, rad, of the position at the goal; 0 or absent for none.

        Raises:
            ConfigError: for a negative or infinite number, or an unknown joint.
        """
        raise NotImplementedError

    def of_goal(self, path: Sequence[Any], goal: Sequence[Any], goal_time: float) -> Tolerances:
        """Return these with those of a goal in their place: 0 keeps the default, -1 erases it.

        Args:
            path: control_msgs/JointTolerance: name, position, velocity, acceleration.
            goal: likewise.
            goal_time: goal_time_tolerance, s; 0 keeps the default, -1 is "for ever".

        Raises:
            GoalError: INVALID_JOINTS for an unknown or repeated joint, INVALID_GOAL for another negative number or one
                that is not finite.
        """
        raise NotImplementedError
