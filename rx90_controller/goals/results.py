"""The result codes of FollowJointTrajectory, and the error that carries one."""

from __future__ import annotations

from enum import IntEnum

from rx90_common.base.errors import TrajectoryError


class ResultCode(IntEnum):
    """The codes of a FollowJointTrajectory result (control_msgs)."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class GoalError(TrajectoryError):
    """A goal is refused; the text is one line with the value and what is accepted.

    Attributes:
        code: the result code that says why.
    """

    def __init__(self, code: ResultCode, text: str) -> None:
        """Refuse a goal with a code and a line."""
        super().__init__(text)
        self.code = code
