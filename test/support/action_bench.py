"""Both nodes in one process, two clients of the action, and time that runs by steps."""

import math
import re
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from numpy.typing import NDArray
from processes import Processes
from ros_client import Client, seconds

from rx90_common.process.children import ChildProcess

STEP = 0.01  # s
SUCCEEDED, CANCELED, ABORTED = GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_ABORTED
PAUSED = ("-p", "rx90_sim:paused:=true", "-p", f"rx90_sim:step_ticks:={round(STEP * 4000)}")
UNPACED = ("-p", "rx90_sim:real_time_factor:=0.0")


class Bench:
    def __init__(self, client: Client, cell: ChildProcess, processes: Processes) -> None:
        from action_client import GoalClient, Stepper

        self.client, self.cell, self.processes = client, cell, processes
        self.time = Stepper(client, STEP)
        self.goals, self.others = GoalClient(client), GoalClient(client)
        self.set_points = client.listen("rx90_controller/reference", depth=5000)
        self.time.run(STEP)

    @property
    def now(self) -> float:
        return self.time.ran

    def begin(self, message: Any) -> tuple[Any, Any]:
        before = self.cell.output.count("goal accepted")
        handle = self.goals.send(message)
        # The client hears of it before the controller begins: a step in between would not be the goal's.
        self.client.spin_until(lambda: self.cell.output.count("goal accepted") > before, "the goal")
        return handle, self.goals.result_of(handle)

    def follow(self, message: Any) -> Any:
        _, result = self.begin(message)
        return self.time.until(result)

    def listen(self, topic: str, kind: type) -> list[Any]:
        heard = self.client.listen(f"rx90_controller/{topic}", kind)
        self.client.known_to("rx90_controller")
        return heard

    def begin_anew(self) -> None:
        self.time.reset()
        self.time.run(STEP)
        self.client.spin_until(lambda: seconds(self.set_points[-1]) < self.now, "time to begin anew")
        del self.set_points[:-1]

    def home(self) -> None:
        from action_client import move

        newest = self.heard()[-1]
        if any(newest.position) or any(newest.velocity):
            furthest = float(np.abs(newest.position).max())
            seconds = max(0.4, 1.1 * math.sqrt(furthest))  # at 6 rad/s^2
            assert self.follow(move(0.0, seconds)).status == SUCCEEDED
            self.heard()
        del self.set_points[:-1]

    def heard(self) -> list[Any]:
        newest = self.now - 1e-3 - 1e-9
        self._wait_for(self.set_points, newest)
        return self.set_points

    def state(self, states: list[Any]) -> Any:
        self._wait_for(states, self.now - 0.02 - 1e-9)
        return states[-1]

    def _wait_for(self, heard: list[Any], newest: float) -> None:
        """Wait for a message of this stamp, s, or a later one: the answer to a step may come before it."""
        self.client.spin_until(lambda: bool(heard) and seconds(heard[-1]) >= newest, f"the message of {newest} s")

    def set_points_from(self, begin: float, count: int) -> NDArray[np.float64]:
        commanded = {round((seconds(message) - begin) * 1e3): message.position for message in self.heard()}
        return np.array([commanded[k] for k in range(1, count + 1)])

    def velocities(self) -> NDArray[np.float64]:
        return np.array([message.velocity for message in self.heard()])

    def fastest_change(self) -> NDArray[np.float64]:
        """Return the largest acceleration of each joint that the velocities of the set-points show, rad/s^2."""
        largest: NDArray[np.float64] = np.abs(np.diff(self.velocities(), axis=0)).max(axis=0) / 1e-3
        return largest

    def said(self, words: str) -> None:
        self.cell.wait_for(re.escape(words))
