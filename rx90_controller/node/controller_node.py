"""The controller node: its lifecycle around a `Control`."""

from __future__ import annotations

import threading
from collections.abc import Sequence

from rclpy.publisher import Publisher

from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange import node_tools
from rx90_common.exchange.channel import Channel, Ends, MakeChannel
from rx90_common.exchange.lifecycle import ManagedNode, started
from rx90_common.exchange.parameters import declare_rates
from rx90_common.exchange.topics import TimeMode
from rx90_controller.node.control import FILE_PARAMETERS, Control, declare_decimation, declare_horizon
from rx90_controller.node.parameters import forget_law_parameters


class ControllerNode:
    """The node; what it is configured for is a `Control`.

    Args:
        make_channel: makes the exchange with the simulation.
        own_args: arguments for ROS that concern this node of its process alone.
        local: whether the simulation is in this process: it then calls `follow`, and `answer` in each tick in
            lock-step.

    Attributes:
        node: for the executor.
    """

    def __init__(
        self, make_channel: MakeChannel = Channel, own_args: Sequence[str] = (), *, local: bool = False
    ) -> None:
        self.node = ManagedNode("rx90_controller", own_args, self)
        self._ends, self._local = Ends(make_channel), local
        self._control: Control | None = None
        self._time_mode: TimeMode | None = None
        self._answering = threading.Lock()
        declare_rates(self.node)
        self._files()
        declare_horizon(self.node)
        declare_decimation(self.node)

    def _files(self) -> RobotFiles:
        return self.node.declare_robot_files(*FILE_PARAMETERS)

    # Transitions, on the executor's thread.

    def configure(self) -> None:
        """Load the robot; the torque stays off.

        Raises:
            Rx90Error: for files and parameters that are refused, a second controller, or a simulation in this process
                that does not fit.
        """
        self._control = control = Control(self.node, self._files(), self._ends.make, local=self._local)
        if self._time_mode is not None:
            control.follow(self._time_mode)
        if self._local:
            self._serve = control.hand_over()
        self.node.ticking.begin(control.tick_loop, control.stop)

    def activate(self) -> None:
        """Give the motors torque."""
        if self._control is not None:
            self._control.activate()

    def deactivate(self) -> None:
        """Take the torque away and close the brakes."""
        if self._control is not None:
            self._control.deactivate()

    def cleanup(self) -> None:
        """Let go of the robot."""
        self.node.ticking.finish()
        with self._answering:
            control, self._control = self._control, None
        if control is not None:
            control.close()
        self._ends.close()
        forget_law_parameters(self.node)

    # A simulation in this process.

    @property
    def publishers(self) -> tuple[Publisher, ...]:
        """Return the publishers of all that ticks send."""
        control = self._control
        return () if control is None else control.publishers

    def follow(self, time_mode: TimeMode | None) -> None:
        """Keep time as the simulation does; None: there is none.

        Raises:
            ExchangeError: if its rates or its robot are not this one's.
        """
        self._time_mode = time_mode
        if self._control is not None and time_mode is not None:
            self._control.follow(time_mode)

    def answer(self) -> None:
        """Answer one tick in lock-step, on the thread that ticks; nothing while there is nothing to answer with."""
        with self._answering:
            if self._control is not None:
                self._serve()

    # Its ticking thread, and the end.

    def tick_loop(self) -> None:
        """Answer the simulation until `stop`.

        Raises:
            ExchangeError: if the simulation's rates are not this one's.
        """
        self.node.ticking.loop()

    def stop(self) -> None:
        """End `tick_loop` soon, and send what there is to say."""
        self.node.ticking.stop()
        if self._control is not None:
            self._control.flush_before_shutdown()


def spin(args: Sequence[str]) -> None:
    """Run the node until it is interrupted.

    Raises:
        Rx90Error: for parameters that are refused, or a simulation that does not fit.
    """
    node_tools.spin(lambda: started([ControllerNode()]), args)
