"""The lock-step's overhead: bare ping-pong of the two tick messages against the protocol with an empty model.

All run between two processes on real DDS. In the bare ping-pong a process sends its bytes as soon as the other's have
come in: once with what rclpy offers, raw messages and a wait set held by hand, and once through the channel that the
nodes use. In the lock-step the states are encoded, the stamps checked and the command decoded, as in the nodes.
Runs of all kinds alternate, so that what else loads the machine meets them alike.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import statistics
import sys
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rx90_common.base.errors import ExchangeError
from rx90_common.base.rates import Rates
from rx90_common.exchange.ros_start import prepare
from rx90_common.exchange.topics import MOTOR_COMMANDS, MOTOR_NAMES, MOTOR_STATES

PERIOD_NS = Rates().period_ns
_READY_TIMEOUT = 60.0
_SILENCE = 5.0


class PingPong(NamedTuple):
    """Medians over the rounds.

    Attributes:
        bare: exchanges per s of the bare ping-pong with a wait set.
        channel: the same through the nodes' channel.
        lockstep: ticks per s of the lock-step with an empty model.
    """

    bare: float
    channel: float
    lockstep: float

    @property
    def ratio(self) -> float:
        """Return the part of the channel's bare rate that the lock-step reaches."""
        return self.lockstep / self.channel


def measure(exchanges: int = 8000, rounds: int = 5) -> PingPong:
    """Run `rounds` rounds of `exchanges` exchanges of either kind.

    Raises:
        ExchangeError: if the other process does not answer.
    """
    prepare()
    # Spawned, not forked: a fork would inherit the middleware's state without its threads.
    spawn = multiprocessing.get_context("spawn")
    end = spawn.Event()
    other = spawn.Process(target=_answer, args=(end, os.getpid()), daemon=True)
    other.start()
    try:
        return _ask(exchanges, rounds)
    finally:
        end.set()
        other.join(10.0)
        if other.is_alive():
            other.kill()


_BARE = ("ping", "pong")
_CHANNEL = ("channel_ping", "channel_pong")


class _WaitSet:
    """Raw messages and a wait set held by hand: the least that rclpy itself allows."""

    def __init__(self, node, publish_topic: str, subscribe_topic: str, qos) -> None:  # type: ignore[no-untyped-def]
        from rclpy.impl.implementation_singleton import rclpy_implementation
        from sensor_msgs.msg import JointState

        self._kind, self.subscribe_topic = JointState, subscribe_topic
        self.publisher = node.create_publisher(JointState, publish_topic, qos)
        self.subscription = node.create_subscription(JointState, subscribe_topic, _never, qos, raw=True)
        self._wait_set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, node.context.handle)
        self.publish = self.publisher.handle.publish_raw

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message, or None after `timeout_s`."""
        self._wait_set.clear_entities()
        self._wait_set.add_subscription(self.subscription.handle)
        self._wait_set.wait(int(timeout_s * 1e9))
        taken = self.subscription.handle.take_message(self._kind, True)
        return None if taken is None else taken[0]

    def matches(self) -> tuple[int, int]:
        """Count what is connected."""
        return self.publisher.get_subscription_count(), self.subscription.get_publisher_count()


def _ask(exchanges: int, rounds: int) -> PingPong:
    import rclpy  # after `prepare`
    from rclpy.signals import SignalHandlerOptions
    from rclpy.utilities import try_shutdown

    from rx90_common.exchange.cdr import JointStateCodec
    from rx90_common.exchange.channel import Channel
    from rx90_common.exchange.endpoints import TICK_QOS
    from rx90_common.exchange.lockstep import LockstepSimulation

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node("ping_pong_simulation")
        bare = _WaitSet(node, *_BARE, TICK_QOS.profile)
        through = Channel(node, *_CHANNEL, TICK_QOS.profile)
        channel = Channel(node, MOTOR_STATES, MOTOR_COMMANDS, TICK_QOS.profile)
        for waiting in (bare, through, channel):
            _wait_for_peer(waiting)
        states, commands = JointStateCodec(MOTOR_NAMES), JointStateCodec(MOTOR_NAMES)
        lockstep = LockstepSimulation(channel, lambda _text: None)
        values = np.linspace(-1.0, 1.0, 18).reshape(3, 6)
        encode = states.encoder(*values)
        message = encode(0)
        tick = 0

        def ping(end: _WaitSet | Channel) -> None:
            end.publish(message)
            if end.receive(_SILENCE) is None:
                raise ExchangeError(f"ping-pong: no answer within {_SILENCE} s")

        def tick_once() -> None:
            nonlocal tick
            stamp = tick * PERIOD_NS
            raw = lockstep.exchange(stamp, encode(stamp), _never)
            if raw is None or commands.decode(raw)[3] is None:
                raise ExchangeError(f"lock-step: tick {tick} has no command")
            tick += 1

        kinds = (lambda: ping(bare), lambda: ping(through), tick_once)
        for kind in kinds:
            _rate(kind, exchanges // 4)
        rates = [[_rate(kind, exchanges) for kind in kinds] for _ in range(rounds)]
        return PingPong(*(statistics.median(column) for column in zip(*rates, strict=True)))
    finally:
        try_shutdown()


def _never(*_ignored: object) -> bool:
    return False


def _wait_for_peer(channel) -> None:  # type: ignore[no-untyped-def]  # Channel is imported after `prepare`
    deadline = time.monotonic() + _READY_TIMEOUT
    while min(channel.matches()) < 1:
        if time.monotonic() > deadline:
            raise ExchangeError(f"{channel.subscribe_topic}: no peer within {_READY_TIMEOUT} s")
        time.sleep(0.01)


def _rate(run: Callable[[], None], count: int) -> float:
    start = time.perf_counter()
    for _ in range(count):
        run()
    return count / (time.perf_counter() - start)


def _answer(end, parent: int) -> None:  # type: ignore[no-untyped-def]  # an Event of multiprocessing
    """Answer every kind, in the second process, each on a thread of its own."""
    import threading

    import rclpy  # the environment is inherited
    from rclpy.signals import SignalHandlerOptions
    from rclpy.utilities import try_shutdown

    from rx90_common.exchange.cdr import JointStateCodec
    from rx90_common.exchange.channel import Channel
    from rx90_common.exchange.endpoints import TICK_QOS
    from rx90_common.exchange.lockstep import LockstepController
    from rx90_common.exchange.motor_messages import MotorMessages, MotorStates

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("ping_pong_controller")
    ends = [_WaitSet(node, *_BARE[::-1], TICK_QOS.profile), Channel(node, *_CHANNEL[::-1], TICK_QOS.profile)]
    channel = Channel(node, MOTOR_COMMANDS, MOTOR_STATES, TICK_QOS.profile)

    class NoLaw:
        command = np.zeros(6)

        def begin(self) -> None:
            pass

        def hold(self, states: MotorStates) -> None:
            pass

        def step(self, _stamp: int, _states: MotorStates) -> bool:
            return True

        def after_command(self, _stamp: int) -> None:
            pass

        def skip(self, count: int) -> None:
            pass

    messages = MotorMessages(channel.subscribe_topic, MOTOR_NAMES, Rates(), NoLaw.command, print)
    controller = LockstepController(channel, messages, NoLaw(), lambda _text: None)
    message = JointStateCodec(MOTOR_NAMES).encode(0, effort=NoLaw.command)

    def pong(channel: _WaitSet | Channel) -> None:
        while not end.is_set():
            while channel.receive(0.2) is not None:
                channel.publish(message)

    threads = [threading.Thread(target=pong, args=(each,), daemon=True) for each in ends]
    for thread in threads:
        thread.start()
    while not end.is_set() and os.getppid() == parent:
        controller.serve(0.2)
    for thread in threads:
        thread.join(2.0)
    try_shutdown()


def main() -> int:
    """Print the two rates and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--exchanges", type=int, default=8000, help="exchanges in a round (%(default)s)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds of either kind (%(default)s)")
    options = parser.parse_args()
    result = measure(options.exchanges, options.rounds)
    print(f"bare ping-pong with a wait set      {result.bare:7.0f} exchanges/s")
    print(f"bare ping-pong through the channel  {result.channel:7.0f} exchanges/s")
    print(f"lock-step, empty model              {result.lockstep:7.0f} ticks/s, {100 * result.ratio:.0f} % of that")
    return 0


if __name__ == "__main__":
    sys.exit(main())
