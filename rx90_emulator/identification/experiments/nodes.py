"""Run experiments on the controller node: publish a trajectory, record, wait for its end on the controller's topics."""

from __future__ import annotations

import shutil
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from rx90_common.bags.reading import read_bag
from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.client_node import ClientNode, client_node
from rx90_common.process.children import ProcessGroup, executable
from rx90_controller.lines.plan import APPROACH_ACCELERATION, APPROACH_SPEED
from rx90_controller.node.trajectory_client import NewestPositions, Show, TrajectoryClient
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.correction import Correction
from rx90_controller.trajectory.motion import Motion
from rx90_emulator.identification.experiments.plan import TOPICS, Experiment, write_index
from rx90_emulator.loop.setup import Setup

_ATTEMPTS = 3  # of an experiment whose recorder loses messages
_AT_REST = 1e-6  # rad, from a set-point to the end of the trajectory


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
            motion.move(start, setup.robot.max_velocity * APPROACH_SPEED, APPROACH_ACCELERATION)
            client.say(f"approach: {motion.duration:.1f} s")
            follow(motion.points(names), show=lambda *_: None)
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


def _show(bar: Any, before: float, elapsed: float, _duration: float) -> None:
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
    show: Show,
) -> float:
    """Send a trajectory, wait until the controller's set-points are at its end, and return when it ended, s."""
    trajectory.send(names, points, correction=correction, tolerance=_AT_REST)
    for _ in range(3):  # messages that arrived while the recorder started
        client.spin()
    return trajectory.wait_for_end(set_points, show)


def _last_time(bag: Path) -> float:
    """Return the time up to which each topic of states in a bag has messages, s."""
    return min(float(series.stamp_ns[-1]) for series in read_bag(bag).values()) / NANOSECONDS
