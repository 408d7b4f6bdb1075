"""The simulation node: parameters, services and lifecycle around the ticks of one plant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.publisher import Publisher

from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange import node_tools
from rx90_common.exchange.channel import Channel
from rx90_common.exchange.lifecycle import ManagedNode, started
from rx90_common.exchange.parameter_changes import ChangeGroup, Effective
from rx90_common.exchange.tick_channel import Ends, MakeChannel
from rx90_common.exchange.time_mode import TimeMode
from rx90_common.exchange.topics import SEED, TEMPERATURE_RATE
from rx90_sim.node.arm import SimulatedArm
from rx90_sim.node.parameters import FILE_PARAMETERS, declare_step_ticks, read_parameters


class Simulation:
    """The node; what it is configured for is a `SimulatedArm`.

    Args:
        make_channel: makes the exchange with the controller.
        own_args: arguments for ROS that concern this node of its process alone.

    Attributes:
        node: for the executor.
    """

    def __init__(self, make_channel: MakeChannel = Channel, own_args: Sequence[str] = ()) -> None:
        self.node = ManagedNode("rx90_sim", own_args, self)
        self._ends = Ends(make_channel)
        self._arm: SimulatedArm | None = None
        self._follow: Callable[[TimeMode | None], None] = lambda _: None
        self._also_listening: Callable[[], Sequence[Publisher]] = tuple
        read_parameters(self.node)
        self._files()
        self._step_ticks()

    def _files(self) -> RobotFiles:
        return self.node.declare_robot_files(*FILE_PARAMETERS)

    def _step_ticks(self) -> int:
        return declare_step_ticks(self.node)

    def lead(self, follow: Callable[[TimeMode | None], None], publishers: Callable[[], Sequence[Publisher]]) -> None:
        """Tell a controller in this process how time is kept, None when it is not kept any more.

        Args:
            follow: is told; raises ExchangeError for rates or a robot that are not its own.
            publishers: returns those whose messages are to arrive, too, before a run that is not paced goes on.
        """
        self._follow, self._also_listening = follow, publishers

    # Transitions, on the executor's thread.

    def configure(self) -> None:
        """Load the robot; time stands still.

        Raises:
            Rx90Error: for files and parameters that are refused, and a second simulation.
        """
        parameters = read_parameters(self.node)
        self._arm = arm = SimulatedArm(self.node, self._files(), parameters, self._ends.make, self._step_ticks)
        arm.ticks.listeners.ask(self._also_listening)
        self._allow("real_time_factor", arm.check_pace, arm.ticks.pacer.change)
        self._allow("command_timeout", float, arm.ticks.held.wait_for)
        self._allow("step_ticks", int, lambda _: None)  # looked at by each call
        for name in (SEED, TEMPERATURE_RATE):
            self.node.changes.tell(name)
        self._follow(arm.time_mode)
        self.node.ticking.begin(arm.ticks.run, arm.ticks.control.stop)

    def _allow(self, name: str, check: Callable[[Any], Any], change: Callable[[Any], None]) -> None:
        def apply(value: Any, effective: Effective) -> None:
            change(value)
            if self._arm is not None:
                effective(self._arm.ticks.next_stamp_ns)

        self.node.changes.allow(ChangeGroup((name,), lambda values: check(values[name]), apply))

    def activate(self) -> None:
        """Let time run."""
        if self._arm is not None:
            self._arm.activate()

    def deactivate(self) -> None:
        """Let time stand still."""
        if self._arm is not None:
            self._arm.deactivate()

    def cleanup(self) -> None:
        """Let go of the robot."""
        self.node.ticking.finish()
        self._follow(None)
        self._arm = None
        self._ends.close()

    # Its ticking thread, and the end.

    def tick_loop(self) -> None:
        """Run ticks until the end of the run or `stop`.

        Raises:
            DivergenceError: naming joint and tick.
        """
        self.node.ticking.loop()

    def stop(self) -> None:
        """End `tick_loop` soon."""
        self.node.ticking.stop()


def spin(args: Sequence[str]) -> None:
    """Run the node until it ends or is interrupted.

    Raises:
        Rx90Error: for parameters that are refused, or a state that diverged.
    """
    node_tools.spin(lambda: started([Simulation()]), args)
