"""Run experiments on the controller node: publish a trajectory, record, wait for its end on the controller's topics."""

from __future__ import annotations

import math
import shutil
import signal
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, ExchangeError
from rx90_common.base.share import resolve_config
from rx90_common.exchange.client_node import POLL, ClientNode, client_node, text_parameter
from rx90_common.friction.friction_file import load_friction
from rx90_common.process.children import ProcessGroup, executable
from rx90_controller.node.trajectory_client import TrajectoryClient
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.identification.experiments.folder import TOPICS, write_emulated, write_index
from rx90_emulator.identification.experiments.motion import Motion
from rx90_emulator.identification.experiments.plan import Experiment
from rx90_emulator.loop.setup import Setup

_ATTEMPTS = 3  # of an experiment whose recorder loses messages
_PATIENCE = 5.0  # s of the controller's time and of the wall clock, for a trajectory to begin and beyond its end
_AT_REST = 1e-6  # rad
_APPROACH_SPEED, _APPROACH_ACCELERATION = 0.25, 2.0


def run_on_nodes(setup: Setup, plan: Sequence[Experiment], folder: Path, controller: str, timeout: float) -> None:
    """Run and record experiments on the controller node, one by one; after Ctrl-C the bags that are complete stay.

    Args:
        setup: for the joints' names and speeds, and how far a trajectory may start from a set-point.
        plan: the experiments.
        folder: for the bags.
        controller: name of the controller node.
        timeout: longest wait for a node, and for simulated time to go on, s.

    Raises:
        ConfigError: if that cannot be a node's name.
        ExchangeError: if a node does not show up, time stands still, or the controller refuses a trajectory.
        ProcessError: if the recorder loses messages again and again, or ends early.
    """
    total = sum(experiment.duration for experiment in plan)
    layout = "{l_bar}{bar}| {n:.0f}/{total:.0f} s [{elapsed}<{remaining}]"
    # A recorder that still runs at the end is ended in order.
    with (
        client_node("rx90_experiment", timeout, partial(print, flush=True)) as client,
        ProcessGroup(folder, grace=20.0) as recorders,
    ):
        runner = _Runner(setup, client, controller)
        runner.approach(plan[0].points.position[0])
        with tqdm(total=total, bar_format=layout, mininterval=0.2, miniters=0, disable=None) as bar:
            for number, experiment in enumerate(plan):
                bar.set_description_str(experiment.name)
                runner.record(experiment, folder, recorders, bar)
                if not number:
                    runner.write_emulated(folder)
                write_index(folder, plan[: number + 1])


class _Runner:
    """Publishes trajectories to the controller node and follows them."""

    def __init__(self, setup: Setup, client: ClientNode, controller: str) -> None:
        self._robot, self._start_tolerance = setup.robot, setup.controller.start_tolerance
        self._client = client
        self._trajectory = TrajectoryClient(client, controller)
        self._trajectory.wait_for_controller()
        self._set_points = self._trajectory.set_points(self._robot.joint_names)

    def write_emulated(self, folder: Path) -> None:
        """Write the friction of the simulation beside the bags, if it is one and its files are on this machine."""
        name = text_parameter(self._client, "rx90_sim", "friction")
        if not name:
            return
        try:
            write_emulated(folder, load_friction(resolve_config(name), self._robot.joint_names))
        except ConfigError as error:
            self._client.say(f"the simulation's friction is not kept beside the bags: {error}")

    def approach(self, start: Array) -> None:
        here = self._position
        gap = float(np.abs(start - here).max())
        if gap <= self._start_tolerance:
            return
        motion = Motion(here)
        motion.move(start, self._robot.max_velocity * _APPROACH_SPEED, _APPROACH_ACCELERATION)
        self._client.say(f"approach: {math.degrees(gap):.1f} deg, {motion.duration:.1f} s")
        self._follow(motion.points(self._robot.joint_names), lambda _: None)

    def record(self, experiment: Experiment, folder: Path, recorders: ProcessGroup, bar: tqdm[Any]) -> None:
        """Run an experiment and record it, again where the recorder lost messages: a machine was busy for a moment."""
        words = executable("rx90_bag", "record", "--output", folder / experiment.name, *TOPICS[experiment.kind])
        done = bar.n
        for attempt in range(1, _ATTEMPTS + 1):
            recorder = recorders.start(experiment.name, words)
            recorder.wait_for("ready: all", self._client.timeout)
            self._follow(experiment.points, lambda elapsed: bar.update(done + elapsed - bar.n))
            recorder.signal(signal.SIGINT)
            code = recorder.wait(self._client.timeout)
            bar.update(done + (experiment.duration if code == 0 else 0.0) - bar.n)
            if code == 0:
                return
            if attempt < _ATTEMPTS:  # experiments end where they begin, so this one can begin again
                bar.write(f"{experiment.name}: the recorder ended with exit code {code}; again", file=sys.stderr)
                shutil.rmtree(folder / experiment.name, ignore_errors=True)
        raise ExchangeError(f"the recorder of {experiment.name} ended with exit code {code} (see {recorder.log})")

    def _follow(self, points: TrajectoryPoints, show: Callable[[float], object]) -> None:
        """Send a trajectory and wait until the controller's set-points are at its end."""
        # The newest stamp: while the recorder started nobody looked.
        for _ in range(3):
            self._spin()
        run = FollowedTrajectory(points, self._position, self._client.timeout)
        begin, clock = self._set_points.time, time.monotonic
        self._trajectory.send(self._robot.joint_names, points)
        run.see(begin, self._position, clock())
        while not run.done:
            self._spin()
            run.see(self._set_points.time, self._position, clock())
            show(run.elapsed)

    @property
    def _position(self) -> Array:
        """Return the newest set-points, rad, shape (n,); the client has waited for the first."""
        assert self._set_points.position is not None
        return self._set_points.position

    def _spin(self) -> None:
        self._client.spin()
        # The newest message is enough; in between the processor is the nodes'.
        time.sleep(POLL / 2.0)


class FollowedTrajectory:
    """Tells from set-points that are seen now and then whether a trajectory that was sent has begun and ended.

    It begins when the controller takes it, which in a simulation without a pace may be many seconds of its time after
    it was sent; so time counts from the first set-point that moved.

    Args:
        points: of the trajectory.
        before: set-points when it is sent, rad, shape (n,).
        timeout: longest that time may stand still, s of the wall clock.
    """

    def __init__(self, points: TrajectoryPoints, before: Array, timeout: float) -> None:
        self._before, self._end, self._timeout = before, points.position[-1], timeout
        leaves = int(np.argmax((np.abs(points.position - before) > _AT_REST).any(axis=1)))
        self._rest = float(points.times[max(leaves - 1, 0)])
        self._duration = float(points.times[-1])
        self._began: float | None = None
        self._seen, self._went_on, self._due = -math.inf, 0.0, (0.0, 0.0)
        self.elapsed = 0.0
        self.done = False

    def see(self, now: float, position: Array, clock: float) -> None:
        """Take the newest set-point.

        Args:
            now: its time, s.
            position: rad, shape (n,).
            clock: wall clock, s.

        Raises:
            ExchangeError: if time stands still, or the trajectory does not begin or end.
        """
        if self._seen == -math.inf:
            self._due = now + _PATIENCE, clock + _PATIENCE
        if now > self._seen:
            self._seen, self._went_on = now, clock
        elif clock - self._went_on > self._timeout:
            raise ExchangeError(f"the controller's time stood still at {now:.3f} s for {self._timeout:g} s")
        if self._began is None and not _near(position, self._before):
            self._began = now - self._rest
            self._due = self._began + self._duration + _PATIENCE, clock + self._duration + _PATIENCE
        if self._began is not None:
            self.elapsed = min(max(0.0, now - self._began), self._duration)
            self.done = now > self._began + self._duration + POLL and _near(position, self._end)
        # Both clocks: without a pace seconds of simulated time pass while a message is on its way.
        if not self.done and now > self._due[0] and clock > self._due[1]:
            raise ExchangeError("the controller did not run the trajectory to its end; it says why on its terminal")


def _near(position: Array, other: Array) -> bool:
    return bool(np.abs(position - other).max() <= _AT_REST)
