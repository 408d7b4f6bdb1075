"""Unpause the simulation and show its time until it ends."""

from __future__ import annotations

import sys
import time

from tqdm import tqdm

from rx90_common.exchange.client_node import ClientNode, client_node
from rx90_common.process.children import ChildProcess
from rx90_sim.node.simulation_client import SimulationClient

_SERVICE_TIMEOUT = 60.0


def follow_clock(process: ChildProcess, duration: float) -> None:
    """Let time run and draw a progress bar of simulated time until the simulation's process ends.

    Raises:
        ExchangeError: if the simulation does not take the request.
    """
    with client_node("rx90_demo", _SERVICE_TIMEOUT, lambda _: None) as client:
        simulation = SimulationClient(client)
        simulation.pause(False)
        _show(process, client, simulation, duration)


def _show(process: ChildProcess, client: ClientNode, simulation: SimulationClient, duration: float) -> None:
    layout = "{l_bar}{bar}| {n:.2f}/{total:.2f} s simulated [{elapsed}<{remaining}{postfix}]"
    began = time.monotonic()
    # In a log file a line every few seconds is enough.
    interval = 0.2 if sys.stderr.isatty() else 3.0
    with tqdm(total=duration, bar_format=layout, desc="reference task", mininterval=interval, miniters=0) as bar:
        while process.returncode is None:
            client.spin()
            bar.set_postfix_str(f"{simulation.time / (time.monotonic() - began):.2f} x real time", refresh=False)
            bar.update(min(simulation.time, duration) - bar.n)
        if process.returncode == 0:
            bar.update(duration - bar.n)
