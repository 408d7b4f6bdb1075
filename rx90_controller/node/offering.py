"""Trajectories on their way to the ticks: what may take long is done beside them, for goals and for the topic alike."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any, Protocol

from rx90_common.base.errors import TrajectoryError
from rx90_controller.node.goal_requests import GoalRequests
from rx90_controller.node.requests import Requests
from rx90_controller.trajectory.planning import Entrance, Plan

_ATTEMPTS = 3  # each gives a long trajectory more time than the one before


class TickedLoop(Protocol):
    """What `ServoLoop` tells of itself."""

    running: bool

    @property
    def inactive(self) -> str:
        """See `ServoLoop.inactive`."""

    def between_ticks(self) -> AbstractContextManager[GoalRequests]:
        """See `ServoLoop.between_ticks`."""


@contextmanager
def joined(ticks: TickedLoop, entrance: Entrance | None) -> Iterator[tuple[GoalRequests, Plan | None]]:
    """Give the goals between two ticks, and to what a long trajectory was joined before that, beside the ticks.

    Where the motion changes meanwhile, or the time was too short, it is joined again. Without a plan, as for a short
    trajectory, and where no attempt was in time, it is to be joined between the two ticks.
    """
    if entrance is not None and entrance.long:
        for attempt in range(_ATTEMPTS):
            with ticks.between_ticks() as goals:
                plan = goals.plan(entrance, attempt) if ticks.running and not ticks.inactive else None
            if plan is None:
                break
            plan.join()
            with ticks.between_ticks() as goals:
                if goals.fits(plan):
                    yield goals, plan
                    return
    with ticks.between_ticks() as goals:
        yield goals, None


def offer(ticks: TickedLoop, requests: Requests, trajectory: Any) -> None:
    """Follow a trajectory_msgs/JointTrajectory, at the latest once there are states; the log says if not."""
    try:
        with ticks.between_ticks():
            if ticks.running and ticks.inactive:
                raise TrajectoryError(ticks.inactive)
        request = requests.checked(trajectory)
    except TrajectoryError as error:
        with ticks.between_ticks():
            requests.refused("trajectory", error)
        return
    with joined(ticks, request.entrance) as (goals, plan):
        if not ticks.running:
            requests.wait(request)
        elif not requests.take(request, ticks.inactive, plan):
            return
        goals.drop("replaced by a trajectory on the topic", wanted=True)
        if ticks.running:
            goals.watch()
