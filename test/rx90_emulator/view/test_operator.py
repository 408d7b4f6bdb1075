"""What the page asks of running nodes, over DDS: nothing waits, every answer and every silence is told."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from processes import running_processes, wait_until
from rcl_interfaces.srv import GetParameters
from ros_client import JOINTS, Client, own_node
from std_srvs.srv import SetBool

from rx90_common.exchange.client_node import ClientNode, client_node
from rx90_common.friction.friction_file import FrictionFile
from rx90_controller.node.trajectory_client import enable_request
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view.forms import changed
from rx90_emulator.view.panel import Operator
from rx90_sim.node.simulation_client import pause_request, reset_request, step_request

REST = np.zeros((1, 6))


class Listener:
    """Keeps what an operator hears."""

    def __init__(self, client: ClientNode, timeout: float = 30.0) -> None:
        self.said: list[tuple[str, str, bool]] = []
        self.operator = Operator(client, "rx90_controller", lambda *line: self.said.append(line), timeout)

    def until(self, ready: Callable[[], bool], what: str) -> None:
        """Let the operator take in what comes until something is so."""

        def step() -> bool:
            self.operator.step(time.monotonic())
            return ready()

        wait_until(step, f"{what}; said: {self.said}")

    def wait_for(self, node: str, text: str, *, wrong: bool = False) -> str:
        """Wait for a line that has a text in it; return it."""

        def found() -> list[str]:
            return [line for who, line, bad in self.said if (who, bad) == (node, wrong) and text in line]

        self.until(lambda: bool(found()), f"{text!r} of {node}")
        return found()[0]


@pytest.fixture
def listener(ros_domain: int, warm: None) -> Iterator[Listener]:  # noqa: ARG001 - what they do is done
    """Give an operator of a cell that runs, in a namespace, with time standing still."""
    space = ("--ros-args", "-r", "__ns:=/cell")
    with running_processes() as processes, client_node("test", 30.0, print, space) as client:
        processes.start("rx90_cell", *space, "-p", "rx90_sim:paused:=true").wait_for("paused")
        listening = Listener(client)
        listening.until(lambda: [*listening.operator.states.values()] == ["active", "active"], "both nodes")
        yield listening


def test_both_nodes_do_what_they_are_asked(listener: Listener, shipped: Setup, tmp_path: Path) -> None:
    """Services and trajectories are answered with the nodes' own words; another friction file is loaded."""
    operator = listener.operator
    simulation, controller = operator.simulation, operator.controller
    operator.ask(step_request(simulation))
    assert listener.wait_for(simulation, "done, at") == "1 ticks done, at 0.00025 s"
    operator.ask(pause_request(simulation, paused=False))
    listener.wait_for(simulation, "time runs")
    operator.ask(enable_request(controller, on=False))
    listener.wait_for(controller, "torque off, brakes closed")
    operator.send(tuple(JOINTS), TrajectoryPoints(np.array([1.0]), REST, REST, None))
    assert "the controller is disabled" in listener.wait_for(controller, "trajectory rejected", wrong=True)
    operator.ask(enable_request(controller, on=True))
    listener.wait_for(controller, "torque on")
    operator.send(tuple(JOINTS), TrajectoryPoints(np.array([1.0]), REST + 0.1, REST, None))
    listener.wait_for(controller, "trajectory accepted: 1 points, 1.000 s")
    operator.send(tuple(JOINTS), None)
    listener.wait_for(controller, "empty trajectory: stopping")
    operator.ask(reset_request(simulation))
    listener.wait_for(simulation, "reset done, at 0 s")
    assert shipped.friction.file is not None
    file = changed(FrictionFile.read(shipped.friction.file), "joint_1", {"tau_c_positive": 20.0})
    path = tmp_path / "friction.yaml"
    path.write_text(file.text(), encoding="utf-8")
    ended: list[tuple[str, bool]] = []
    operator.start_again_with("friction", str(path), lambda *how: ended.append(how))
    listener.wait_for(simulation, "activate: done")
    listener.until(lambda: bool(ended), "how it ended")
    assert ended == [(f"{simulation} runs again, from time 0: activate: done", False)]
    client = Client("/cell")
    asked = GetParameters.Request(names=["friction"])
    assert client.asking.call(GetParameters, "rx90_sim/get_parameters", asked).values[0].string_value == str(path)
    client.close()
    listener.until(lambda: operator.states[simulation] == "active", "the simulation again")
    operator.start_again_with("friction", str(tmp_path / "none.yaml"), lambda *how: ended.append(how))
    listener.wait_for(simulation, "none.yaml", wrong=True)
    listener.until(lambda: len(ended) == 2, "how it ended")
    assert (ended[1][0].startswith(f"{simulation} is not started again: "), ended[1][1]) == (True, True)


def test_silence_is_told(ros_domain: int) -> None:
    """A service that does not answer is told after the time-out, one that is not there at once, and others go on."""
    with own_node("silent", ros_domain) as node, client_node("test", 30.0, print) as client:
        node.create_service(SetBool, "rx90_sim/pause", lambda _request, response: response)  # nobody spins it
        listening = Listener(client, timeout=1.0)
        operator, said = listening.operator, listening.said
        operator.send(tuple(JOINTS), None)
        operator.start_again_with("friction", "x.yaml", lambda *_: None)
        operator.ask(reset_request("rx90_sim"))
        absent = "there is no service rx90_sim/{}; accepted: while its node runs"
        assert [(node, line) for node, line, wrong in said if wrong] == [
            ("rx90_controller",
             "there is no controller on /rx90_controller/joint_trajectory; accepted: while one runs"),
            ("rx90_sim", absent.format("get_state")),
            ("rx90_sim", absent.format("reset")),
        ]  # fmt: skip

        def unanswered() -> bool:
            operator.ask(pause_request("rx90_sim", paused=True))
            return any("no answer of rx90_sim/pause within 1 s" in line for _, line, _ in said)

        listening.until(unanswered, "a complaint")
        assert [*operator.states.values()] == ["", ""]
