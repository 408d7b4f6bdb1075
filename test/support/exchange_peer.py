"""Small stand-ins for the nodes, each run as a process by the tests: simulation, controller, recorder, burner.

The plant and the law are integer recurrences: one message missed, repeated or reordered changes every later value.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from rx90_common.base.errors import Rx90Error
from rx90_common.base.rates import Rates
from rx90_common.exchange.ros_start import prepare

PERIOD_NS = 250_000
_MODULUS = 2**31 - 1
_READ_AHEAD = 200_000


def plant(state: int, command: int) -> int:
    """Return the next state."""
    return (state * 48271 + command * 7 + 3) % _MODULUS


class Law:
    """A law with a memory of its own, discharged before the first states it sees."""

    def __init__(self) -> None:
        self.memory = 0

    def discharge(self) -> None:
        """Forget what was."""
        self.memory = 17

    def advance(self, state: int) -> int:
        """Return the command."""
        self.memory = (self.memory * 69621 + state) % _MODULUS
        return self.memory


def expected(ticks: int) -> int:
    """Return the state after `ticks` ticks, computed in one process."""
    law, state = Law(), 1
    law.discharge()
    for _ in range(ticks):
        state = plant(state, law.advance(state))
    return state


def say(text: str) -> None:
    """Print a line at once."""
    print(text, flush=True)


def _wait_for_listeners(publisher: Any, count: int) -> None:
    """Wait until `count` subscriptions are matched: on a busy machine the graph alone may not know of them yet."""
    while publisher.get_subscription_count() < count:
        time.sleep(0.01)


def _simulate(ticks: int, period: float, listeners: int) -> None:
    import rclpy  # the environment is prepared first

    from rx90_common.exchange.cdr import JointStateCodec
    from rx90_common.exchange.channel import Channel
    from rx90_common.exchange.endpoints import TICK_QOS, wait_until_matched
    from rx90_common.exchange.lockstep import LockstepSimulation
    from rx90_common.exchange.topics import MOTOR_COMMANDS, MOTOR_STATES

    node = rclpy.create_node("simulation")
    channel = Channel(node, MOTOR_STATES, MOTOR_COMMANDS, TICK_QOS)
    lockstep = LockstepSimulation(channel, say)
    codec = JointStateCodec(["a"])
    publisher = channel.publisher
    wait_until_matched(node, [publisher], 100)
    _wait_for_listeners(publisher, listeners)
    state = 1
    for tick in range(ticks):
        values = np.array([float(state)])
        raw = lockstep.exchange(tick * PERIOD_NS, codec.encode(tick * PERIOD_NS, values, values), lambda: False)
        assert raw is not None
        effort = codec.decode(raw)[3]
        assert effort is not None
        state = plant(state, int(effort[0]))
        if tick % 250 == 0:
            say(f"tick {tick}")
        if period:
            time.sleep(period)
    say(f"final {state}")
    for _ in range(100):
        if publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=0.1)):
            break


def _control(listeners: int) -> None:
    import rclpy

    from rx90_common.exchange.channel import Channel
    from rx90_common.exchange.endpoints import TICK_QOS, wait_until_matched
    from rx90_common.exchange.pacing import Pacer
    from rx90_common.exchange.topics import MOTOR_COMMANDS, MOTOR_STATES
    from rx90_controller.node.serving import Serving
    from rx90_controller.node.servo_loop import MotorStates

    node = rclpy.create_node("controller")
    channel = Channel(node, MOTOR_COMMANDS, MOTOR_STATES, TICK_QOS)

    class Loops(Law):
        command = np.zeros(1)

        def begin(self) -> None:
            wait_until_matched(node, [channel.publisher], 100)
            _wait_for_listeners(channel.publisher, listeners)

        def hold(self, states: MotorStates) -> None:
            self.discharge()
            say(f"begin {states.stamp_ns // PERIOD_NS}")

        def step(self, _stamp: int, states: MotorStates) -> bool:
            self.command[0] = float(self.advance(int(states.position[0])))
            return True

        def after_command(self, _stamp: int) -> None:
            pass

    loops = Loops()
    serving = Serving(channel, ["a"], Rates(), loops, Pacer(Rates().period, 1.0), "robot", say, say)  # type: ignore[arg-type]
    say("controller up")
    while True:
        serving.serve_lock_step(0.2)


def _record(ticks: int, nap: float) -> None:
    """Take both topics, slowly, and say whether every tick was there in order."""
    import rclpy
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import JointState

    from rx90_common.exchange.cdr import cdr_stamp_ns
    from rx90_common.exchange.topics import MOTOR_COMMANDS, MOTOR_STATES

    node = rclpy.create_node("recorder")
    seen: dict[str, list[int]] = {MOTOR_STATES: [], MOTOR_COMMANDS: []}

    def keep(topic: str) -> Callable[[bytes], None]:
        return lambda raw: seen[topic].append(cdr_stamp_ns(raw) // PERIOD_NS)

    for topic in seen:
        node.create_subscription(JointState, topic, keep(topic), QoSProfile(depth=_READ_AHEAD), raw=True)
    say("recorder up")
    while any(not stamps or stamps[-1] < ticks - 1 for stamps in seen.values()):
        rclpy.spin_once(node, timeout_sec=0.1)
        if len(seen[MOTOR_STATES]) % 1000 == 500:
            time.sleep(nap)
    for topic, stamps in seen.items():
        once = [a for a, b in zip(stamps, [-1, *stamps], strict=False) if a != b]
        say(f"recorded {topic} {'complete' if once == list(range(ticks)) else f'with gaps: {once[:20]}'}")


def _burn() -> None:
    say("burning")
    while True:
        sum(range(100_000))


def main() -> int:
    """Run the role that the first argument names."""
    signal.signal(signal.SIGINT, lambda *_: sys.exit(0))
    role, *numbers = sys.argv[1:]
    prepare()
    if role == "burn":
        _burn()
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        if role == "simulate":
            _simulate(int(numbers[0]), float(numbers[1]), int(numbers[2]) if numbers[2:] else 0)
        elif role == "control":
            _control(int(numbers[0]) if numbers else 0)
        else:
            _record(int(numbers[0]), float(numbers[1]))
    except Rx90Error as error:
        print(error, file=sys.stderr, flush=True)
        return 1
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
