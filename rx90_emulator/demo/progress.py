"""Unpause the simulation and show its time until it ends."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool
from tqdm import tqdm

from rx90_common.base.errors import ProcessError
from rx90_common.exchange.ros_start import start_ros
from rx90_common.process.children import ChildProcess
from rx90_common.process.interrupts import interrupts_later

_SERVICE_TIMEOUT = 60.0
_SLICE = 0.1


def follow_clock(simulation: ChildProcess, duration: float) -> None:
    """Let time run and draw a progress bar of simulated time until the simulation's process ends.

    Raises:
        ProcessError: if the simulation does not take the request.
    """
    context = Context()
    start_ros([], context)
    try:
        _follow(simulation, duration, context)
    finally:
        context.try_shutdown()


def _follow(simulation: ChildProcess, duration: float, context: Context) -> None:
    with interrupts_later() as check_interrupt:
        node = rclpy.create_node("rx90_demo", context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        now = [0.0]

        def take(message: Clock) -> None:
            now[0] = message.clock.sec + message.clock.nanosec * 1e-9

        node.create_subscription(Clock, "clock", take, qos_profile_sensor_data)
        try:
            _resume(node, lambda: _spin(executor, check_interrupt))
            _show(simulation, lambda: _spin(executor, check_interrupt), now, duration)
        finally:
            executor.shutdown()
            node.destroy_node()


def _spin(executor: SingleThreadedExecutor, check_interrupt: Callable[[], None]) -> None:
    executor.spin_once(timeout_sec=_SLICE)
    check_interrupt()


def _resume(node: Node, spin: Callable[[], None]) -> None:
    client = node.create_client(SetBool, "rx90_sim/pause")
    deadline = time.monotonic() + _SERVICE_TIMEOUT
    while not client.service_is_ready():
        if time.monotonic() > deadline:
            raise ProcessError(f"the simulation offered no service {client.srv_name} within {_SERVICE_TIMEOUT:g} s")
        spin()
    answer = client.call_async(SetBool.Request(data=False))
    while not answer.done() and time.monotonic() < deadline:
        spin()
    result: Any = answer.result() if answer.done() else None
    if result is None or not result.success:
        raise ProcessError("the simulation did not let time run")


def _show(simulation: ChildProcess, spin: Callable[[], None], now: list[float], duration: float) -> None:
    layout = "{l_bar}{bar}| {n:.2f}/{total:.2f} s simulated [{elapsed}<{remaining}{postfix}]"
    began = time.monotonic()
    # In a log file a line every few seconds is enough.
    interval = 0.2 if sys.stderr.isatty() else 3.0
    with tqdm(total=duration, bar_format=layout, desc="reference task", mininterval=interval, miniters=0) as bar:
        while simulation.returncode is None:
            spin()
            bar.set_postfix_str(f"{now[0] / (time.monotonic() - began):.2f} x real time", refresh=False)
            bar.update(min(now[0], duration) - bar.n)
        if simulation.returncode == 0:
            bar.update(duration - bar.n)
