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
import rclpy
from builtin_interfaces.msg import Duration
from numpy.typing import NDArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from tqdm import tqdm
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.description.robot import RobotModel
from rx90_common.process.children import ProcessGroup, executable
from rx90_common.process.interrupts import interrupts_later
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.identification.experiments.folder import TOPICS, write_index
from rx90_emulator.identification.experiments.motion import Motion
from rx90_emulator.identification.experiments.plan import Experiment

Array = NDArray[np.float64]

_POLL = 0.05  # s
_ATTEMPTS = 3  # of an experiment whose recorder loses messages
_PATIENCE = 5.0  # s of the controller's time, for a trajectory to begin and beyond its end
_AT_REST = 1e-6  # rad
_START_TOLERANCE = 5e-4  # rad, from where the arm is to the start of a trajectory
_APPROACH_SPEED, _APPROACH_ACCELERATION = 0.25, 2.0


class ExperimentRunner:
    """Publishes trajectories to the controller node and follows them; needs no rclpy.init of the caller.

    Args:
        robot: for the joints' names and speeds.
        controller: name of the controller node.
        timeout: longest wait for a node, and for simulated time to go on, s.
    """

    def __init__(self, robot: RobotModel, controller: str, timeout: float) -> None:
        self._robot, self._controller, self._timeout = robot, controller, timeout
        self._context = Context()
        self._stamp = -1.0
        self._reference: Array | None = None

    def run(self, plan: Sequence[Experiment], folder: Path, say: Callable[[str], None]) -> None:
        """Run and record the experiments one after the other; after Ctrl-C the bags that are complete stay.

        Raises:
            ExchangeError: if a node does not show up, time stands still, or the controller refuses a trajectory.
            ProcessError: if the recorder loses messages again and again, or ends early.
        """
        with interrupts_later() as check_interrupt:
            rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
            try:
                self._open(check_interrupt)
                self._run(plan, folder, say)
            finally:
                self._context.try_shutdown()

    def _open(self, check_interrupt: Callable[[], None]) -> None:
        self._check_interrupt = check_interrupt
        self._node = rclpy.create_node("rx90_experiment", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._publisher = self._node.create_publisher(JointTrajectory, f"{self._controller}/joint_trajectory", 1)
        # One message in the queue: only the newest is looked at.
        latest = QoSProfile(depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._node.create_subscription(JointState, f"{self._controller}/reference", self._take, latest)

    def _take(self, message: JointState) -> None:
        position = dict(zip(message.name, message.position, strict=False))
        if set(self._robot.joint_names) <= position.keys():
            self._reference = np.array([position[name] for name in self._robot.joint_names])
            self._stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9

    def _run(self, plan: Sequence[Experiment], folder: Path, say: Callable[[str], None]) -> None:
        # The context of a constructor's node ends with it; a recorder that still runs is ended in order.
        with ProcessGroup(folder, grace=20.0) as recorders:
            self._wait(lambda: self._publisher.get_subscription_count() > 0, "controller that takes trajectories")
            self._wait(lambda: self._reference is not None, "set-points of the controller")
            self._approach(plan[0].points.position[0], say)
            total = sum(experiment.duration for experiment in plan)
            layout = "{l_bar}{bar}| {n:.0f}/{total:.0f} s [{elapsed}<{remaining}]"
            interval = 0.2 if sys.stderr.isatty() else 3.0
            with tqdm(total=total, bar_format=layout, mininterval=interval, miniters=0) as bar:
                for number, experiment in enumerate(plan):
                    bar.set_description_str(experiment.name)
                    self._record(experiment, folder, recorders, bar)
                    write_index(folder, plan[: number + 1])

    def _approach(self, start: Array, say: Callable[[str], None]) -> None:
        assert self._reference is not None
        gap = float(np.abs(start - self._reference).max())
        if gap <= _START_TOLERANCE:
            return
        motion = Motion(self._reference)
        motion.move(start, self._robot.max_velocity * _APPROACH_SPEED, _APPROACH_ACCELERATION)
        say(f"approach: {math.degrees(gap):.1f} deg, {motion.duration:.1f} s")
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
        recorder.wait_for("ready: all", self._timeout)
        done = bar.n
        self._follow(experiment.points, lambda elapsed: bar.update(done + elapsed - bar.n))
        recorder.signal(signal.SIGINT)
        code = recorder.wait(self._timeout)
        bar.update(done + (experiment.duration if code == 0 else 0.0) - bar.n)
        return code, recorder.log

    def _follow(self, points: TrajectoryPoints, show: Callable[[float], object]) -> None:
        """Send a trajectory and wait until the controller's set-points are at its end."""
        # The newest stamp: while the recorder started nobody looked.
        for _ in range(3):
            self._spin()
        begin, duration, before, end = self._stamp, float(points.times[-1]), self._reference, points.position[-1]
        assert before is not None
        self._publisher.publish(_message(points, self._robot.joint_names))
        moved, seen, deadline = False, begin, time.monotonic() + self._timeout
        while not (self._stamp > begin + duration + _POLL and moved and self._is_at(end)):
            self._spin()
            moved = moved or not self._is_at(before)
            if self._stamp > seen:
                seen, deadline = self._stamp, time.monotonic() + self._timeout
            elif time.monotonic() > deadline:
                raise ExchangeError(f"the controller's time stood still at {seen:.3f} s for {self._timeout:g} s")
            late = self._stamp - begin - (duration if moved else 0.0)
            if late > _PATIENCE:
                raise ExchangeError("the controller did not run the trajectory to its end; it says why on its terminal")
            show(min(max(0.0, self._stamp - begin), duration))

    def _is_at(self, position: Array) -> bool:
        assert self._reference is not None
        return bool(np.abs(self._reference - position).max() <= _AT_REST)

    def _wait(self, ready: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + self._timeout
        while not ready():
            if time.monotonic() > deadline:
                raise ExchangeError(f"found no {what} within {self._timeout:g} s")
            self._spin()

    def _spin(self) -> None:
        self._executor.spin_once(timeout_sec=_POLL)
        # The newest message is enough; in between the processor is the nodes'.
        time.sleep(_POLL / 2.0)
        self._check_interrupt()


def _message(points: TrajectoryPoints, names: Sequence[str]) -> JointTrajectory:
    """Return the trajectory with stamp 0: it begins when it arrives."""
    message = JointTrajectory(joint_names=list(names))
    assert points.velocity is not None
    assert points.acceleration is not None
    rows = zip(points.times, points.position, points.velocity, points.acceleration, strict=True)
    for instant, position, velocity, acceleration in rows:
        whole, part = divmod(round(float(instant) * NANOSECONDS), NANOSECONDS)
        message.points.append(
            JointTrajectoryPoint(
                positions=position.tolist(),
                velocities=velocity.tolist(),
                accelerations=acceleration.tolist(),
                time_from_start=Duration(sec=whole, nanosec=part),
            )
        )
    return message
