"""A controller on the simulation's topics: each case has a simulation of its own, in this process and in lock-step.

The simulation is the node `rx90_sim` as users run it. Its messages pass a channel that records them, starts the
trajectory at the same tick in each run, and disturbs commands as the case requires.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import yaml_text
from rx90_common.base.errors import DivergenceError, ExchangeError
from rx90_common.exchange import lifecycle
from rx90_common.exchange.cdr import JointStateCodec, cdr_stamp_ns
from rx90_common.exchange.channel import Channel
from rx90_common.exchange.endpoints import LATCHED_QOS, STATE_QOS, TRAJECTORY_QOS, wait_until_received
from rx90_common.exchange.ros_start import controller_topic
from rx90_common.exchange.topics import TRAJECTORY_ACCEPTED, motor_names
from rx90_common.process.children import ChildProcess, ProcessGroup
from rx90_common.process.files import write_text
from rx90_common.process.interrupts import deferred_interrupts
from rx90_controller.node.trajectory_client import trajectory_message
from rx90_emulator.conformance.battery import START, Case, Record, files_of
from rx90_sim.node.simulation import Simulation

LEAD = 0.02
"""Time before its stamp at which a set-point is published, s."""
_SLICE = 0.02  # s
_HANDED_OVER = 0.5  # s on the wall clock, for a controller that does not acknowledge a message
_GRACE = 10.0  # s, for a controller to end


@dataclass(frozen=True)
class Candidate:
    """The controller that is checked.

    Attributes:
        command: that starts it, once for each case; empty for a running node.
        node: its name.
        reference: topic for set-points as JointState, one in each tick of the position loop; None for a controller that
            takes a trajectory on `<node>/joint_trajectory`.
        at_joints, ticks: kind and period of its commands, as in `Record`.
        timeout: longest wait for it, s of the wall clock.
    """

    command: Sequence[str]
    node: str
    reference: str | None
    at_joints: bool
    ticks: int
    timeout: float


class _Stopped(Exception):  # noqa: N818 - no error: the caller has requested it
    """The run is to end while its channel waits."""


class _Run:
    """One case on the topics: the simulation node, and further work of its ticking thread.

    Attributes:
        check_interrupt: raises the interrupt that came before the node took them over.
    """

    check_interrupt: Callable[[], None]

    def __init__(
        self, case: Case, set_points: Array, candidate: Candidate, child: ChildProcess | None,
        progress: Callable[[int], None],
    ) -> None:  # fmt: skip
        self.case, self.candidate, self._child, self._progress = case, candidate, child, progress
        self.record = Record(case, candidate.at_joints, candidate.ticks)
        self._set_points, self._sent = set_points, 0
        self._gate = case.setup.rates.ticks_of(START / 2.0)
        self._stopped = self._trajectory_sent = self._accepted = False
        self._last_activity = time.monotonic()
        self._channel: Channel | None = None

    def make(self) -> list[_Run]:
        """Make the simulation, with this object as the one that `lifecycle` runs."""
        self._simulation = Simulation(partial(_CheckedChannel, run=self))
        self.node: Any = self._simulation.node
        if self.candidate.reference is None:
            self._trajectory = trajectory_message(self.case.setup.robot.joint_names, self.case.points, START)
            topic, kind = controller_topic(self.node, self.candidate.node), type(self._trajectory)
            self._publisher = self.node.create_publisher(kind, topic, TRAJECTORY_QOS)
            self._accepts = f"{topic.rpartition('/')[0]}/{TRAJECTORY_ACCEPTED}"
            self.node.create_subscription(kind, self._accepts, self._note_accepted, LATCHED_QOS)
        else:
            self._point = np.zeros((2, len(self.case.setup.robot.joint_names)))
            self._encode = JointStateCodec(self.case.setup.robot.joint_names).encoder(*self._point)
        lifecycle.started([self._simulation])
        return [self]

    def tick_loop(self) -> None:
        """Run the simulation's ticks."""
        with suppress(_Stopped):
            self._simulation.tick_loop()

    def stop(self) -> None:
        """End `tick_loop` soon."""
        self._stopped = True
        self._simulation.stop()

    # The ticking thread.

    def channel_made(self, channel: Channel) -> None:
        """Make the publisher of set-points; keep the channel, which locks its topics until it is closed."""
        self._channel = channel
        if self.candidate.reference is not None:
            joint_state = channel.publisher.msg_type
            self._publisher = self.node.create_publisher(joint_state, self.candidate.reference, STATE_QOS)

    def close(self) -> None:
        """Release the topics for the next simulation."""
        if self._channel is not None:
            self._channel.close()

    def before(self, tick: int) -> None:
        """Do the work that is due before the states of a tick are published."""
        self.check_interrupt()
        self._progress(tick)
        if self.candidate.reference is not None:
            self._publish_set_points(tick)
        elif tick >= self._gate and not self._trajectory_sent:
            self._trajectory_sent = True
            self._send_trajectory()
        self.note_activity()

    def _publish_set_points(self, tick: int) -> None:
        if tick == 0:
            self._wait(self._publisher.get_subscription_count, "subscribes to the set-points")
        rates = self.case.setup.rates
        until = tick // rates.ratio + round(LEAD * rates.position_hz)
        for number in range(self._sent, min(until + 1, len(self._set_points))):
            self._point[:] = self._set_points[number, :2]
            self._publisher.handle.publish_raw(self._encode(number * rates.ratio * rates.period_ns))
            self._sent = number + 1
        if tick == 0:
            self._hand_over()

    def _send_trajectory(self) -> None:
        """Send the trajectory while time stands still; continue when the controller has it."""
        self._wait(self._publisher.get_subscription_count, "subscribes to it")
        self._publisher.publish(self._trajectory)
        if self.node.count_publishers(self._accepts):
            self._wait(lambda: self._accepted, f"has accepted a trajectory, by {self._accepts}")
        else:
            self._hand_over()

    def _hand_over(self) -> None:
        """Let a controller process its messages while time stands still."""
        wait_until_received([self._publisher])
        handed_over = time.monotonic() + _HANDED_OVER
        self._wait(lambda: time.monotonic() > handed_over, "has it")

    def _note_accepted(self, _message: object) -> None:
        self._accepted = self._trajectory_sent  # a latched message of the previous case does not count

    def _wait(self, ready: Callable[[], object], what: str) -> None:
        self.note_activity()
        while not ready():
            self.look(f"nobody {what}, on {self._publisher.topic_name},")
            time.sleep(_SLICE)

    def note_activity(self) -> None:
        """Note the time of the controller's last activity."""
        self._last_activity = time.monotonic()

    def look(self, wrong: str = "the controller sent no command that the simulation takes") -> None:
        """Raise an error for a controller that has ended, or is silent for too long, with `wrong` as the reason."""
        self.check_interrupt()
        if self._stopped:
            raise _Stopped
        name, timeout, child = self.case.name, self.candidate.timeout, self._child
        log = "" if child is None else f"; see {child.log}"
        if child is not None and child.returncode is not None:
            last_line = child.lines[-1] if child.lines else "it printed nothing"
            raise ExchangeError(
                f"case {name}: the controller has ended with exit code {child.returncode}: {last_line}{log}"
            )
        if time.monotonic() - self._last_activity > timeout:
            raise ExchangeError(f"case {name}: {wrong} within {timeout:g} s{log}")


class _CheckedChannel(Channel):
    """The simulation's end of the exchange, with the disturbances of a case."""

    def __init__(self, *arguments: Any, run: _Run) -> None:
        super().__init__(*arguments)
        self._run, case = run, run.case
        run.channel_made(self)
        joints = case.setup.robot.joint_names
        names = joints if run.candidate.at_joints else motor_names(len(joints))
        self._states, self._commands = JointStateCodec(names), JointStateCodec(names)
        self._period_ns, self._stamp, self._before = case.setup.rates.period_ns, -1, -1

    def publish(self, raw: bytes) -> None:
        """Publish states, after the work that is due before them; twice if the case requires it."""
        stamp, position, _, _ = self._states.decode(raw)
        tick = stamp // self._period_ns
        if stamp != self._stamp:
            self._before, self._stamp = self._stamp, stamp
            assert position is not None
            self._run.record.note_states(tick, position)
            self._run.before(tick)
        super().publish(raw)
        if self._run.case.twice is not None and self._run.case.twice[tick]:
            super().publish(raw)

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next command as the drives receive it."""
        raw = super().receive(timeout_s)
        while raw is not None and cdr_stamp_ns(raw) == self._before:  # the second answer to repeated states
            raw = super().receive(timeout_s)
        if raw is None:
            self._run.look()
        elif cdr_stamp_ns(raw) == self._stamp:
            self._run.note_activity()
            try:
                effort = self._commands.decode(raw)[3]
            except ExchangeError:  # the simulation says what is wrong with it
                return raw
            carried = self._run.record.carry(self._stamp // self._period_ns, effort)
            return self._commands.encode(self._stamp, effort=carried)
        return raw


def run_on_topics(
    case: Case, set_points: Array, candidate: Candidate, folder: Path, progress: Callable[[int], None]
) -> Record:
    """Run a case with the checked controller, from the start of its process to its end.

    Args:
        case: the case.
        set_points: one for each tick of the position loop, shape (m, 3, n).
        candidate: the controller.
        folder: for the controller's log, and parameters.
        progress: called with the number of each tick.

    Raises:
        ExchangeError: for a controller that does not appear, ends, or does not answer.
        KeyboardInterrupt: after Ctrl-C.
    """
    parameters = folder / f"{case.name}.yaml"
    write_text(parameters, yaml_text({"/**/rx90_sim": {"ros__parameters": _parameters(case, candidate)}}))
    arguments = ["--ros-args", "--log-level", "rx90_sim:=warn", "--params-file", str(parameters)]
    if "/" in candidate.node.strip("/"):
        arguments += ["-r", f"__ns:=/{candidate.node.strip('/').rpartition('/')[0]}"]
    with ProcessGroup(folder, _GRACE) as group:
        child = group.start(case.name, candidate.command) if candidate.command else None
        run = _Run(case, set_points, candidate, child, progress)
        try:
            with deferred_interrupts() as run.check_interrupt:  # which puts back the handlers that the nodes set
                lifecycle.spin(run.make, arguments)
        except DivergenceError as error:
            run.record.fault = str(error)
        finally:
            run.close()
    if run.record.fault is None and len(run.record.times) < -(-case.ticks // candidate.ticks):
        raise KeyboardInterrupt
    return run.record


def _parameters(case: Case, candidate: Candidate) -> dict[str, Any]:
    """Return the simulation's parameters."""
    files, rates = files_of(case.setup), case.setup.rates
    parameters = {
        **{role: files.text(role) for role in ("urdf", "tool", "drives", "friction")},
        "base_rate": rates.base_hz,
        "position_rate": rates.position_hz,
        "initial_position": np.asarray(case.points.position[0]).tolist(),
        "duration": case.ticks / rates.base_hz,
        "real_time_factor": 0.0,
        "seed": case.setup.seed,
    }
    if candidate.at_joints:
        parameters |= {"command_interface": "joint", "command_rate": rates.base_hz // candidate.ticks}
    return parameters
