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

from rx90_common.bags.reading import read_bag
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.client_node import POLL, ClientNode, client_node
from rx90_common.process.children import ProcessGroup, executable
from rx90_controller.node.trajectory_client import NewestPositions, TrajectoryClient
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.correction import Correction
from rx90_controller.trajectory.motion import Motion
from rx90_emulator.identification.experiments.plan import TOPICS, Experiment, write_index
from rx90_emulator.loop.setup import Setup

_ATTEMPTS = 3  # of an experiment whose recorder loses messages
_PATIENCE = 5.0  # s of the controller's time and of the wall clock, until a trajectory begins and beyond its end
_AT_REST = 1e-6  # rad
_APPROACH_SPEED = 0.25
_APPROACH_ACCELERATION = 2.0


def run_on_nodes(
    setup: Setup, plan: Sequence[Experiment], folder: Path, controller: str, timeout: float
) -> None:
    """Run and record experiments on the controller node, one by one; after Ctrl-C complete bags stay.

    Args:
        setup: for the joints' names and speeds, and how far a trajectory may start from a set-point.
        plan: the experiments.
        folder: for the bags.
        controller: name of the controller node.
        timeout: longest wait for a node, and for simulated time to go on, s.

    Raises:
        ExchangeError: if a node does not appear, time stands still, or the controller refuses a trajectory.
        ProcessError: if the recorder repeatedly loses messages, or ends early.
    """
    with (
        client_node("rx90_experiment", timeout, partial(print, flush=True)) as client,
        # A recorder that still runs at the end is stopped properly.
        ProcessGroup(folder, grace=20.0) as recorders,
        tqdm(
            total=round(sum(experiment.duration for experiment in plan)), unit="s", disable=None
        ) as bar,
    ):
        trajectory = TrajectoryClient(client, controller)
        trajectory.wait_for_controller()
        names = setup.robot.joint_names
        set_points = trajectory.set_points(names)
        follow = partial(follow_trajectory, client, trajectory, names, set_points)
        motion = Motion(set_points.position)
        start = plan[0].points.position[0]
        if np.abs(start - motion.pose).max() > setup.controller.trajectory.start_tolerance:
            motion.move(start, setup.robot.max_velocity * _APPROACH_SPEED, _APPROACH_ACCELERATION)
            client.say(f"approach: {motion.duration:.1f} s")
            follow(motion.points(names), show=lambda _: None)
        for number, experiment in enumerate(plan):
            bar.set_description_str(experiment.name)
            show = partial(_show, bar, bar.n)
            # Repeated if the recorder lost messages, because the machine was busy: experiments end where they begin.
            for attempt in range(1, _ATTEMPTS + 1):
                fault = _record(recorders, experiment, folder, timeout, partial(follow, show=show))
                if not fault:
                    break
                if attempt == _ATTEMPTS:
                    raise ExchangeError(f"{experiment.name}: {fault}")
                bar.write(f"{experiment.name}: {fault}; again", file=sys.stderr)
                shutil.rmtree(folder / experiment.name, ignore_errors=True)
            write_index(folder, plan[: number + 1])


def _show(bar: Any, before: float, elapsed: float) -> None:
    bar.update(before + round(elapsed) - bar.n)


def _record(
    recorders: ProcessGroup,
    experiment: Experiment,
    folder: Path,
    timeout: float,
    follow: Callable[[TrajectoryPoints], float],
) -> str:
    """Record an experiment, and return what is wrong with its bag; empty for nothing."""
    bag = folder / experiment.name
    recorder = recorders.start(
        experiment.name, executable("rx90 bag", "record", "--output", bag, *TOPICS[experiment.kind])
    )
    recorder.wait_for("ready: all", timeout)
    end = follow(experiment.points)
    recorder.signal(signal.SIGINT)
    if code := recorder.wait(timeout):
        return f"the recorder ended with exit code {code} (see {recorder.log})"
    last = _last_time(bag)
    if last < end:
        return f"the bag ends at {last:.3f} s, before the motion does at {end:.3f} s"
    return ""


def follow_trajectory(
    client: ClientNode,
    trajectory: TrajectoryClient,
    names: Sequence[str],
    set_points: NewestPositions,
    points: TrajectoryPoints,
    correction: Correction | None = None,
    *,
    show: Callable[[float], object],
) -> float:
    """Send a trajectory, wait until the controller's set-points are at its end, and return when it ended, s."""
    for _ in range(3):  # messages that arrived while the recorder started
        client.spin()
    run = FollowedTrajectory(points, set_points.position, client.timeout)
    trajectory.send(names, points, correction=correction)
    while not run.done:
        run.see(set_points.time, set_points.position, time.monotonic())
        show(run.elapsed)
        client.spin()
        # the newest message suffices; in between the processor is left to the nodes
        time.sleep(POLL / 2.0)
    return run.end


def _last_time(bag: Path) -> float:
    """Return the time up to which each topic of states in a bag has messages, s."""
    return min(float(series.stamp_ns[-1]) for series in read_bag(bag).values()) / NANOSECONDS


class FollowedTrajectory:
    """Determines from sampled set-points whether a trajectory that was sent has begun and ended.

    It begins when the controller accepts it, which in a simulation without a pace may be many seconds of its time after
    it was sent; so time counts from the first set-point that moved.

    Args:
        points: of the trajectory.
        before: set-points when it is sent, rad, shape (n,).
        timeout: longest that time may stand still, s of the wall clock.

    Attributes:
        elapsed: part of its duration that has passed, s.
        end: latest time of its end, in the time of the set-points, s; infinite before it begins.
        done: whether it has ended.
    """

    def __init__(self, points: TrajectoryPoints, before: Array, timeout: float) -> None:
        self._points = points
        self._before = before
        self._timeout = timeout
        self._newest = (-math.inf, 0.0)  # time, and when it came by the wall clock
        # of both clocks: without a pace, seconds pass while a message is on its way
        self._due = (math.inf, math.inf)
        self.elapsed = 0.0
        self.end = math.inf
        self.done = False

    def see(self, now: float, position: Array, clock: float) -> None:
        """Evaluate the newest set-point.

        Args:
            now: its time, s.
            position: rad, shape (n,).
            clock: wall clock, s.

        Raises:
            ExchangeError: if time stands still, or the trajectory does not begin or end.
        """
        time_before, came = self._newest
        if time_before == -math.inf:
            self._due = (now + _PATIENCE, clock + _PATIENCE)
        if now > time_before:
            self._newest = (now, clock)
        elif clock - came > self._timeout:
            raise ExchangeError(
                f"the controller's time stood still at {now:.3f} s for {self._timeout:g} s"
            )
        duration = float(self._points.times[-1])
        if self.end == math.inf and np.abs(position - self._before).max() > _AT_REST:
            leaves = int(
                np.argmax((np.abs(self._points.position - self._before) > _AT_REST).any(axis=1))
            )
            self.end = now - float(self._points.times[max(leaves - 1, 0)]) + duration
            self._due = (self.end + _PATIENCE, clock + duration + _PATIENCE)
        if self.end < math.inf:
            self.elapsed = min(max(0.0, now - self.end + duration), duration)
            arrived = np.abs(position - self._points.position[-1]).max() <= _AT_REST
            self.done = bool(now > self.end + POLL and arrived)
        if not self.done and now > self._due[0] and clock > self._due[1]:
            raise ExchangeError(
                "the controller did not run the trajectory to its end; it says why on its terminal"
            )
