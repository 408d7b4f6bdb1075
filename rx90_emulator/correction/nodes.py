"""Trials on running nodes: the arm goes to the start of the path, plays the correction, and is recorded."""

from __future__ import annotations

import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from rx90_common.exchange.client_node import client_node
from rx90_common.process.children import ProcessGroup, executable
from rx90_controller.node.trajectory_client import NewestPositions, TrajectoryClient
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.correction import Correction
from rx90_emulator.correction.learning import Measured
from rx90_emulator.correction.path import CorrectablePath, Nominal
from rx90_emulator.correction.recorded import CORRECTION, REFERENCE, TRACKING, measured
from rx90_emulator.identification.experiments.motion import Motion
from rx90_emulator.identification.experiments.nodes import follow_trajectory
from rx90_emulator.loop.setup import Setup

_APPROACH_SPEED, _APPROACH_ACCELERATION = 0.25, 2.0  # share of the joints' speeds; rad/s^2
_HELD = 0.5  # s at the start of the path, until the arm stands
_SENSOR = 0.5  # s for which a sensor of the tip may lag


class NodeTrials:
    """Plays trials on the nodes of a controller; made by `node_trials`."""

    def __init__(
        self, setup: Setup, path: CorrectablePath, set_points: NewestPositions, follow: partial[float],
        recorders: ProcessGroup, folder: Path, timeout: float, tip_topic: str | None,
    ) -> None:  # fmt: skip
        self._setup, self._path, self._set_points, self._follow = setup, path, set_points, follow
        self._recorders, self._folder, self._timeout, self._tip_topic = recorders, folder, timeout, tip_topic
        self._nominal, self._number = Nominal.of(setup, path.points, path.counted), 0

    def play(self, correction: Correction) -> Measured:
        """Run one trial.

        Raises:
            ExchangeError: if a node does not answer, or a trajectory is refused.
            ProcessError: with what the recorder says, if it loses messages.
            BagError, ConfigError: as `tip_of_file`, where the tip is measured.
        """
        names, points = self._setup.robot.joint_names, self._path.points
        motion = Motion(np.asarray(self._set_points.position))
        motion.move(points.position[0], self._setup.robot.max_velocity * _APPROACH_SPEED, _APPROACH_ACCELERATION)
        if motion.duration > 0.0:
            motion.rest(_HELD)
            self._run(motion.points(names))
        bag = self._folder / f"trial_{self._number}"
        self._number += 1
        topics = ["joint_states", REFERENCE, TRACKING, CORRECTION, *([self._tip_topic] if self._tip_topic else [])]
        command = executable("rx90_bag", "record", "--output", bag, *topics)
        recorder = self._recorders.start(f"recorder of {bag.name}", command)
        recorder.wait_for("ready: all", self._timeout)
        self._run(replace(points, correction=correction))
        if self._tip_topic is not None:
            time.sleep(_SENSOR)
        recorder.signal(signal.SIGINT)
        recorder.expect_success(self._timeout)
        tip = None if self._tip_topic is None else bag
        found = measured(self._setup, self._nominal, bag, tip, tip_topic=self._tip_topic)[0]
        shutil.rmtree(bag, ignore_errors=True)
        return found

    def _run(self, points: TrajectoryPoints) -> None:
        self._follow(points, lambda _: None)


@contextmanager
def node_trials(
    setup: Setup, path: CorrectablePath, controller: str, timeout: float, tip_topic: str | None = None
) -> Iterator[NodeTrials]:
    """Yield what plays trials on running nodes.

    Args:
        setup: robot and controller.
        path: what is corrected.
        controller: name of the controller node.
        timeout: longest wait for a node, s.
        tip_topic: of a sensor that measures the tip, as `tip_of_file` reads it; None for none.

    Raises:
        ConfigError: if that cannot be a node's name.
        ExchangeError: if a node does not show up.
    """
    with (
        tempfile.TemporaryDirectory(prefix="rx90_correct_") as name,
        client_node("rx90_correct", timeout, partial(print, flush=True)) as client,
        ProcessGroup(grace=20.0) as recorders,
    ):
        trajectory = TrajectoryClient(client, controller)
        trajectory.wait_for_controller()
        names = setup.robot.joint_names
        set_points = trajectory.set_points(names)
        follow = partial(follow_trajectory, client, trajectory, names, set_points)
        yield NodeTrials(setup, path, set_points, follow, recorders, Path(name), timeout, tip_topic)
