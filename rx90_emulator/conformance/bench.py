"""A controller on the simulation's topics: each case has a simulation of its own, in this process and in lock-step.

The simulation is the node `rx90_sim` as users run it. Its messages pass a channel that records them, and sends the
set-points at the same tick in each run.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rx90_common.base.config import yaml_text
from rx90_common.base.errors import DivergenceError, ExchangeError
from rx90_common.exchange import lifecycle
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.channel import Channel
from rx90_common.exchange.endpoints import STATE_QOS, TRAJECTORY_QOS
from rx90_common.exchange.ros_start import controller_topic
from rx90_common.exchange.topics import motor_names
from rx90_common.process.children import ChildProcess, ProcessGroup
from rx90_common.process.files import write_text
from rx90_common.process.interrupts import deferred_interrupts
from rx90_controller.node.trajectory_client import trajectory_message
from rx90_emulator.conformance.case import START, Case, Record
from rx90_sim.node.parameters import FILE_PARAMETERS
from rx90_sim.node.simulation import Simulation

_LEAD = 0.02  # s from the publication of a set-point to its stamp
_GRACE = 10.0  # s, for a controller to end


@dataclass(frozen=True)
class Candidate:
    """The controller that is checked.

    Attributes:
        command: that starts it, once for each case; empty for a running node.
        node: its name.
        set_point_topic: for set-points as JointState, one in each tick of the position loop; None for a controller
            that takes a trajectory on `<node>/joint_trajectory`.
        at_joints: whether it commands efforts at the joints.
        ticks_per_command: base ticks from one command to the next.
        timeout: longest wait for it, s of the wall clock.
    """

    command: Sequence[str]
    node: str
    set_point_topic: str | None
    at_joints: bool
    ticks_per_command: int
    timeout: float


class _RecordingChannel(Channel):
    """The simulation's end of the exchange: it gives set-points, and records.

    Args:
        record: to be filled.
        candidate: the controller.
        child: its process, None for a node that runs already.
        check_interrupt: raises an interrupt that came before the node took them over.
        node: of the simulation.
        endpoints: further arguments of `Channel`.
    """

    def __init__(
        self, record: Record, candidate: Candidate, child: ChildProcess | None, check_interrupt: Callable[[], None],
        node: Any, *endpoints: Any,
    ) -> None:  # fmt: skip
        super().__init__(node, *endpoints)
        self._check_interrupt = check_interrupt
        self._record = record
        self._candidate = candidate
        self._child = child
        case = record.case
        joints = case.setup.robot.joint_names
        names = joints if record.at_joints else motor_names(len(joints))
        self._states = JointStateCodec(names)
        self._commands = JointStateCodec(names)
        self._handed_over = False
        self._last_activity = time.monotonic()
        if candidate.set_point_topic is None:
            message = trajectory_message(joints, case.points, START)
            self._due: deque[tuple[int, Any]] = deque(
                [(case.setup.rates.ticks_of(START / 2.0), message)]
            )
            self._giver = node.create_publisher(
                type(message), controller_topic(node, candidate.node), TRAJECTORY_QOS
            )
        else:
            self._due = deque(_set_points(case))
            self._giver = node.create_publisher(
                self.publisher.msg_type, candidate.set_point_topic, STATE_QOS
            )

    def publish(self, raw: bytes) -> None:
        """Publish states, after the set-points that are due before them."""
        self._stamp, position, _, _ = self._states.decode(raw)
        self._position = position
        if self._give(self._stamp // self._record.case.setup.rates.period_ns):
            super().publish(raw)

    def _give(self, tick: int) -> bool:
        """Publish the set-points that are due; return whether time may go on.

        Not while nobody is there to receive them, and not at the first, so that the controller has them before the
        states: without states there is no command, and after a second lock-step publishes the states again.
        """
        if not self._due or self._due[0][0] > tick:
            return True
        if not self._giver.get_subscription_count():
            return False
        while self._due and self._due[0][0] <= tick:
            self._giver.publish(self._due.popleft()[1])
        handed_over = self._handed_over
        self._handed_over = True
        return handed_over

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next command, which is recorded."""
        raw = super().receive(timeout_s)
        if raw is None:
            self._check_controller()
            return None
        stamp, _, _, effort = self._commands.decode(raw)
        if stamp == self._stamp and self._position is not None:
            self._last_activity = time.monotonic()
            self._record.note(
                stamp // self._record.case.setup.rates.period_ns, self._position, effort
            )
        return raw

    def _check_controller(self) -> None:
        """Raise an error for a controller that has ended, or is silent for too long."""
        self._check_interrupt()
        if self._child is not None and self._child.returncode is not None:
            self._child.expect_success()
        if time.monotonic() - self._last_activity > self._candidate.timeout:
            raise ExchangeError(
                f"no command that the simulation takes within {self._candidate.timeout:g} s; set-points are on "
                f"{self._giver.topic_name}"
            )


def _set_points(case: Case) -> Iterator[tuple[int, bytes]]:
    """Yield set-points as JointState, each with the tick in which it is published."""
    rates = case.setup.rates
    codec = JointStateCodec(case.setup.robot.joint_names)
    for number, (position, velocity, _) in enumerate(case.set_points):
        tick = number * rates.ratio
        yield tick - rates.ticks_of(_LEAD), codec.encode(tick * rates.period_ns, position, velocity)


def run_on_topics(case: Case, candidate: Candidate, folder: Path) -> Record:
    """Run a case with the checked controller, from the start of its process to its end.

    Args:
        case: the case.
        candidate: the controller.
        folder: for the controller's log, and parameters.

    Raises:
        ExchangeError: for a controller that does not appear, ends, or does not answer.
        ProcessError: for one that ends with an exit code other than 0.
        KeyboardInterrupt: after Ctrl-C.
    """
    parameters = folder / f"{case.name}.yaml"
    write_text(
        parameters, yaml_text({"/**/rx90_sim": {"ros__parameters": _parameters(case, candidate)}})
    )
    namespace = candidate.node.strip("/").rpartition("/")[0]
    arguments = ["--ros-args", "--log-level", "rx90_sim:=warn", "--params-file", str(parameters)]
    arguments += ["-r", f"__ns:=/{namespace}"]
    record = Record(case, candidate.at_joints, candidate.ticks_per_command)
    channels: list[_RecordingChannel] = []
    # The handlers of signals that the nodes set are put back.
    with deferred_interrupts() as check_interrupt, ProcessGroup(folder, _GRACE) as group:
        child = group.start(case.name, candidate.command) if candidate.command else None

        def make_channel(*endpoints: Any) -> Channel:
            channels.append(
                _RecordingChannel(record, candidate, child, check_interrupt, *endpoints)
            )
            return channels[-1]

        try:
            lifecycle.spin(lambda: lifecycle.started([Simulation(make_channel)]), arguments)
        except DivergenceError as error:
            record.fault = str(error)
        finally:
            for channel in channels:
                channel.close()
    if not record.fault and not record.complete:
        raise KeyboardInterrupt
    return record


def _parameters(case: Case, candidate: Candidate) -> dict[str, Any]:
    parameters = {
        **{role: case.setup.files.text(role) for role in FILE_PARAMETERS},
        "initial_position": case.points.position[0].tolist(),
        "duration": case.ticks * case.setup.rates.period,
        "real_time_factor": 0.0,
    }
    if candidate.at_joints:
        parameters |= {
            "command_interface": "joint",
            "command_rate": case.setup.rates.base_hz // candidate.ticks_per_command,
        }
    return parameters
