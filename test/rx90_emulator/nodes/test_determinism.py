"""The nodes, in one process or two, and the closed loop without ROS are the same numbers, whatever the machine does."""

from __future__ import annotations

import signal
import struct
import subprocess
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from full_friction import write_with_parts
from line_run import TOPICS, run_both_ways
from needs import need
from own_model import by_model
from processes import Processes
from ros_client import Client, seconds
from rosbags.highlevel import AnyReader

import rx90_emulator as rx
from rx90_common.bags.comparison import Verdict
from rx90_common.bags.tables import comparison_text
from rx90_common.base.errors import ConfigError
from rx90_controller.law.parameters import MODEL_PARTS
from rx90_controller.lines.plan import plan_line
from rx90_controller.lines.task import load_task
from rx90_emulator.composed_cell import own_parameters
from rx90_emulator.loop.setup import Setup

SHARE = 0.01
LEAST_LOST = 20


@pytest.fixture(scope="module")
def lossy_udp(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a library that, preloaded into a process, lets datagrams disappear."""
    need("native")
    library = tmp_path_factory.mktemp("lossy") / "lossy_udp.so"
    source = Path(__file__).with_name("lossy_udp.c")
    command = ["cc", "-std=c11", "-Wall", "-Werror", "-O2", "-fPIC", "-shared", str(source), "-ldl"]
    subprocess.run([*command, "-o", str(library)], check=True)
    return library


@pytest.mark.ros
def test_lockstep_gives_the_closed_loops_bits_on_a_loaded_machine_that_loses_datagrams(
    lossy_udp: Path, processes: Processes, client: Client, tx40: Setup, tmp_path: Path
) -> None:
    """With a core busy and 1 % of what both nodes send lost, every number equals the closed loop without ROS."""
    counts = tmp_path / "counts"
    counts.write_bytes(bytes(16))
    around = (
        *("/usr/bin/env", f"LD_PRELOAD={lossy_udp}", f"LOSSY_SHARE={SHARE}", "LOSSY_SEED=1"),
        f"LOSSY_COUNTS={counts}",
    )
    comparison = run_both_ways(
        processes, client, by_model(tx40), tmp_path, around=around, burners=1, switches=tuple(MODEL_PARTS)
    )
    sent, lost = struct.unpack("QQ", counts.read_bytes())
    print(f"{lost} of {sent} datagrams lost")
    assert lost > LEAST_LOST
    assert lost / sent == pytest.approx(SHARE, rel=0.5)
    assert comparison.verdict is Verdict.SAME, comparison_text(comparison)
    assert {topic.topic for topic in comparison.topics} == TOPICS
    plan = plan_line(tx40.robot, load_task(tmp_path / "task.yaml"))
    with AnyReader([tmp_path / "recorded"]) as reader:
        sent_on = {c.topic: list(reader.messages([c])) for c in reader.connections if "/trajectory" in c.topic}
        ((connection, log_ns, data),) = sent_on["/rx90_controller/trajectory_accepted"]
        taken: Any = reader.deserialize(data, connection.msgtype)
        (description,) = (c for c in reader.connections if c.topic == "/robot_description")
        _, _, text = next(reader.messages([description]))
        assert reader.deserialize(text, description.msgtype).data == tx40.robot.urdf  # type: ignore[attr-defined]
    assert (taken.header.stamp.nanosec, log_ns) == (100_000_000, 100_000_000)
    assert taken.joint_names == list(plan.joint_names)
    assert [point.positions.tolist() for point in taken.points] == plan.position.tolist()


@pytest.mark.ros
def test_one_process_gives_the_closed_loops_bits(
    processes: Processes, client: Client, shipped: Setup, tmp_path: Path
) -> None:
    """With a parameter file for both, every recorded number equals the closed loop without ROS, to the last bit."""
    friction = write_with_parts(shipped.friction.file, tmp_path / "friction.yaml")
    setup = rx.load_setup(friction=friction, seed=11)
    comparison = run_both_ways(processes, client, setup, tmp_path, composed=True, rests=2, corrected=True)
    assert {topic.topic for topic in comparison.topics} == {*TOPICS, "/rx90_controller/correction"}
    assert comparison.verdict is Verdict.SAME, comparison_text(comparison)


@pytest.mark.ros
def test_services_and_the_end_in_free_running_time_are_those_of_two_processes(processes: Processes) -> None:
    """In a namespace: a motion, no torque, time that begins anew, Ctrl-C; time under one's hand: action/."""
    with closing(Client("/cell_1")) as client:
        cell = processes.start(
            "rx90_cell", "--ros-args", "-r", "__ns:=/cell_1", "-p", "rx90_sim:time_mode:=free_running"
        )
        joints, reference = client.listen("joint_states", depth=1), client.listen("rx90_controller/reference", depth=1)
        client.spin_until(lambda: bool(joints) and max(joints[-1].effort) > 0.0, "the drives' torque")
        client.send([(0.3, [0.02] * 6)])
        end = pytest.approx([0.02] * 6, abs=1e-12)
        client.spin_until(lambda: bool(reference) and list(reference[-1].position) == end, "the end of the motion")
        client.enable(False)
        client.spin_until(lambda: list(joints[-1].effort) == [0.0] * 6, "no torque")
        before = seconds(joints[-1])
        client.simulation.reset()
        client.spin_until(lambda: seconds(joints[-1]) < before, "time to go back")
        cell.signal(signal.SIGINT)
        assert cell.wait() == 0
        assert "Traceback" not in cell.output


def test_a_parameter_of_another_node_is_refused() -> None:
    """A parameter goes to the node that it names, whatever the namespace; a node that is not there is refused."""
    words = ["--ros-args", "-p", "rx90_sim:a:=1", "-p", "b:=rx90_sim:c", "--param", "rx90_controller:d:=x:=y"]
    own = own_parameters(words)
    assert own == {"rx90_sim": ["--ros-args", "-p", "a:=1"], "rx90_controller": ["--ros-args", "-p", "d:=x:=y"]}
    with pytest.raises(ConfigError, match="'rx90_simulation:a:=1': no such node here; accepted: rx90_sim, rx90_cont"):
        own_parameters(["-p", "rx90_simulation:a:=1"])
