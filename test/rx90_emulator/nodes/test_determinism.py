"""Nodes, in one process or two, and the closed loop without ROS are the same numbers, whatever machine and arm do."""

import re
import signal
import struct
import subprocess
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from full_drives import DRIVE_BLOCKS
from full_friction import write_with_parts
from line_run import TOPICS, run_both_ways
from needs import need
from own_model import by_model
from processes import Processes
from ros_client import JOINTS, Client, seconds
from rosbags.highlevel import AnyReader

import rx90_emulator as rx
from benchmarks.any_arm import joint_names, write_arm
from rx90_common.base.errors import ConfigError
from rx90_common.base.share import config_path
from rx90_common.process.children import ChildProcess
from rx90_controller.law.parameters import MODEL_PARTS
from rx90_controller.lines.plan import plan_line
from rx90_controller.node.trajectory_client import TrajectoryClient
from rx90_emulator.cli.frame import run
from rx90_emulator.composed_cell import own_parameters
from rx90_emulator.loop.closed_loop import simulate_commands
from rx90_emulator.loop.result import MotionCommand, write_bag

pytestmark = pytest.mark.ros

SHARE = 0.01
LEAST_LOST = 20


@pytest.fixture(scope="module")
def lossy_udp(tmp_path_factory: pytest.TempPathFactory) -> Path:
    need("native")
    library = tmp_path_factory.mktemp("lossy") / "lossy_udp.so"
    source = Path(__file__).with_name("lossy_udp.c")
    command = ["cc", "-std=c11", "-Wall", "-Werror", "-O2", "-fPIC", "-shared", str(source), "-ldl"]
    subprocess.run([*command, "-o", str(library)], check=True)
    return library


def test_lockstep_gives_the_closed_loops_bits_on_a_loaded_machine_that_loses_datagrams(
    lossy_udp: Path, processes: Processes, client: Client, tx40: rx.Setup, tmp_path: Path
) -> None:
    """A core busy, 1 % of datagrams lost, rests, a correction: every number equals the closed loop without ROS."""
    counts = tmp_path / "counts"
    counts.write_bytes(bytes(16))
    around = (
        *("/usr/bin/env", f"LD_PRELOAD={lossy_udp}", f"LOSSY_SHARE={SHARE}", "LOSSY_SEED=1"),
        f"LOSSY_COUNTS={counts}",
    )
    switches = tuple(MODEL_PARTS)
    comparison = run_both_ways(
        processes, client, by_model(tx40), tmp_path, around=around, burners=1, rests=2, switches=switches
    )
    sent, lost = struct.unpack("QQ", counts.read_bytes())
    print(f"{lost} of {sent} datagrams lost")
    assert lost > LEAST_LOST
    assert lost / sent == pytest.approx(SHARE, rel=0.5)
    assert comparison.verdict is rx.Verdict.SAME, rx.comparison_text(comparison)
    assert {topic.topic for topic in comparison.topics} == {*TOPICS, "/rx90_controller/correction"}
    plan = plan_line(tx40.robot, rx.load_task(tmp_path / "task.yaml"))
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


@pytest.mark.usefixtures("needs_action")
def test_free_running_time_in_one_process(processes: Processes) -> None:
    """In a namespace: a goal that is followed, no torque, time that begins anew, Ctrl-C."""
    from action_client import GoalClient, move

    with closing(Client("/cell_1")) as client:
        cell = processes.start(
            "rx90_cell", "--ros-args", "-r", "__ns:=/cell_1", "-p", "rx90_sim:time_mode:=free_running"
        )
        joints, reference = client.listen("joint_states", depth=1), client.listen("rx90_controller/reference", depth=1)
        client.spin_until(lambda: bool(joints) and max(joints[-1].effort) > 0.0, "the drives' torque")
        goals = GoalClient(client)
        ended = goals.wait(goals.result_of(goals.send(move(0.02, 0.3))))
        assert (ended.status, ended.result.error_code) == (GoalStatus.STATUS_SUCCEEDED, 0)
        client.spin_until(lambda: bool(goals.feedback), "what was told of it")
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


SEED = 11
STEP, STEPS = 400, 11  # ticks of one call of ~/step, calls
DURATION = STEP * STEPS / 4000  # s
START = 0.15  # s
POSE = np.array([0.0, 0.5, 0.8, 0.0, 0.5, 0.0])
THERE = rx.TrajectoryPoints(
    np.array([0.5]), POSE[None] + 0.1 * np.array([[1, -1, 1, 1, -1, 1]]), np.zeros((1, 6)), None
)


def _record(processes: Processes, client: Client, cell: ChildProcess, bag: Path) -> None:
    recorder = processes.start("rx90 bag", "record", "--output", bag)
    recorder.wait_for("ready: all")
    reference = client.listen("rx90_controller/reference", depth=1)
    client.known_to("rx90_controller")
    client.simulation.step()
    sender = TrajectoryClient(client.asking, "rx90_controller")
    sender.wait_for_controller()
    sender.send(JOINTS, THERE, START)
    cell.wait_for("trajectory accepted")  # it has come, but ticks and messages have a thread each
    for _ in range(STEPS - 1):
        client.simulation.step()
    # The controller publishes after its command, with which the step is done.
    client.spin_until(lambda: bool(reference) and seconds(reference[-1]) > DURATION - 1.5e-3, "the last set-point")
    recorder.signal(signal.SIGINT)
    assert recorder.wait() == 0


def the_same(one: Path, other: Path) -> None:
    comparison = rx.compare_bags(one, other)
    assert comparison.verdict is rx.Verdict.SAME, rx.comparison_text(comparison)
    assert len(comparison.topics) == 9  # of joint states


def test_all_parts_of_an_arm_in_nodes(
    processes: Processes, client: Client, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With elastic gears, cogging, sensors, windings and all parts of friction nodes and engine agree bit by bit."""
    content = yaml.safe_load(config_path("robots/rx90b/drives.yaml").read_text(encoding="utf-8"))
    content["motor"]["peak_current"][1] = 3.4  # so little that a warm winding makes itself felt
    drives = tmp_path / "drives.yaml"
    drives.write_text(yaml.safe_dump({**content, **DRIVE_BLOCKS}), encoding="utf-8")
    friction = write_with_parts(config_path("robots/rx90b/friction.yaml"), tmp_path / "friction.yaml")
    setup = rx.load_setup(drives=drives, friction=friction, seed=SEED)
    engine, first, second, again = (tmp_path / name for name in ("engine", "first", "second", "again"))
    write_bag(simulate_commands(setup, [MotionCommand(150, THERE)], POSE, DURATION, record_fast=True), engine)
    of_simulation = {
        "paused": "true", "real_time_factor": 0.0, "step_ticks": STEP, "friction": friction,
        "seed": SEED, "initial_position": POSE.tolist(),
    }  # fmt: skip
    words = [word for name, value in of_simulation.items() for word in ("-p", f"rx90_sim:{name}:={value}")]
    cell = processes.start("rx90_cell", "--ros-args", "-p", f"drives:={drives}", *words)
    _record(processes, client, cell, first)
    client.simulation.reset()
    _record(processes, client, cell, second)
    heard = client.listen("/diagnostics", DiagnosticArray)
    assert client.set_parameters("rx90_sim", real_time_factor=0.05) == [""]
    client.simulation.pause(False)

    def warnings() -> list[DiagnosticStatus]:
        told = [message.status[0] for message in heard]
        return [one for one in told if one.name == "rx90_sim" and one.level == DiagnosticStatus.WARN]

    client.spin_until(lambda: any("motor" in one.message for one in warnings()), "the warning")
    status = next(one for one in warnings() if "motor" in one.message)
    the_same(first, engine)
    the_same(first, second)
    files = ["--drives", str(drives), "--friction", str(friction)]
    capsys.readouterr()
    assert run("rx90 replay", [str(first), *files, "--output", str(again)]) == 0
    assert f"seed {SEED}, as the bag tells\n" in capsys.readouterr().out
    the_same(first, again)

    found, commanded = (
        rx.read_joint_states(first, f"rx90_controller/{name}_current").effort for name in ("motor", "commanded")
    )
    torque = rx.read_joint_states(first, "motor_states").effort
    assert np.array_equal(found, torque[::40] / setup.drives.torque_constant)
    resolution = np.array(setup.drives.current_sensor.resolution)
    assert found / resolution == pytest.approx(np.round(found / resolution), abs=1e-9)
    assert np.all(np.ptp(found - commanded, axis=0) > 2.0 * resolution)

    text = r"motor_2 at (1\d\d\.\d) °C has (\d\d) % of its peak current"
    said = re.search(text, status.message)
    assert float(said[2]) == pytest.approx(100.0 * (140.0 - float(said[1])) / 40.0 - 0.5, abs=0.7)  # rounded down
    values = {pair.key: pair.value for pair in status.values}
    assert values["windings, °C"].split()[1] == said[1]
    assert [int(count) > 0 for count in values["saturated ticks"].split()] == [False, True] + [False] * 4
    # Once as the first run makes it warm, and once as time goes on after the reset, at the most.
    assert 1 <= len(re.findall(rf"\[WARN\].*{text}", cell.output)) <= 2


SHORT = 0.3  # s


def test_nodes_of_seven_joints_give_the_engines_bits(processes: Processes, client: Client, tmp_path: Path) -> None:
    """In lock-step all that is recorded of a short motion is that of the loop without ROS."""
    folder = write_arm(tmp_path / "arm", 7)
    # The engine first, which leaves its compiled code to the nodes.
    setup, goal = rx.load_setup(robot=folder), np.full((1, 7), 0.05)
    points = rx.TrajectoryPoints(np.array([0.25]), goal, np.zeros((1, 7)), None)
    motion = simulate_commands(setup, (MotionCommand(0, points),), np.zeros(7), SHORT, record_fast=True)
    write_bag(motion, tmp_path / "engine")
    given = ["-p", f"robot:={folder}"]
    for name, value in (("paused", "true"), ("duration", SHORT), ("real_time_factor", 0.0)):
        given += ["-p", f"rx90_sim:{name}:={value}"]
    simulation, controller = (processes.start(name, "--ros-args", *given) for name in ("rx90_sim", "rx90_controller"))
    simulation.wait_for("]: ready: ")
    recorder = processes.start("rx90 bag", "record", "--output", tmp_path / "nodes")
    recorder.wait_for("ready: all")
    client.send([(0.25, goal[0].tolist())], joint_names(7))
    client.known_to("rx90_sim")
    client.simulation.pause(False)
    assert simulation.wait() == 0
    for process in (controller, recorder):
        process.signal(signal.SIGINT)
        assert process.wait() == 0, process.output
    the_same(tmp_path / "nodes", tmp_path / "engine")
    assert np.abs(motion.slow.joint_states[-1, 0] - 0.05).max() < 1e-3
