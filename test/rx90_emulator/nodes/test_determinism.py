"""The run over DDS and the closed loop without ROS are the same numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from line_run import TOPICS, run_both_ways
from own_model import by_model
from processes import Processes
from ros_client import Client
from rosbags.highlevel import AnyReader

from rx90_common.bags.comparison import Verdict
from rx90_common.bags.tables import comparison_text
from rx90_controller.law.parameters import MODEL_PARTS
from rx90_controller.lines.plan import plan_line
from rx90_controller.lines.task import load_task
from rx90_emulator.loop.setup import Setup


@pytest.mark.ros
def test_lockstep_gives_the_closed_loops_bits_on_a_loaded_machine(
    processes: Processes, client: Client, tx40: Setup, tmp_path: Path
) -> None:
    """With both cores busy, every recorded number equals the closed loop without ROS, to the last bit.

    The controller feeds forward by a model of its own. The robot is the one that a parameter names, and so is the
    description that the simulation publishes. The bag tells which trajectory ran and from when on, although its sender
    is gone before the recorder begins.
    """
    by_own_model = by_model(tx40)
    comparison = run_both_ways(processes, client, by_own_model, tmp_path, burners=2, switches=tuple(MODEL_PARTS))
    assert comparison.verdict is Verdict.SAME, comparison_text(comparison)
    assert {topic.topic for topic in comparison.topics} == TOPICS
    plan = plan_line(tx40.robot, load_task(tmp_path / "task.yaml"))
    with AnyReader([tmp_path / "recorded"]) as reader:
        sent = {c.topic: list(reader.messages([c])) for c in reader.connections if "/trajectory" in c.topic}
        ((connection, log_ns, data),) = sent["/rx90_controller/trajectory_accepted"]
        taken: Any = reader.deserialize(data, connection.msgtype)
        (description,) = (c for c in reader.connections if c.topic == "/robot_description")
        _, _, text = next(reader.messages([description]))
        assert reader.deserialize(text, description.msgtype).data == tx40.robot.urdf  # type: ignore[attr-defined]
    assert (taken.header.stamp.nanosec, log_ns) == (100_000_000, 100_000_000)
    assert taken.joint_names == list(plan.joint_names)
    assert [point.positions.tolist() for point in taken.points] == plan.position.tolist()
