"""Buttons for the services of both nodes, their states, and what they say."""

from __future__ import annotations

import html
from collections import deque

from viser import GuiButtonHandle

from rx90_common.exchange.service_calls import ServiceRequest
from rx90_controller.node.trajectory_client import enable_request
from rx90_emulator.view.page import Page
from rx90_emulator.view.panel.operator import Operator
from rx90_emulator.view.widgets import block
from rx90_sim.node.simulation_client import pause_request, reset_request, step_request

_LINES = 6
_ACTIVE = ("active",)
_CONFIGURED = ("active", "inactive")


class NodeControls:
    """Buttons that are enabled while their node can do what they ask for; a line says why the others are not.

    Args:
        page: to build in, within a tab.
        operator: asks the nodes.

    Attributes:
        simulation, controller: the lifecycle states; empty for a node that is not there.
    """

    def __init__(self, page: Page, operator: Operator) -> None:
        self._page, self._operator = page, operator
        self.simulation = self.controller = ""
        self._buttons: list[tuple[GuiButtonHandle, bool, tuple[str, ...]]] = []
        self._state = page.gui.add_html("")
        node = operator.names.simulation
        self._button("Pause", pause_request(node, paused=True), _CONFIGURED)
        self._button("Run", pause_request(node, paused=False), _CONFIGURED)
        self._button("Step", step_request(node), _ACTIVE)
        self._button("Reset to time 0", reset_request(node), _CONFIGURED)
        node = operator.names.controller
        self._button("Torque on", enable_request(node, on=True), _ACTIVE)
        self._button("Torque off, brakes closed", enable_request(node, on=False), _ACTIVE)
        self.states("", "")

    def states(self, simulation: str, controller: str) -> None:
        """Take the lifecycle states."""
        self.simulation, self.controller = simulation, controller
        for button, of_simulation, accepted in self._buttons:
            button.disabled = (simulation if of_simulation else controller) not in accepted
        names = self._operator.names
        lines = [_state_line(names.simulation, simulation), _state_line(names.controller, controller)]
        self._state.content = block("<br>".join(lines))

    def _button(self, label: str, asked: ServiceRequest, accepted: tuple[str, ...]) -> None:
        button = self._page.gui.add_button(label)
        button.on_click(lambda _: self._operator.ask(asked))
        of_simulation = asked.service.startswith(f"{self._operator.names.simulation}/")
        self._buttons.append((button, of_simulation, accepted))


class NodeLog:
    """The newest lines of what the nodes say and of what was refused here."""

    def __init__(self, page: Page) -> None:
        self._lines: deque[str] = deque(maxlen=_LINES)
        self._shown = page.gui.add_html(block("nothing yet"))

    def say(self, who: str, text: str, wrong: bool) -> None:
        """Show a line."""
        colour = "color:#c92a2a" if wrong else ""
        self._lines.appendleft(f'<div style="{colour}"><b>{html.escape(who)}</b> {html.escape(text)}</div>')
        self._shown.content = block("".join(self._lines))


def _state_line(node: str, state: str) -> str:
    said = html.escape(state) if state else f"not there: its buttons wait for <code>{html.escape(node)}</code> to start"
    return f"<b>{html.escape(node)}</b> {said}"
