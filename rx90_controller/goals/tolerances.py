"""How far the arm may be from the path, and from the goal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import quoted
from rx90_controller.goals.results import GoalError, ResultCode

QUANTITIES = (("position", "rad"), ("velocity", "rad/s"), ("acceleration", "rad/s^2"))
"""The rows of tolerances and errors, with their units."""
_ERASED = -1.0


@dataclass(frozen=True)
class GoalTolerances:
    """GoalTolerances of six joints; infinite where there is none.

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
    ) -> GoalTolerances:
        """Return the tolerances that joint_trajectory_controller's parameters `constraints.*` stand for.

        Args:
            names: of the joints.
            goal_time: `constraints.goal_time`, s; 0 for "for ever".
            stopped_velocity_tolerance: `constraints.stopped_velocity_tolerance`, rad/s, of every joint at the goal;
                0 for none.
            trajectory: `constraints.<joint>.trajectory`, rad, of the position along the path; 0 or absent for none.
            goal: `constraints.<joint>.goal`, rad, of the position at the goal; 0 or absent for none.

        Raises:
            ConfigError: for a number that is negative or not finite, or an unknown joint.
        """
        path, at_goal = np.full((3, 6), np.inf), np.full((3, 6), np.inf)
        at_goal[1] = _parameter("stopped_velocity_tolerance", stopped_velocity_tolerance)
        for key, table, given in (("trajectory", path, trajectory), ("goal", at_goal, goal)):
            for joint, value in (given or {}).items():
                if joint not in names:
                    raise ConfigError(f"constraints of unknown joint {quoted(joint)}; accepted: {', '.join(names)}")
                table[0, list(names).index(joint)] = _parameter(f"{joint}.{key}", value)
        return cls(tuple(names), path, at_goal, _parameter("goal_time", goal_time))

    @property
    def end_motions(self) -> bool:
        """Return whether they can end a motion before it reaches its goal."""
        return math.isfinite(self.goal_time) or bool(np.isfinite(self.path).any())

    def of_goal(self, path: Sequence[Any], goal: Sequence[Any], goal_time: float) -> GoalTolerances:
        """Return these with those of a goal in their place: 0 keeps the default, -1 erases it.

        Args:
            path: control_msgs/JointTolerance: name, position, velocity, acceleration.
            goal: likewise.
            goal_time: goal_time_tolerance, s; 0 keeps the default, -1 is "for ever".

        Raises:
            GoalError: INVALID_JOINTS for an unknown or repeated joint, INVALID_GOAL for another negative number or one
                that is not finite.
        """
        return GoalTolerances(
            self.names,
            self._table("path_tolerance", path, self.path),
            self._table("goal_tolerance", goal, self.goal),
            _resolved("goal_time_tolerance", "s", goal_time, self.goal_time),
        )

    def _table(self, what: str, given: Sequence[Any], defaults: Array) -> Array:
        table, seen = defaults.copy(), set()
        for tolerance in given:
            name = str(tolerance.name)
            if name not in self.names or name in seen:
                reason = "stands twice" if name in seen else "is unknown"
                raise GoalError(
                    ResultCode.INVALID_JOINTS,
                    f"{what}: joint {quoted(name)} {reason}; accepted: {', '.join(self.names)}, each at most once",
                )
            seen.add(name)
            joint = self.names.index(name)
            for row, (quantity, unit) in enumerate(QUANTITIES):
                value = float(getattr(tolerance, quantity))
                table[row, joint] = _resolved(f"{what}: {quantity} of {name}", unit, value, table[row, joint])
        return table


def _parameter(key: str, value: float) -> float:
    """Return a default tolerance; infinite for 0."""
    if not 0.0 <= value < math.inf:
        raise ConfigError(f"constraints.{key} is {value}; accepted: a finite number >= 0, 0 for no limit")
    return value or math.inf


def _resolved(what: str, unit: str, value: float, default: float) -> float:
    """Return what a goal's tolerance stands for."""
    if value == 0.0:
        return default
    if value == _ERASED:
        return math.inf
    if not 0.0 < value < math.inf:
        raise GoalError(
            ResultCode.INVALID_GOAL,
            f"{what} is {value:g} {unit}; accepted: a finite number > 0, 0 for the default, -1 for none",
        )
    return value
