"""Run experiments on the controller node: publish a trajectory, record, wait for its end on the controller's topics."""

from __future__ import annotations

import math
import shutil
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, ExchangeError
from rx90_common.base.share import resolve_config
from rx90_common.exchange.client_node import POLL, ClientNode, client_node
from rx90_common.exchange.managing import text_parameter
from rx90_common.friction.friction_file import load_friction
from rx90_common.process.children import ProcessGroup, executable
from rx90_controller.node.trajectory_client import TrajectoryClient
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.identification.experiments.folder import TOPICS, write_emulated, write_index
from rx90_emulator.identification.experiments.motion import Motion
from rx90_emulator.identification.experiments.plan import Experiment
from rx90_emulator.loop.setup import Setup

_ATTEMPTS = 3  # of an experiment whose recorder loses messages
_PATIENCE = 5.0  # s of the controller's time, for a trajectory to begin and beyond its end
_AT_REST = 1e-6  # rad
_APPROACH_SPEED, _APPROACH_ACCELERATION = 0.25, 2.0


def run_on_nodes(
    setup: Setup,
    plan: Sequence[Experiment],
    folder: Path,
    controller: str,
    timeout: float,
    say: Callable[[str], None],
) -> None:
    """Run and record experiments on the controller node, one by one; after Ctrl-C the bags that are complete stay.

    Args:
        setup: for the joints' names and speeds, and how far a trajectory may start from a set-point.
        plan: the experiments.
        folder: for the bags.
        controller: name of the controller node.
        timeout: longest wait for a node, and for simulated time to go on, s.
        say: prints a line for the user.

    Raises:
        ConfigError: if that cannot be a node's name.
        ExchangeError: if a node does not show up, time stands still, or the controller refuses a trajectory.
        ProcessError: if the recorder loses messages again and again, or ends early.
    """
    with client_node("rx90_experiment", timeout, say) as client:
        _Runner(setup, client, controller).run(plan, folder)


class _Runner:
    """Publishes trajectories to the controller node and follows them."""

    def __init__(self, setup: Setup, client: ClientNode, controller: str) -> None:
        self._robot, self._start_tolerance = setup.robot, setup.controller.start_tolerance
        self._client = client
        self._trajectory = TrajectoryClient(client, controller)
        self._trajectory.wait_for_controller()
        self._set_points = self._trajectory.set_points(self._robot.joint_names)

    def run(self, plan: Sequence[Experiment], folder: Path) -> None:
        """Run and record the experiments one after the other."""
        # A recorder that still runs at the end is ended in order.
        with ProcessGroup(folder, grace=20.0) as recorders:
            self._approach(plan[0].points.position[0])
            total = sum(experiment.duration for experiment in plan)
            layout = "{l_bar}{bar}| {n:.0f}/{total:.0f} s [{elapsed}<{remaining}]"
            with tqdm(total=total, bar_format=layout, mininterval=0.2, miniters=0, disable=None) as bar:
                for number, experiment in enumerate(plan):
                    bar.set_description_str(experiment.name)
                    self._record(experiment, folder, recorders, bar)
                    if not number:
                        self._write_emulated(folder)
                    write_index(folder, plan[: number + 1])

    def _write_emulated(self, folder: Path) -> None:
        """Write the friction of the simulation beside the bags, if it is one and its files are on this machine."""
        name = text_parameter(self._client, "rx90_sim", "friction")
        if not name:
            return
        try:
            write_emulated(folder, load_friction(resolve_config(name), self._robot.joint_names))
        except ConfigError as error:
            self._client.say(f"the simulation's friction is not kept beside the bags: {error}")

    def _approach(self, start: Array) -> None:
        here = self._position
        gap = float(np.abs(start - here).max())
        if gap <= self._start_tolerance:
            return
        motion = Motion(here)
        motion.move(start, self._robot.max_velocity * _APPROACH_SPEED, _APPROACH_ACCELERATION)
        self._client.say(f"approach: {math.degrees(gap):.1f} deg, {motion.duration:.1f} s")
        self._follow(motion.points(self._robot.joint_names), lambda _: None)

    def _record(self, experiment: Experiment, folder: Path, recorders: ProcessGroup, bar: tqdm[Any]) -> None:
        for attempt in range(1, _ATTEMPTS + 1):
            code, log = self._record_once(experiment, folder, recorders, bar)
            if code == 0:
                return
            if attempt < _ATTEMPTS:
                # A machine that was busy for a moment; experiments end where they begin, so this one can begin again.
                bar.write(f"{experiment.name}: the recorder ended with exit code {code}; again", file=sys.stderr)
                shutil.rmtree(folder / experiment.name, ignore_errors=True)
        raise ExchangeError(f"the recorder of {experiment.name} ended with exit code {code} (see {log})")

    def _record_once(
        self, experiment: Experiment, folder: Path, recorders: ProcessGroup, bar: tqdm[Any]
    ) -> tuple[int, Path | None]:
        """Return the recorder's exit code, 1 where messages were lost, and its log."""
        record = executable("rx90_bag", "record", "--output", folder / experiment.name, *TOPICS[experiment.kind])
        recorder = recorders.start(experiment.name, record)
        recorder.wait_for("ready: all", self._client.timeout)
        done = bar.n
        self._follow(experiment.points, lambda elapsed: bar.update(done + elapsed - bar.n))
        recorder.signal(signal.SIGINT)
        code = recorder.wait(self._client.timeout)
        bar.update(done + (experiment.duration if code == 0 else 0.0) - bar.n)
        return code, recorder.log

    def _follow(self, points: TrajectoryPoints, show: Callable[[float], object]) -> None:
        """Send a trajectory and wait until the controller's set-points are at its end."""
        # The newest stamp: while the recorder started nobody looked.
        for _ in range(3):
            self._spin()
        set_points, timeout = self._set_points, self._client.timeout
        begin, duration, before, end = set_points.time, float(points.times[-1]), self._position, points.position[-1]
        self._trajectory.send(self._robot.joint_names, points)
        moved, seen, deadline = False, begin, time.monotonic() + timeout
        while not (set_points.time > begin + duration + POLL and moved and self._is_at(end)):
            self._spin()
            moved = moved or not self._is_at(before)
            if set_points.time > seen:
                seen, deadline = set_points.time, time.monotonic() + timeout
            elif time.monotonic() > deadline:
                raise ExchangeError(f"the controller's time stood still at {seen:.3f} s for {timeout:g} s")
            late = set_points.time - begin - (duration if moved else 0.0)
            if late > _PATIENCE:
                raise ExchangeError("the controller did not run the trajectory to its end; it says why on its terminal")
            show(min(max(0.0, set_points.time - begin), duration))

    @property
    def _position(self) -> Array:
        """Return the newest set-points, rad, shape (n,); the client has waited for the first."""
        assert self._set_points.position is not None
        return self._set_points.position

    def _is_at(self, position: Array) -> bool:
        return bool(np.abs(self._position - position).max() <= _AT_REST)

    def _spin(self) -> None:
        self._client.spin()
        # The newest message is enough; in between the processor is the nodes'.
        time.sleep(POLL / 2.0)
