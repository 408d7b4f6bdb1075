"""The contract of FollowJointTrajectory without ROS: goals checked, tolerances, and what becomes of a goal."""

from rx90_controller.goals.execution import Feedback, Outcome, Phase
from rx90_controller.goals.goal import Goal, GoalOptions, check_goal
from rx90_controller.goals.results import GoalError, ResultCode
from rx90_controller.goals.runner import Event, GoalRunner
from rx90_controller.goals.tolerances import Tolerances

__all__ = [
    "Event",
    "Feedback",
    "Goal",
    "GoalError",
    "GoalOptions",
    "GoalRunner",
    "Outcome",
    "Phase",
    "ResultCode",
    "Tolerances",
    "check_goal",
]
