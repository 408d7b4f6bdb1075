"""Simulation and controller as a user starts them: in either time, paused, asked for this and that, killed."""

import re
import signal
from itertools import groupby, pairwise
from pathlib import Path

import pytest
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from processes import Processes, open_files
from ros_client import JOINTS, Client, seconds
from rosgraph_msgs.msg import Clock
from scipy.optimize import brentq
from short_task import SHORT_TASK
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr_stamps import cdr_stamp_ns

ROS_ARGS = ("--ros-args", "-r", "__ns:=/cell_1")
SLOW_RATES = ("-p", "base_rate:=1000", "-p", "position_rate:=250")  # for time by the clock: fewer ticks to compute


@pytest.mark.ros
def test_a_paused_pair_is_heard_and_takes_a_trajectory(processes: Processes, client: Client) -> None:
    """Samples come again to the bit; a line is approached and begins when time runs; each node says ready once."""
    simulation = processes.start("rx90_sim", *ROS_ARGS, "-p", "paused:=true")
    simulation.wait_for(
        "ready: rx90b, lock_step at 4000 Hz, real_time_factor 1, states on /cell_1/motor_states; paused"
    )
    controller = processes.start("rx90_controller", *ROS_ARGS)
    raw, sampled = (client.listen(f"/cell_1/{name}joint_states", depth=10, raw=True) for name in ("", "sampled/"))
    clock = client.listen("/clock", Clock)
    diagnostics = client.listen("/diagnostics", DiagnosticArray)
    client.spin_until(lambda: min(map(len, (raw, sampled, clock))) > 3, "a heartbeat")
    assert len({*raw, *sampled}) == 1
    inodes = {link[8:-1] for link in open_files(simulation.pid) if link.startswith("socket:[")}
    bound = {
        fields[1].split(":")[0]
        for table in ("udp", "udp6")
        for fields in map(str.split, Path(f"/proc/net/{table}").read_text(encoding="ascii").splitlines()[1:])
        if fields[9] in inodes
    }
    assert bound == {"0100007F"}
    assert not re.search(r"/dev/shm/\S*fastrtps", Path(f"/proc/{simulation.pid}/maps").read_text(encoding="utf-8"))
    assert {(message.clock.sec, message.clock.nanosec) for message in clock} == {(0, 0)}
    line = ("robots/rx90b/task.yaml", "--approach", "--node", "/cell_1/rx90_controller")
    done = processes.run("rx90 line", *line)
    assert done.returncode == 0, done.stderr
    assert "time stands still at 0 s: the arm moves when it runs on" in done.stdout
    controller.wait_for("a trajectory waits for the simulation's first tick")
    client.asking.call(SetBool, "/cell_1/rx90_sim/pause", SetBool.Request(data=False))
    controller.wait_for("ready: rx90b, .* trajectories on /cell_1/rx90_controller/joint_trajectory")
    controller.wait_for("trajectory accepted")
    client.spin_until(lambda: len(set(raw)) > 100, "the arm to move")
    client.asking.call(SetBool, "/cell_1/rx90_sim/pause", SetBool.Request(data=True))
    client.spin_until(lambda: len(raw) > 5 and len(set(raw[-4:])) == 1, "the last sample again and again")
    assert len(set(sampled)) > 1
    assert {cdr_stamp_ns(sample) % 10_000_000 for sample in sampled} == {0}  # a hundred times a second

    def names() -> set[tuple[str, str]]:
        return {(status.name, status.hardware_id) for message in diagnostics for status in message.status}

    client.spin_until(lambda: len(names()) >= 2, "diagnostics of both nodes")
    assert names() == {(f"cell_1/{node}", "cell_1/rx90_emulator") for node in ("rx90_sim", "rx90_controller")}
    assert simulation.output.count("ready: ") == controller.output.count("ready: ") == 1


def to_rest(duration: float, position: list[float], names: list[str] = JOINTS) -> JointTrajectory:
    nanoseconds = round(duration * NANOSECONDS)
    after = Duration(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)
    point = JointTrajectoryPoint(positions=position, velocities=[0.0] * 6, time_from_start=after)
    return JointTrajectory(joint_names=names, points=[point])


@pytest.mark.ros
def test_an_unpaced_pair_answers_whatever_is_asked_of_it(processes: Processes, client: Client) -> None:
    """Refusals leave the motion alone; without power the brakes hold; diagnostics tell rate, and a fault as ERROR."""
    given = ("-p", "real_time_factor:=0", "-p", "initial_position:=[0.0, 0.8, 0.8, 0.0, 0.5, 0.0]")
    processes.start("rx90_sim", "--ros-args", *given)
    controller = processes.start("rx90_controller")
    joints, commands = client.listen("joint_states", depth=1), client.listen("motor_commands", depth=1)
    reference = client.listen("rx90_controller/reference", depth=1)
    publisher = client.node.create_publisher(JointTrajectory, "rx90_controller/joint_trajectory", 1000)
    client.spin_until(lambda: bool(reference) and publisher.get_subscription_count() > 0, "the controller to hold")

    # A burst is answered one by one; what is refused leaves the running motion alone.
    for _ in range(40):
        publisher.publish(JointTrajectory(joint_names=["elbow"]))
    client.spin_until(lambda: controller.output.count("trajectory rejected") == 40, "40 answers")
    target = [0.1, 0.7, 0.7, 0.1, 0.6, 0.1]
    publisher.publish(to_rest(0.5, target[::-1], JOINTS[::-1]))
    controller.wait_for("trajectory accepted")
    publisher.publish(to_rest(1.0, [0.0, 9.0, 0.0, 0.0, 0.0, 0.0]))
    assert "joint_2" in controller.wait_for(r"trajectory rejected: .*joint_2.*").group()
    controller.wait_for("trajectory ended")
    ended = client.listen("rx90_controller/reference", depth=1)  # none of those that wait here since before
    client.spin_until(lambda: bool(ended), "set-points after the end of the motion")
    assert list(ended[-1].position) == pytest.approx(target, abs=1e-12)
    assert list(ended[-1].velocity) == [0.0] * 6

    # Disabled: commands without torque, drives without torque, and the arm does not fall.
    client.spin_until(lambda: seconds(joints[-1]) > seconds(ended[-1]), "the arm after the end of the motion")
    assert max(map(abs, joints[-1].effort)) > 10.0  # the drives hold the arm
    held = joints[-1].position[1]
    client.enable(False)
    client.spin_until(lambda: bool(commands) and len(commands[-1].effort) == 0, "commands without torque")
    closed = seconds(commands[-1])
    client.spin_until(lambda: seconds(joints[-1]) > closed + 0.1, "a tenth of a second with closed brakes")
    # The brakes' stiffness lets the arm give by far less than a tenth of a milliradian.
    assert list(joints[-1].effort) == [0.0] * 6
    assert joints[-1].position[1] == pytest.approx(held, abs=2e-4)
    client.enable(True)

    # Slowly, because diagnostics come by the wall clock; the controller's rate is that of the ticks it answers.
    assert client.set_parameters("rx90_sim", real_time_factor=0.1) == [""]
    heard = client.listen("/diagnostics", DiagnosticArray)

    def told(word: str) -> bool:
        newest = [message.status[0] for message in heard if message.status[0].name == "rx90_controller"][-1]
        rate = next(float(pair.value) for pair in newest.values if pair.key == "rate, Hz")
        is_error = newest.level == DiagnosticStatus.ERROR
        return is_error == bool(word) and word in newest.message and 300.0 < rate < 500.0

    assert client.set_parameters("rx90_controller", supervision__following_error=[5e-4] * 6) == [""]
    publisher.publish(to_rest(0.4, [angle + 0.1 for angle in target]))
    controller.wait_for(r"joint_\d: following error .* rad at .* s; accepted: up to 0.0005 rad; torque off")
    client.spin_until(lambda: told("accepted: up to 0.0005 rad"), "the fault and a rate near 400 Hz")
    client.spin_until(lambda: max(map(abs, joints[-1].velocity)) < 1e-3, "the brakes to hold")  # no fault right again
    client.enable(True)
    client.spin_until(lambda: told(""), "its end")


@pytest.mark.ros
def test_time_runs_by_the_clock_with_pauses_and_without_a_controller(processes: Processes, client: Client) -> None:
    """A motion rests while time stands still, and goes on where it was; without a controller the brakes close."""
    given = ("-p", "joint_state_rate:=100", "-p", "time_mode:=free_running", "-p", "command_timeout:=0.05")
    simulation = processes.start("rx90_sim", "--ros-args", *SLOW_RATES, *given)
    controller = processes.start("rx90_controller", "--ros-args", *SLOW_RATES)
    joints = client.listen("joint_states")
    reference = client.listen("rx90_controller/reference", depth=1)
    client.spin_until(lambda: bool(reference), "the controller to hold")
    client.send([(3.0, [0.1] * 6)])  # long enough to be paused in time on a loaded machine
    controller.wait_for("trajectory accepted")
    client.spin_until(lambda: reference[-1].position[0] > 0.03, "the motion")
    client.simulation.pause(True)
    controller.wait_for("the loops rest")
    resting, reached = seconds(reference[-1]), reference[-1].position[0]
    assert 0.03 < reached < 0.099
    client.simulation.pause(False)
    end = pytest.approx([0.1] * 6, abs=1e-12)
    client.spin_until(lambda: list(reference[-1].position) == end, "the end of the motion")
    # Not earlier than the cubic takes from where it was: no set-point was left out.
    done = brentq(lambda share: 0.1 * share * share * (3.0 - 2.0 * share) - reached, 0.0, 1.0)
    assert seconds(reference[-1]) > resting + 3.0 * (1.0 - done) - 0.01

    controller.signal(signal.SIGSTOP)
    stopped = seconds(joints[-1])
    client.spin_until(lambda: seconds(joints[-1]) > stopped + 0.2, "time to run on")
    assert "torque off, brakes closed" in simulation.output
    closed = len(simulation.lines)
    controller.signal(signal.SIGCONT)
    client.spin_until(lambda: any("the brakes open" in line for line in simulation.lines[closed:]), "open brakes")


UNPACED = ("--ros-args", "-p", "real_time_factor:=0.0")


@pytest.mark.ros
def test_either_node_is_killed_and_comes_back(processes: Processes, client: Client, tmp_path: Path) -> None:
    """Without its controller time stands still, announced once, until the next one; a new simulation begins anew."""
    recorder = processes.start("rx90 bag", "record", "--output", tmp_path / "bag", "motor_states", "motor_commands")
    simulation = processes.start("rx90_sim", *UNPACED)
    first = processes.start("rx90_controller")
    # As deep as the simulation can get until the signal arrives: nobody takes messages while the line is waited for.
    heard = client.listen("joint_states", depth=20_000)
    client.spin_until(lambda: "ready: all topics" in recorder.output, "the recorder")
    client.spin_until(lambda: bool(heard) and seconds(heard[-1]) > 0.2, "time to run")
    recorder.signal(signal.SIGKILL)
    killed, lines = seconds(heard[-1]), len(simulation.lines)
    client.spin_until(lambda: seconds(heard[-1]) > killed + 0.2, "time to run without the recorder")
    assert not [line for line in simulation.lines[lines:] if "stands still" in line]
    first.signal(signal.SIGKILL)
    simulation.wait_for("time stands still")
    client.spin_until(lambda: _drained(client, heard), "the last messages")
    stopped = seconds(heard[-1])
    second = processes.start("rx90_controller")
    simulation.wait_for("time runs on")
    client.spin_until(lambda: seconds(heard[-1]) > stopped + 0.2, "time to run on")
    # While time stands still, the newest sample comes again.
    stamps = [stamp for stamp, _ in groupby(seconds(message) for message in heard)]
    assert all(b - a == pytest.approx(1e-3) for a, b in pairwise(stamps))
    # Once for each wait; there is another one where the controller takes long to begin.
    told = re.findall("the brakes hold the arm|time stands still|time runs on", simulation.output)
    assert all((before == "time runs on") != (after == "time runs on") for before, after in pairwise(told)), told

    # After SIGKILL of the simulation the controller says once that it waits, and serves the next one from tick 0.
    heard.clear()
    client.spin_until(lambda: bool(heard) and seconds(heard[-1]) > stopped + 0.3, "time to run far")
    simulation.signal(signal.SIGKILL)
    second.wait_for("waiting for a simulation")
    before = second.output.count("waiting for a simulation")
    client.spin_until(lambda: _drained(client, heard), "the last messages")
    # Paused, so that its first sample is heard however long the client takes to find it.
    processes.start("rx90_sim", *UNPACED, "-p", "paused:=true")
    client.spin_until(lambda: seconds(heard[-1]) == 0.0, "time to begin again")
    client.simulation.pause(False)
    client.spin_until(lambda: seconds(heard[-1]) > 0.1, "time to run again")
    assert second.output.count("waiting for a simulation") - before <= 1


def _drained(client: Client, heard: list[object]) -> bool:
    before = len(heard)
    client._executor.spin_once(timeout_sec=0.3)
    return len(heard) == before


@pytest.mark.ros
def test_trials_begin_alike(processes: Processes, tmp_path: Path) -> None:
    """What the first trial teaches holds for the next: as on the engine, less than a quarter of its error remains."""
    task = tmp_path / "task.yaml"
    line = SHORT_TASK.replace("[0.6034, -0.2808, 0.1955]", "[0.634, -0.108, 0.155]").replace("0.05", "0.3")
    task.write_text(line, encoding="utf-8")
    processes.start("rx90_cell")
    words = ("--trials", "1", "--output", tmp_path / "line.yaml")
    done = processes.run("rx90 correct nodes", task, *words)
    first, second = (float(worst) for worst in re.findall(r"trial \d: worst (\S+) mm", done.stdout))
    assert second < 0.25 * first, done.stdout
