"""The controller node where control_msgs is not installed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from rx90_controller.node import controller_node


def test_one_line_says_that_the_action_is_off_and_how_to_turn_it_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without control_msgs nothing is served beyond what there was, and the log has one line of information."""
    monkeypatch.setattr(controller_node, "missing_control_msgs", lambda: "needs control_msgs; accepted: make action")
    said: list[str] = []
    node: Any = SimpleNamespace(get_logger=lambda: SimpleNamespace(info=said.append))
    assert controller_node.import_client_interfaces(node) is None
    assert said == ["the action follow_joint_trajectory is off: needs control_msgs; accepted: make action"]
