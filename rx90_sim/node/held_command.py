"""Commands at the joints; commands held while recent in free-running time; reasons why a controller's do not arrive."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.exchange.cdr_stamps import cdr_stamp_ns
from rx90_common.exchange.channel import TickChannel
from rx90_common.exchange.lockstep import stamped
from rx90_common.exchange.pacing import OnceLog
from rx90_common.exchange.topics import COMMAND_INTERFACES
from rx90_sim.plant import JointInterface

MAX_AGE = 3
"""Ticks from the states that a command answers to the last that it is applied in: docs/explanation/free_running.md."""
_LINES = 4  # about the brakes in _LINES_WINDOW; of more changes the newest is said later
_LINES_WINDOW = 10.0  # s
# commands that are not newer than the one before, within _WINDOW, that make two controllers
_OUT_OF_ORDER_COUNT = 3
_WINDOW = 5.0  # s
_ELSEWHERE = 3  # stamps in a row that make another clock; commands from before a reset are fewer
_SLICE = 0.05  # s of a wait after which interruptions are looked at


class HeldCommand:
    """Holds the newest command, and waits for one only when the newest is older than `MAX_AGE` ticks.

    A command's age is counted from the states that it answers, by its stamp: it stays the same while time stands still.
    The loops tolerate a few ticks of delay and no more. So if a controller is late for longer, time waits for it,
    because an old torque would move the arm; if it sends nothing for the whole timeout, the torque is switched off, and
    time runs on.

    Args:
        channel: receives commands.
        decode: returns the torques of a message, Nm at the motors, None for torque off; raises ExchangeError.
        period_ns: length of a tick.
        timeout: how long to wait for a command, s.
        announce: prints a line for the user.
        complain: reports a faulty command; there may be thousands of them in a second.
        interrupted: returns whether another thread waits for the ticking one.

    Attributes:
        two_controllers: whether two controllers send commands.
        missed: number of ticks, from the first command on, for which no recent command had arrived.
        waited: ticks that had to wait for one.
    """

    def __init__(
        self,
        channel: TickChannel,
        decode: Callable[[bytes], Array | None],
        period_ns: int,
        timeout: float,
        announce: Callable[[str], None],
        complain: Callable[[str], None],
        interrupted: Callable[[], bool],
    ) -> None:
        self._channel = channel
        self._topic = channel.subscribe_topic
        self._decode = decode
        self._period_ns = period_ns
        self._announce = announce
        self._complain = complain
        self._interrupted = interrupted
        self._timeout = timeout
        self._oldest = max(MAX_AGE, round(timeout * NANOSECONDS / period_ns))
        self.forget()
        self._out_of_order: deque[float] = deque(maxlen=_OUT_OF_ORDER_COUNT)
        self.two_controllers = False
        self.missed = self.waited = 0
        self._closed = False  # the brakes, as far as changes were noted
        self._unsaid = False  # whether a change of the brakes has not been announced
        self._lines: deque[float] = deque(maxlen=_LINES)

    def forget(self) -> None:
        """Drop the command, after a reset."""
        self._torques: Array | None = None
        self._answered: int | None = None  # the tick whose states the command answers
        self._followed = False
        self._stamp = -1

    def take(self, tick: int) -> Array | None:
        """Return the torques to hold in tick `tick`, None for brakes closed."""
        if self._receive(tick, 0.0):
            self._followed = True
        elif self._answered is not None:
            self.missed += 1
        if self.two_controllers:
            if time.monotonic() - self._out_of_order[-1] > _WINDOW:
                self.two_controllers = False
                self._out_of_order.clear()
                self._announce(f"one controller is left on {self._topic}")
        elif self._followed and self._too_old(tick):
            self._followed = self._wait(tick)
        torques = self._torques if self._followed else None
        if (torques is not None) == self._closed or self._unsaid:
            self._announce_brakes(torques is not None)
        return None if self.two_controllers else torques

    def _too_old(self, tick: int) -> bool:
        return self._answered is None or tick - self._answered > MAX_AGE

    def _wait(self, tick: int) -> bool:
        """Wait for a command that is new enough; return whether there is one to go on with."""
        self.waited += 1
        deadline = time.monotonic() + self._timeout
        while self._too_old(tick) and not self.two_controllers:
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                return False
            if self._interrupted():
                return True
            self._receive(tick, min(remaining, _SLICE))
        return True

    def _receive(self, tick: int, timeout: float) -> bool:
        """Receive what has arrived, or arrives within `timeout` seconds; return whether there is a command to apply."""
        raw = self._channel.receive(timeout)
        found = False
        while raw is not None:
            try:
                found = self._use(raw, tick) or found
            except ExchangeError as error:
                self._complain(f"{self._topic}: {error}; the message is ignored")
            raw = self._channel.receive(0.0)
        return found

    def _use(self, raw: bytes, tick: int) -> bool:
        """Hold a command; return whether it is newer than the one before.

        Raises:
            ExchangeError: if it is not a command, or not one for this tick.
        """
        torques = self._decode(raw)
        answered = self._tick_answered(cdr_stamp_ns(raw), tick)
        if answered is None:
            return False
        self._answered = answered
        self._torques = None if torques is None else torques.copy()
        return True

    def _tick_answered(self, stamp: int, tick: int) -> int | None:
        """Return the tick of the states that a command with this stamp, ns, answers; None if it is out of order."""
        if stamp <= self._stamp:
            self._note_out_of_order()
            return None
        answered = stamp // self._period_ns
        if not (stamp >= 0 and 0 <= tick - answered <= self._oldest):
            raise ExchangeError(
                f"the stamp is {stamp / NANOSECONDS:.6g} s at {tick * self._period_ns / NANOSECONDS:.6g} s; "
                f"accepted: that of the states it answers, up to {self._timeout:g} s old"
            )
        self._stamp = stamp
        return answered

    def _note_out_of_order(self) -> None:
        """A controller answers each tick once and in order, but for the moment in which it begins again."""
        now = time.monotonic()
        self._out_of_order.append(now)
        often = (
            len(self._out_of_order) == _OUT_OF_ORDER_COUNT and now - self._out_of_order[0] < _WINDOW
        )
        if often and not self.two_controllers and self._channel.matches().publishers > 1:
            self.two_controllers = True
            self._announce(f"two controllers publish on {self._topic}: no torque until one is left")

    def _announce_brakes(self, opened: bool) -> None:
        """Report that the brakes have opened or closed; if that happens too often, the newest change alone, later."""
        self._closed = not opened
        self._unsaid = True
        now = time.monotonic()
        if len(self._lines) == _LINES and now - self._lines[0] < _LINES_WINDOW:
            return
        self._lines.append(now)
        self._unsaid = False
        if opened:
            text = f"commands on {self._topic}: the brakes open"
        elif self._followed:
            text = f"commands on {self._topic} without effort: torque off, brakes closed"
        elif self._answered is None:
            text = f"waiting for a controller on {self._topic}: the brakes hold the arm"
        else:
            text = f"no command on {self._topic} for {self._timeout:g} s: torque off, brakes closed"
        self._announce(text)


class NewestCommand(HeldCommand):
    """Holds the newest joint command while time goes on, until it is older than a limit.

    Its age is counted from the states whose stamp it has. A controller that uses a clock of its own, or sends no
    stamps, is recognised by stamps that are no recent simulated times; the age of its commands is counted from their
    arrival.
    `timeout`
    is the age at which the torque is switched off, s.
    """

    def forget(self) -> None:
        """Drop the command, after a reset."""
        super().forget()
        self._elsewhere = 0  # stamps in a row that are not simulated times of late

    def _too_old(self, tick: int) -> bool:
        return self._answered is None or tick - self._answered > self._oldest

    def _wait(self, tick: int) -> bool:  # noqa: ARG002 - time goes on
        return False

    def _tick_answered(self, stamp: int, tick: int) -> int | None:
        answered = stamp // self._period_ns
        if stamp >= 0 and 0 <= tick - answered <= self._oldest:
            self._elsewhere = 0
            # the same again is usual where /clock is slower than the commands
            if stamp < self._stamp:
                self._note_out_of_order()
                return None
            self._stamp = stamp
            return answered
        self._elsewhere += 1
        if self._elsewhere < _ELSEWHERE:
            return None
        self._complain(
            f"{self._topic}: {stamped(stamp, tick * self._period_ns)}; accepted: that of the states that a command "
            f"answers, up to {self._timeout:g} s old; now the newest counts, for {self._timeout:g} s from its arrival"
        )
        return tick


_JOINT_STATE = "sensor_msgs/msg/JointState"
_LOOK = 1.0  # s between two looks at the graph
_UNKNOWN = "_NODE_NAME_UNKNOWN_"  # of ROS


def joint_commands(
    joints: JointInterface, names: tuple[str, ...], topic: str, once: OnceLog
) -> Callable[[bytes], Array | None]:
    """Return what reads efforts at the joints, by name in any order.

    It returns the motor torques, motor side, Nm, shape (n,), valid until the next call; None for brakes closed. It
    raises ExchangeError if the message is not a command for these joints.

    Args:
        joints: the drives seen from the joints.
        names: of the joints.
        topic: of the commands, for messages.
        once: reports, once, that there are no efforts.
    """
    codec = JointStateCodec(names)
    accepted = f"{len(names)} efforts at the joints, Nm"

    def decode(raw: bytes) -> Array | None:
        _, position, velocity, effort = codec.decode(raw)
        if effort is not None:
            return joints.motor_torques(effort)
        if position is not None or velocity is not None:
            given = " and ".join(
                n for n, v in (("position", position), ("velocity", velocity)) if v is not None
            )
            raise ExchangeError(f"{given} without effort; accepted: {accepted}")
        once.say(f"{topic}: effort is empty: no torque, brakes closed; for torque: {accepted}")
        return None

    return decode


class CommandWatch:
    """Checks the graph once a second, on the executor's thread.

    Args:
        node: of the simulation.
        interface: the commanded one, of COMMAND_INTERFACES.
        once: reports each problem once.
    """

    def __init__(self, node: Node, interface: str, once: OnceLog) -> None:
        self._node = node
        self._once = once
        self._interface = interface
        self._commands = str(node.resolve_topic_name(COMMAND_INTERFACES[interface][1]))
        self._others = {
            other: str(node.resolve_topic_name(commands))
            for other, (_, commands) in COMMAND_INTERFACES.items()
            if other != interface
        }
        self._timer = node.create_timer(_LOOK, self.look)

    def look(self) -> None:
        """Report problems of the publishers of commands."""
        for info in self._publishers(self._commands):
            if info.topic_type != _JOINT_STATE:
                self._say(info, f"publishes {info.topic_type}; accepted: {_JOINT_STATE}")
            elif info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT:
                self._say(
                    info,
                    "publishes best effort, which is not heard; accepted: reliable, such as QoS depth 1",
                )
        for other, topic in self._others.items():
            for info in self._publishers(topic):
                self._once.say(
                    f"{topic}: node {info.node_name} is not heard, because command_interface is {self._interface}; "
                    f"accepted: commands on {self._commands}, or -p command_interface:={other}"
                )

    def _publishers(self, topic: str) -> list[TopicEndpointInfo]:
        """Return the publishers of a topic whose node's name the graph knows already."""
        publishers = self._node.get_publishers_info_by_topic(topic)
        return [info for info in publishers if info.node_name != _UNKNOWN]

    def _say(self, info: TopicEndpointInfo, text: str) -> None:
        self._once.say(f"{self._commands}: node {info.node_name} {text}")
