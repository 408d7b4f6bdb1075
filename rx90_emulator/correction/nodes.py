"""Trials on running nodes: the arm goes to the start of the path, plays the correction, and is recorded."""

from __future__ import annotations

import shutil
import signal
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np

from rx90_common.exchange.client_node import client_node
from rx90_common.process.children import ProcessGroup, executable
from rx90_controller.lines.plan import APPROACH_ACCELERATION, APPROACH_SPEED
from rx90_controller.node.trajectory_client import TrajectoryClient
from rx90_controller.trajectory.correction import Correction
from rx90_controller.trajectory.motion import Motion
from rx90_emulator.correction.learning import Learner, Measured
from rx90_emulator.correction.recorded import CORRECTION, REFERENCE, TRACKING, measured
from rx90_emulator.identification.experiments.nodes import follow_trajectory

# s at the start of the path: the integrators take some 0.1 s, then the arm is at rest
_REST_S = 0.5
_GRACE = 20.0  # s for a recorder to write its messages


@contextmanager
def node_trials(
    learner: Learner, controller: str, timeout: float
) -> Iterator[Callable[[Correction], Measured]]:
    """Yield the function that plays a trial on running nodes.

    A trial raises ExchangeError if a node does not answer or a trajectory is refused, ProcessError with the recorder's
    message if it loses messages, and the errors of `measured`.

    Args:
        learner: of the path.
        controller: name of the controller node.
        timeout: longest wait for a node, s.

    Raises:
        ExchangeError: if a node does not appear.
    """
    robot = learner.setup.robot
    points = learner.path.points
    topics = ["joint_states", REFERENCE, TRACKING]
    with (
        tempfile.TemporaryDirectory(prefix="rx90_correct_") as name,
        client_node("rx90_correct", timeout, partial(print, flush=True)) as client,
        ProcessGroup(grace=_GRACE) as recorders,
    ):
        trajectory = TrajectoryClient(client, controller)
        trajectory.wait_for_controller()
        set_points = trajectory.set_points(robot.joint_names)
        follow = partial(
            follow_trajectory,
            client,
            trajectory,
            robot.joint_names,
            set_points,
            show=lambda *_: None,
        )
        numbers = count()

        def approach() -> None:
            motion = Motion(np.asarray(set_points.position))
            motion.move(
                points.position[0], robot.max_velocity * APPROACH_SPEED, APPROACH_ACCELERATION
            )
            if motion.duration > 0.0:
                motion.rest(_REST_S)
                follow(motion.points(robot.joint_names))

        def play(correction: Correction) -> Measured:
            number = next(numbers)
            if number == 0:
                # Each trial comes from the path's end, with friction as that leaves it; the first one, too.
                approach()
                follow(points, correction)
            approach()
            bag = Path(name) / f"trial_{number}"
            # without offsets nothing is published
            played = [CORRECTION] if correction.offsets.any() else []
            words = executable("rx90 bag", "record", "--output", bag, *topics, *played)
            recorder = recorders.start(f"recorder of {bag.name}", words)
            recorder.wait_for("ready: all", timeout)
            follow(points, correction)
            recorder.signal(signal.SIGINT)
            recorder.expect_success(timeout)
            errors, _ = measured(learner.setup, learner.nominal, bag, None)
            shutil.rmtree(bag, ignore_errors=True)
            return errors

        yield play
