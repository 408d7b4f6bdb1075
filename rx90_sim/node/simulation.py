"""The simulation node: parameters, topics and services around one plant step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from rx90_common.base.errors import ExchangeError
from rx90_common.exchange import node_tools
from rx90_common.exchange.channel import Channel
from rx90_common.exchange.joint_state_cdr import JointStateCodec
from rx90_common.exchange.lockstep import LockstepSimulation
from rx90_common.exchange.node_tools import Diagnostics, declare
from rx90_common.exchange.pacing import Pacer
from rx90_common.exchange.qos import LATCHED_QOS, TICK_QOS
from rx90_common.exchange.throttle import ThrottledLog
from rx90_common.exchange.time_mode import TimeMode
from rx90_common.exchange.topics import LOCK_STEP, MOTOR_COMMANDS, MOTOR_NAMES, MOTOR_STATES, TIME_MODE
from rx90_sim.node.held_command import HeldCommand
from rx90_sim.node.parameters import build_plant, read_parameters
from rx90_sim.node.publications import Publications
from rx90_sim.node.run_control import RunControl, Turn

_WAIT_SLICE = 0.1
_REQUEST_TIMEOUT = 5.0
_FLUSH_SLICES = 40  # of 50 ms
_MATCH_ATTEMPTS = 100  # of 50 ms


class Simulation:
    """The node and its ticking thread's loop."""

    def __init__(self) -> None:
        self.node = Node("rx90_sim")
        self._log = self.node.get_logger()
        self._parameters = read_parameters(self.node)
        rates = self._parameters.rates
        robot, self._plant = build_plant(self.node, self._parameters)
        self._period_ns = rates.period_ns
        self._publications = Publications(
            self.node, self._plant, rates, self._parameters.joint_state_rate, self._parameters.clock_rate
        )
        self._channel = Channel(self.node, MOTOR_STATES, MOTOR_COMMANDS, TICK_QOS)
        self._lockstep = LockstepSimulation(self._channel, self._log.info)
        self._encode_states = JointStateCodec(MOTOR_NAMES).encoder(*self._plant.motor_states())
        self._commands = JointStateCodec(MOTOR_NAMES)
        self._control = RunControl(self._parameters.paused, self._channel.wake, self._parameters.last_tick)
        lock_step = self._parameters.time_mode == LOCK_STEP
        self._pacer = Pacer(rates.period, self._parameters.real_time_factor if lock_step else 1.0)
        self._published_tick = -1
        timeout = round(self._parameters.command_timeout * rates.base_hz)
        self._held = HeldCommand(self._channel, self._torques, timeout, self._log.info)
        self._complaints = ThrottledLog(self._log.error)
        self._latch(robot.urdf)
        self._offer_services()
        self._diagnostics = Diagnostics(self.node, self._status)

    def _latch(self, urdf: str) -> None:
        self._description = self.node.create_publisher(String, "robot_description", LATCHED_QOS)
        self._description.publish(String(data=urdf))
        self._mode = self.node.create_publisher(String, TIME_MODE, LATCHED_QOS)
        self._mode.publish(String(data=TimeMode(self._parameters.time_mode, self._parameters.rates).text))

    def _offer_services(self) -> None:
        node = self.node
        declare(node, "step_ticks", 1, "ticks of one call of ~/step", low=1, high=100_000_000, read_only=False)
        node.create_service(SetBool, "~/pause", self._on_pause)
        node.create_service(Trigger, "~/step", self._on_step)
        node.create_service(Trigger, "~/reset", self._on_reset)

    # The ticking thread.

    def tick_loop(self) -> None:
        """Run ticks until the end of the run or `stop`.

        Raises:
            DivergenceError: naming joint and tick.
        """
        advance = self._lock_step if self._parameters.time_mode == LOCK_STEP else self._free_running
        moving = False
        while True:
            turn = self._control.next_turn(self._plant.tick, _WAIT_SLICE)
            if turn is Turn.STOP:
                break
            if turn is Turn.RESET:
                self._reset()
            elif turn is Turn.STEP:
                if not moving:
                    if self._plant.tick == 0:
                        self._wait_for_subscribers()
                    self._pacer.restart()
                if advance():
                    self._control.step_done()
            moving = turn is Turn.STEP
        self._flush()

    def stop(self) -> None:
        """End `tick_loop` soon."""
        self._control.stop()

    def _lock_step(self) -> bool:
        plant = self._plant
        stamp = plant.tick * self._period_ns
        states = self._encode_states(stamp)
        raw = self._lockstep.exchange(stamp, states, self._control.interrupting, self._publish_due)
        if raw is None:
            return False
        plant.step(self._torques(raw))
        self._pacer.wait()
        return True

    def _free_running(self) -> bool:
        plant = self._plant
        self._pacer.wait()
        self._publish_due()
        self._channel.publish(self._encode_states(plant.tick * self._period_ns))
        plant.step(self._held.take())
        return True

    def _publish_due(self) -> None:
        # An exchange that was interrupted comes back in the same tick.
        if self._published_tick != self._plant.tick:
            self._published_tick = self._plant.tick
            self._publications.publish_due()

    def _torques(self, raw: bytes) -> NDArray[np.float64] | None:
        """Return the command's torques; None, which closes the brakes, if it has none or cannot be used."""
        try:
            torques = self._commands.decode(raw)[3]
        except ExchangeError as error:
            self._complaints.say("command", f"{self._channel.subscribe_topic}: {error}; the brakes close")
            return None
        return torques

    def _reset(self) -> None:
        self._plant.reset(self._parameters.initial_position)
        self._published_tick = -1
        self._held.forget()
        self._control.reset_done()
        self._pacer.restart()

    def _wait_for_subscribers(self) -> None:
        publishers = [*self._publications.publishers, self._channel.publisher]
        node_tools.wait_until_matched(self.node, publishers, _MATCH_ATTEMPTS)

    def _flush(self) -> None:
        """Let the last messages reach a recorder."""
        for publisher in [*self._publications.publishers, self._channel.publisher]:
            for _ in range(_FLUSH_SLICES):
                if publisher.wait_for_all_acked(Duration(nanoseconds=50_000_000)):
                    break

    # Services and diagnostics, on the executor's thread.

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data:
            self._control.pause()
        else:
            self._control.resume()
        response.success = True
        response.message = "time stands still" if request.data else "time runs"
        return response

    def _on_step(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        ticks = self.node.get_parameter("step_ticks").value
        return self._answer(response, self._control.step(ticks, _REQUEST_TIMEOUT), f"{ticks} ticks")

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self._control.reset(_REQUEST_TIMEOUT), "reset")

    def _answer(self, response: Trigger.Response, done: bool, what: str) -> Trigger.Response:
        response.success = done
        at = f"at {self._plant.tick * self._period_ns / 1e9:.6g} s"
        response.message = f"{what} done, {at}" if done else f"{what} not done within {_REQUEST_TIMEOUT:g} s, {at}"
        return response

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        counts, plant = self._pacer.take(), self._plant
        rate = counts.ticks / counts.seconds if counts.seconds > 0 else 0.0
        lock_step = self._parameters.time_mode == LOCK_STEP
        values = {
            "time mode": self._parameters.time_mode,
            "simulated time, s": f"{plant.tick * self._period_ns / 1e9:.3f}",
            "rate, Hz": f"{rate:.1f}",
            "real-time factor": f"{rate * self._period_ns / 1e9:.3f}",
            "worst period, ms": f"{counts.worst * 1e3:.3f}",
            "late ticks": str(counts.late),
            "dropped ticks": str(counts.dropped),
            "ticks without a fresh command": str(self._held.missed),
            "commands out of turn": str(self._lockstep.ignored),
            "brakes": "closed" if plant.brakes_closed else "open",
            "saturated ticks": " ".join(str(n) for n in plant.saturated),
        }
        if self._control.paused:
            return DiagnosticStatus.OK, "paused", values
        if self._held.rivals:
            return DiagnosticStatus.ERROR, "two controllers send commands", values
        if counts.ticks == 0:
            return DiagnosticStatus.WARN, "waiting for the controller", values
        behind = counts.dropped > 0 and not lock_step
        return DiagnosticStatus.WARN if behind else DiagnosticStatus.OK, "running", values


def spin(args: Sequence[str]) -> None:
    """Run the node until it ends or is interrupted.

    Raises:
        Rx90Error: for parameters that are refused, or a state that diverged.
    """
    node_tools.spin(Simulation, args)
