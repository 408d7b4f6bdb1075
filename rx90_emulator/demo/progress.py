"""Unpause the simulation and show its time until it ends."""

from __future__ import annotations

import time

from tqdm import tqdm

from rx90_common.exchange.client_node import ClientNode, client_node
from rx90_common.process.children import ChildProcess
from rx90_sim.node.simulation_client import SimulationClient

_SERVICE_TIMEOUT = 60.0


def follow_clock(process: ChildProcess, duration: float) -> float:
    """Let time run and draw a progress bar of simulated time until the simulation's process ends.

    Returns:
        The real-time factor from the first to the last time that was heard; 0 if there were no two.

    Raises:
        ExchangeError: if the simulation does not take the request.
    """
    with client_node("rx90_demo", _SERVICE_TIMEOUT, lambda _: None) as client:
        simulation = SimulationClient(client)
        simulation.pause(False)
        return _show(process, client, simulation, duration)


def _show(process: ChildProcess, client: ClientNode, simulation: SimulationClient, duration: float) -> float:
    layout = "{l_bar}{bar}| {n:.2f}/{total:.2f} s simulated [{elapsed}<{remaining}{postfix}]"
    # From the first time that is heard: before it, the nodes wait for those who listen.
    first: tuple[float, float] | None = None
    factor, newest = 0.0, 0.0
    with tqdm(
        total=duration, bar_format=layout, desc="reference task", mininterval=0.2, miniters=0, disable=None
    ) as bar:
        while process.returncode is None:
            client.spin()
            if simulation.time > newest:
                newest, now = simulation.time, time.monotonic()
                first = first or (newest, now)
                factor = (newest - first[0]) / (now - first[1]) if now > first[1] else 0.0
            bar.set_postfix_str(f"{factor:.2f} x real time", refresh=False)
            bar.update(min(simulation.time, duration) - bar.n)
        if process.returncode == 0:
            bar.update(duration - bar.n)
    return factor
