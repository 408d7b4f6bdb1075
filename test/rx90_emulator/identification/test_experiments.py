"""The planned motions: within the arm's limits, separating the elements, run into bags; the complete path on nodes."""

import os
import re
import signal
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from processes import Processes, open_files, wait_until

import rx90_emulator as rx
from rx90_common.bags.reading import BagReader, read_joint_states
from rx90_common.base.errors import DONE, INTERRUPTED, ConfigError, IdentificationError
from rx90_common.description.coupling import RX_WRIST
from rx90_common.friction import load_friction
from rx90_controller.trajectory.motion import Motion
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.experiments import nodes
from rx90_emulator.identification.experiments import plan as plans
from rx90_emulator.identification.experiments.arms import PlannedArm
from rx90_emulator.identification.experiments.excitation import plan_excitation
from rx90_emulator.identification.experiments.options import ExcitationOptions
from rx90_emulator.identification.experiments.plan import (
    Experiment,
    Kind,
    PlanOptions,
    directions,
    make_plan,
    plan_experiments,
    poses_of,
    read_index,
    sweep_speeds,
)

pytestmark = pytest.mark.slow


def test_the_plan_keeps_every_limit(shipped: rx.Setup) -> None:
    """Each experiment of the default plan stays within ranges, speeds and torques, by the controller's own check."""
    for experiment in make_plan(shipped.robot, shipped.drives):
        assert np.allclose(experiment.points.position[[0, -1]], poses_of(shipped).home.position, atol=1e-12)
        used = PlannedArm.from_setup(shipped).check(experiment)
        assert all(share <= 1.0 for share, _ in used.values())


def test_a_robot_brings_its_own_poses_and_its_ranges_bound_the_sweeps(tx40: rx.Setup) -> None:
    """The TX40's joint 6, whose fastest sweep would take more room than it has, is swept more slowly and within it."""
    sweep = plan_experiments(tx40, ["joint_6"], quick=True)[0]
    assert 0.3 < PlannedArm.from_setup(tx40).check(sweep)["speed"][0] < 0.4
    with pytest.raises(ConfigError, match=r"no poses.yaml; accepted: a poses file"):
        plan_experiments(replace(tx40, files=replace(tx40.files or rx.RobotFiles(), poses=None)))


def test_sweeps_hold_a_logarithmic_range_in_both_directions(shipped: rx.Setup) -> None:
    """Joint 1 is held at 28 speeds in each direction, all different, evenly spaced in their logarithms."""
    points = make_plan(shipped.robot, shipped.drives, PlanOptions(groups=("joint_1",)))[0].points
    same = (points.velocity[:-1, 0] == points.velocity[1:, 0]) & (points.velocity[:-1, 0] != 0.0)
    held, lasting = points.velocity[:-1, 0][same], np.diff(points.times)[same]
    assert lasting == pytest.approx(np.clip(0.6 / np.abs(held), 0.7, 4.0), abs=1.001e-3)
    nominal = np.log(np.geomspace(0.004, 0.4 * shipped.robot.max_velocity[0], 56))
    for sign, first in ((1.0, 0), (-1.0, 1)):
        speeds = np.unique(np.round(held[sign * held > 0.0] * sign, 9))
        assert len(speeds) == PlanOptions().speeds
        # A speed lies below its nominal place by less than the next one's distance, away from a beat with the sampling.
        below = nominal[first::2] - np.log(speeds)
        assert below.min() > -1e-6
        assert below.max() < nominal[1] - nominal[0]


def test_no_sweep_beats_with_the_sampling(shipped: rx.Setup) -> None:
    """No motor passes nearly a whole, half, third or quarter number of encoder steps in a millisecond of a sweep."""
    drives = shipped.drives
    for name, direction in directions(shipped.robot.joint_names, drives.turning).items():
        speeds = sweep_speeds(direction, 0.004, 1.4, 56, drives)
        motors = drives.gear * direction
        motors[5] = drives.gear[5] * (direction[4] + direction[5])
        steps = np.outer(speeds, np.abs(motors[motors != 0.0])) * drives.encoder_counts / (2.0 * np.pi) * 1e-3
        parts = steps[..., None] * np.array([1.0, 2.0, 3.0, 4.0])
        assert np.abs(parts - np.round(parts)).min() > 0.05, name


def test_oscillations_are_what_they_say() -> None:
    """In the middle of an oscillation the knots' position, velocity and acceleration are those of the sine."""
    motion = Motion(np.zeros(6))
    motion.oscillate(np.eye(6)[2], [1e-4], [8.0], 4.0)
    points = motion.points([f"joint_{i}" for i in range(1, 7)])
    middle = (points.times > 1.1) & (points.times < 2.9)
    omega, time = 16.0 * np.pi, points.times[middle]
    assert np.allclose(points.position[middle, 2], 1e-4 * np.sin(omega * time), atol=1e-12)
    assert np.allclose(points.velocity[middle, 2], 1e-4 * omega * np.cos(omega * time), atol=1e-10)
    assert np.allclose(points.acceleration[middle, 2], -1e-4 * omega**2 * np.sin(omega * time), atol=1e-8)


def test_a_plan_beyond_what_joints_or_motors_may_do_is_refused(shipped: rx.Setup) -> None:
    """More torque than the URDF allows, or acceleration than the controller, is refused with joint, value and limit."""
    robot, drives = shipped.robot, shipped.drives
    sweep_2, sweep_5 = (make_plan(robot, drives, PlanOptions(groups=(f"joint_{k}",)))[0] for k in (2, 5))
    way = 1.5 * robot.max_velocity / robot.max_velocity[4] * (0.0, 0.0, 0.0, 0.0, 1.0, 1.0)
    motion = Motion(-way)
    motion.move(way, 0.9 * robot.max_velocity, 100.0)
    fast = Experiment("fast", Kind.VALIDATION, motion.points(robot.joint_names), 1)
    both = 0.9 * (1.0 + robot.max_velocity[4] / robot.max_velocity[5])
    weak = drives.replaced(motor={"peak_current": drives.peak_current * (1.0, 1.0, 1.0, 1.0, 0.1, 1.0)})
    slow = shipped.controller.replaced(trajectory={"max_acceleration": np.full(6, 4.9)})
    for experiment, setup, said in (
        (sweep_2, replace(shipped, robot=replace(robot, max_effort=0.4 * robot.max_effort)),
         r"joint_2 would need 2\d\d% of its torque; accepted: up to"),
        (sweep_2, replace(shipped, controller=slow),
         r"joint_\d gets a set-point acceleration .* accepted: \[-4.9, 4.9\]"),
        (fast, shipped, rf"fast: motor_6 would need {both:.0%} of its motor speed"),
        (sweep_5, replace(shipped, drives=weak),
         r"motor_5 would need .* of its motor torque"),
    ):  # fmt: skip
        with pytest.raises(IdentificationError, match=said):
            PlannedArm.from_setup(setup).check(experiment)


def test_the_engine_writes_the_bags_that_the_recorder_would(series: Path) -> None:
    """A series on the engine has an index and bags with joint states, motor states and set-points."""
    bags = read_index(series)
    assert [bag.name for bag in (*bags.sliding, *bags.presliding, *bags.validation)] == [
        "sliding_joint_3",
        "presliding_joint_3",
        "validation",
    ]
    wanted = [{"joint_states"}, {"motor_states"}, {"motor_states", "rx90_controller/reference"}]
    for bag, topics in zip((*bags.sliding, *bags.presliding, *bags.validation), wanted, strict=True):
        with BagReader(bag) as reader:
            assert {there.name for there in reader.topics} == {f"/{topic}" for topic in (*topics, "robot_description")}
    for bag in (*bags.presliding, *bags.validation):
        assert np.median(np.diff(read_joint_states(bag, "motor_states").stamp_ns)) == 250_000


def test_the_runs_of_one_joint_tell_that_joint_alone(
    series: Path, identified: tuple[Path, str], shipped: rx.Setup, check_report: Callable[[Path], None]
) -> None:
    """From bags of joint 3 come a file that the simulation loads, with its values alone, a report and a verdict."""
    output, said = identified
    found, truth = (
        load_friction(output, RX_WRIST.element_names(shipped.robot.joint_names)).elements[2],
        shipped.friction.elements[2],
    )
    assert found.tau_c.positive == pytest.approx(truth.tau_c.positive, rel=0.1)
    assert "confirmed by a bag that the fit did not use; 54 of 63 values are assumed: " in said
    (share,) = re.findall(r"torque RMS of a joint, away from reversals ([\d.]+)%", said)
    assert float(share) < 0.3  # with c0 and c1 of joints 2, 5 and 6 from their reactions it was 0.6 %
    content = yaml.safe_load(output.read_text(encoding="utf-8"))
    parameters = content["identification"]["parameters"]
    told = {name for name, one in parameters.items() if any("interval" in each for each in one.values())}
    assert told == {"joint_3"}
    assert parameters["joint_4"]["c2"]["provenance"] == "assumed"
    true = yaml.safe_load((series / "emulated_friction.yaml").read_text(encoding="utf-8"))["elements"]["joint_3"]
    for name in ("c0", "c1"):
        low, high = parameters["joint_3"][name]["interval"]
        assert low < true[name] < high
    page = output.with_suffix(".html").read_text(encoding="utf-8")
    assert re.findall(r'class="fact *([a-z]*)"><b>confirmed', page) == [""]  # not green beside assumed values
    assert re.search(r"worst distance of the tips, RMS [\d.]+ µm; accepted 100 µm", page)
    check_report(output.with_suffix(".html"))


def test_a_friction_file_says_which_bags_tell_a_value_and_how_well_they_fit(identified: tuple[Path, str]) -> None:
    """Values have the bags of their own joint and regime; sweeps are accounted for, and a fit has its figures."""
    content = yaml.safe_load(identified[0].read_text(encoding="utf-8"))["identification"]
    sweep, wiggle = content["bags"]
    assert [Path(bag["path"]).name for bag in content["bags"].values()] == ["sliding_joint_3", "presliding_joint_3"]
    for joint, of_bristles in (("joint_3", [wiggle]), ("joint_4", [])):
        parameters = content["parameters"][joint]
        assert [parameters[name]["bags"] for name in ("tau_c_positive", "c2", "c0")] == [[sweep], [sweep], of_bristles]
    (fit,) = content["fit"].values()
    assert 0.0 < fit["chi2"] < 3.0
    assert fit["rms"] > 0.0
    assert fit["share"] < 0.01
    used = content["sweeps"]["sliding_joint_3"]
    assert re.fullmatch(r"used .* plateaus, joint_3 0\.00\d+ to [\d.]+ rad/s; left out .*", used)


def test_the_closed_loop_along_the_recorded_set_points_is_judged_at_the_tip(
    series: Path, shipped: rx.Setup, tmp_path: Path
) -> None:
    """With the friction that made the bag the tip is where it was; twice as much of joint 3 is refused by the tip."""
    (true,) = rx.check_friction(shipped.files.friction, [series / "validation"])
    assert true.tip.worst < 1e-5
    assert true.passed
    assert true.criteria[-1].quantity == "tip worst"
    file = rx.FrictionFile.read(shipped.files.friction)
    third = file.elements["joint_3"]
    static = 2.0 * third.tau_s.positive
    elements = {**file.elements.entries, "joint_3": third.replaced(tau_c=2.0 * third.tau_c.positive, tau_s=static)}
    (tmp_path / "twice.yaml").write_text(rx.FrictionFile.of(elements, provenance="assumed").text(), encoding="utf-8")
    (wrong,) = rx.check_friction(tmp_path / "twice.yaml", [series / "validation"])
    assert {criterion.quantity for criterion in wrong.criteria if not criterion.passed} >= {
        "tip worst",
        "largest torque difference",
    }


def short_series(setup: rx.Setup) -> list[Experiment]:
    """Return sweeps of one joint, much less than --quick: joint 4, seven speeds, 18 s; and one that is too long."""
    names, fourth = setup.robot.joint_names, np.eye(6)[3]
    cycle, slide, long = (Motion(np.zeros(6)) for _ in range(3))
    cycle.sweep(fourth, 0.05, 0.3, 6.0)
    cycle.oscillate(fourth, [2e-3], [1.0], 2.0)
    cycle.oscillate(fourth, [1e-5] * 4, [3.0, 8.0, 14.0, 22.0], 2.0)
    cycle.move(np.zeros(6), np.ones(6), 5.0)
    for speed in np.geomspace(0.041, 1.6, 7):
        slide.sweep(fourth, speed, 0.7, 6.0)
        slide.sweep(fourth, -speed, 0.7, 6.0)
    long.sweep(fourth, 1e-3, 400.0, 6.0)
    return [
        Experiment("cycle", Kind.PRESLIDING, cycle.points(names), 2),
        Experiment("slide", Kind.SLIDING, slide.points(names), 10),
        Experiment("long", Kind.SLIDING, long.points(names), 1),
    ]


EXCITATION = ExcitationOptions(harmonics=3, period=1.0, tempos=((1.0, 1),), steps=2)


@pytest.mark.ros
def test_experiments_run_on_the_real_nodes(
    processes: Processes,
    shipped: rx.Setup,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The recorder's bag of a planned excitation run has the set-points and torques of the engine, to the bit."""
    cell = processes.start("rx90_cell", "--ros-args", "-p", "rx90_sim:real_time_factor:=2.0")
    run_of_plan = plan_excitation(PlannedArm.from_setup(shipped), EXCITATION)[0][0]
    series = short_series(shipped)
    monkeypatch.setattr(plans, "make_plan", lambda *_: [run_of_plan, *series])
    last_time, cut_off = nodes._last_time, [0.0]

    def too_early_once(bag: Path) -> float:
        return cut_off.pop() if bag.name == "cycle" and cut_off else last_time(bag)

    monkeypatch.setattr(nodes, "_last_time", too_early_once)
    folder = tmp_path / "bags"
    interrupt = threading.Thread(target=interrupt_once, args=[folder / "long"])
    interrupt.start()
    assert run("rx90 experiment sliding", ["nodes", "--output", str(folder)]) == INTERRUPTED
    interrupt.join()
    cell.signal(signal.SIGINT)
    said = capsys.readouterr().err
    assert said.splitlines()[-1] == "rx90 experiment: interrupted; complete bags stay"
    again = re.findall(r"(\w+): the bag ends at [\d.]+ s, before the motion does at [\d.]+ s; again", said)
    assert again.count("cycle") >= 1
    done = read_index(folder)
    bags = *done.excitation, *done.presliding, *done.sliding
    assert [bag.name for bag in bags] == ["excitation_1", "cycle", "slide"]
    assert not [file for file in open_files() if str(folder) in file]
    if run_of_plan.name not in again:  # on a busy machine: from where the first time ended
        check_against_the_engine(done.excitation[0], run_of_plan, shipped)
    output = tmp_path / "friction.yaml"
    words = ["sliding", folder / "slide", "--presliding", folder / "cycle", "--output", output]
    assert run("rx90 identify", [str(word) for word in words]) == DONE
    found, true = (
        load_friction(output, RX_WRIST.element_names(shipped.robot.joint_names)).elements[3],
        shipped.friction.elements[3],
    )
    assert abs(found.tau_c.positive / true.tau_c.positive - 1.0) < 0.02
    assert abs(found.c0 / true.c0 - 1.0) < 0.05


def check_against_the_engine(bag: Path, run: Experiment, setup: rx.Setup) -> None:
    names = ("motor_states", "rx90_controller/reference")
    _, reference = recorded = [read_joint_states(bag, name) for name in names]
    still = int(np.flatnonzero((reference.position != run.points.position[0]).any(axis=1))[0]) - 1
    begin, end = (reference.stamp_ns[row] / 1e9 for row in (still, -1))
    assert end - begin > run.points.times[-1]
    engine = rx.simulate(setup, run.points, duration=end + 1e-3, start_time=begin, record_fast=True).series
    for name, found in zip(names, recorded, strict=True):
        there = np.flatnonzero(found.stamp_ns <= reference.stamp_ns[-1])
        rows = np.searchsorted(engine[name].stamp_ns, found.stamp_ns[there])
        for quantity in ("stamp_ns", "position", "velocity", "effort"):
            expected = getattr(engine[name], quantity)
            assert np.array_equal(expected[rows], getattr(found, quantity)[there]), (name, quantity)


def interrupt_once(bag: Path) -> None:
    wait_until(bag.exists, "the last bag")
    os.kill(os.getpid(), signal.SIGINT)
