"""Unpause the simulation and show its time until it ends."""

from __future__ import annotations

import sys
import time
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool
from tqdm import tqdm

from rx90_demo.processes import ManagedProcess, ProcessError

_SERVICE_TIMEOUT = 60.0


def follow_clock(simulation: ManagedProcess, duration: float) -> None:
    """Let time run and draw a progress bar of simulated time until the simulation's process ends.

    Raises:
        ProcessError: if the simulation does not take the request.
    """
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node("rx90_demo", context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        now = [0.0]

        def take(message: Clock) -> None:
            now[0] = message.clock.sec + message.clock.nanosec * 1e-9

        node.create_subscription(Clock, "clock", take, qos_profile_sensor_data)
        _resume(node, executor)
        _show(simulation, executor, now, duration)
        executor.shutdown()
        node.destroy_node()
    finally:
        context.try_shutdown()


def _resume(node: Node, executor: SingleThreadedExecutor) -> None:
    client = node.create_client(SetBool, "rx90_sim/pause")
    if not client.wait_for_service(_SERVICE_TIMEOUT):
        raise ProcessError(f"the simulation offered no service {client.srv_name} within {_SERVICE_TIMEOUT:g} s")
    answer = client.call_async(SetBool.Request(data=False))
    executor.spin_until_future_complete(answer, _SERVICE_TIMEOUT)
    result: Any = answer.result() if answer.done() else None
    if result is None or not result.success:
        raise ProcessError("the simulation did not let time run")


def _show(simulation: ManagedProcess, executor: SingleThreadedExecutor, now: list[float], duration: float) -> None:
    layout = "{l_bar}{bar}| {n:.2f}/{total:.2f} s simulated [{elapsed}<{remaining}{postfix}]"
    began = time.monotonic()
    # In a log file a line every few seconds is enough.
    interval = 0.2 if sys.stderr.isatty() else 3.0
    with tqdm(total=duration, bar_format=layout, desc="reference task", mininterval=interval, miniters=0) as bar:
        while simulation.process.poll() is None:
            executor.spin_once(timeout_sec=0.1)
            bar.set_postfix_str(f"{now[0] / (time.monotonic() - began):.2f} x real time", refresh=False)
            bar.update(min(now[0], duration) - bar.n)
        if simulation.process.returncode == 0:
            bar.update(duration - bar.n)
