"""Corrections are learned as the theory says, are safe, and are refused elsewhere; the linearised arm."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from pinocchio_chain import tip_pose

import rx90_emulator as rx
from benchmarks.any_arm import write_arm
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, Rx90Warning
from rx90_common.rigid_torque import rigid_torque
from rx90_controller.trajectory.correction import Correction
from rx90_emulator.cli.frame import run
from rx90_emulator.correction.file import CorrectionFile
from rx90_emulator.correction.learning import (
    ENGINE,
    CorrectionError,
    LearnedCorrection,
    Learner,
    Measured,
    learn,
    run_corrected,
)
from rx90_emulator.correction.methods import best_change, gains, linearise, response
from rx90_emulator.correction.precompensation import corrected_trajectory, travelled_error
from rx90_emulator.correction.recorded import joints_of_bag, laid_under, learn_from_record, tip_of_file


@pytest.fixture(scope="module")
def task() -> rx.LineTask:
    return replace(rx.load_task(), start=(0.6, -0.05, 0.2), end=(0.6, 0.05, 0.2), rest_before=0.4, rest_after=0.35)


def lifted(a: Array, b: Array, apart: int, count: int) -> Array:
    """Return the matrix from all offsets to all joints, shape (n count, n count), by running the states."""
    n = b.shape[2]
    matrix = np.zeros((n * count, n * count))
    for j in range(count):
        state = b[min(j // apart, len(b) - 1)]
        for k in range(j + 1, count):
            matrix[n * k : n * k + n, n * j : n * j + n] = state[:n]
            state = a[min(k // apart, len(a) - 1)] @ state
    return matrix


@pytest.mark.parametrize("n", [6, 7])
def test_the_recursion_is_the_lifted_solution(n: int) -> None:
    """On a short horizon of a random time-varying system the change is that of the explicit least-squares problem."""
    rng, apart, count, effort = np.random.default_rng(1), 7, 40, 0.7
    a, b = 0.18 * rng.normal(size=(5, 4 * n, 4 * n)), rng.normal(size=(5, 4 * n, n))
    root = rng.normal(size=(5, n, n))
    weight, counted, error = root @ np.swapaxes(root, 1, 2), rng.uniform(0.0, 1.0, count), rng.normal(size=(count, n))
    at = np.minimum(np.arange(count) // apart, 4)
    weighted = counted[:, None] * np.einsum("nij,nj->ni", weight[at], error)
    change = best_change(a, b, apart, *gains(a, b, apart, weight, effort, counted), weighted)
    matrix, wide = lifted(a, b, apart, count), np.zeros((n * count, n * count))
    for k in range(count):
        wide[n * k : n * k + n, n * k : n * k + n] = counted[k] * weight[at[k]]
    expected = np.linalg.solve(matrix.T @ wide @ matrix + effort**2 * np.eye(n * count), matrix.T @ weighted.ravel())
    assert change.ravel() == pytest.approx(expected, abs=1e-10)


def test_the_response_is_that_of_the_servo_loop(shipped: rx.Setup) -> None:
    """An offset that is held moves a stiff joint as kp kv / (s^2 + kv s + kp kv); the integrator brings the rest."""
    still = np.zeros((2000, 3, 6))
    still[:, 0] = rx.plan_line(shipped, rx.load_task()).start_pose
    controller = shipped.controller.replaced(servo={"ki": np.zeros(6)})
    a, b, apart = response(replace(shipped, controller=controller), still)
    state, rows = np.zeros(24), []
    step = np.array([1e-4, 0.0, 0.0, 0.0, 0.0, 0.0])
    for k in range(100):
        rows.append(state[0] / 1e-4)
        state = a[k // apart] @ state + b[k // apart] @ step
    half = np.triu(pin.crba(shipped.robot.model, shipped.robot.model.createData(), still[0, 0]))
    inertia = half + np.triu(half, 1).T + shipped.drives.rotor_matrix
    mass = np.linalg.inv(inertia)[0, 0] * controller.inertia[0]
    kp, kv, t = controller.servo.kp[0], controller.servo.kv[0] * mass, np.arange(100) * 1e-3
    slow, fast = np.roots([1.0, kv, kp * kv]).real[::-1]
    expected = 1.0 + (fast * np.exp(slow * t) - slow * np.exp(fast * t)) / (slow - fast)
    assert rows == pytest.approx(expected, abs=0.06)
    a, b, apart = response(shipped, still)
    state = np.zeros(24)
    for k in range(2000):
        state = a[k // apart] @ state + b[k // apart] @ step
    assert state[:6] == pytest.approx(step, abs=1e-7)


def test_trials_bring_the_true_tip_to_the_path_and_a_corrected_trajectory_less_so(
    shipped: rx.Setup, task: rx.LineTask
) -> None:
    """Three trials leave less than a third of the path error, measured apart; the corrected trajectory far more."""
    plan = rx.plan_line(shipped, task)
    learned = rx.learn_correction(shipped, plan, 3)
    before = rx.run_line(shipped, task).path_accuracy.worst
    after = rx.run_line(shipped, task, correction=learned.correction).path_accuracy.worst
    assert after < before / 3.0
    assert [trial.worst for trial in learned.trials] == sorted((trial.worst for trial in learned.trials), reverse=True)
    points = corrected_trajectory(shipped, plan, learned.correction)
    uncorrected = travelled_error(shipped, plan, plan.points)
    assert learned.best.worst < 0.5 * travelled_error(shipped, plan, points) < 0.5 * uncorrected
    assert np.array_equal(points.position[0], plan.start_pose)
    assert not points.velocity[-1].any()  # type: ignore[index]


def test_encoders_do_not_see_what_gears_do(shipped: rx.Setup, task: rx.LineTask) -> None:
    """With elastic gears the tip's error stays where encoders are learned from, and goes where the tip is."""
    stiffness = np.array([1.5e6, 1.5e6, 5e5, 1e5, 6e4, 2e4])
    gears = shipped.drives.elasticity.replaced(stiffness=stiffness, damping=2e-4 * stiffness)
    arm, plan, left = (
        replace(shipped, drives=shipped.drives.replaced(elasticity=gears)),
        rx.plan_line(shipped, task),
        [],
    )
    for tip in (False, True):
        correction = rx.learn_correction(arm, plan, 3, tip=tip).correction
        measured = run_corrected(arm, plan, correction)[1]
        counts = Learner(shipped, plan).nominal.counts
        nominal = Learner(shipped, plan).nominal.tip
        left.append(plan.distance((nominal - measured.tip)[counts]).max())
    assert left[1] < 0.02e-3
    assert left[0] > 0.05e-3


def test_what_makes_it_worse_is_not_kept_and_divergence_ends_it(shipped: rx.Setup, task: rx.LineTask) -> None:
    """Where each trial measures more error, the first correction stays the best, gains halve, and learning fails."""
    plan = rx.plan_line(shipped, task)
    learner = Learner(shipped, plan)
    error = 1e-4 * np.ones((len(learner.nominal.counts), 6))
    assert learner.take(Measured(error)).kept
    first = learner.offsets
    assert not learner.take(Measured(2.0 * error)).kept
    assert learner.offsets == pytest.approx(0.5 * first, abs=1e-12)
    assert not learner.best.any()
    for factor in (3.0, 4.0):
        learner.take(Measured(factor * error))
    with pytest.raises(CorrectionError, match=r"4 trials in a row .*; accepted: another model"):
        learner.take(Measured(5.0 * error))
    with pytest.raises(ConfigError, match="the tip was not measured"):
        Learner(shipped, plan, tip=True).take(Measured(error))
    # A step beyond the limits of an offset ends it likewise, with what was kept.
    learned = learn(Learner(shipped, plan), lambda _: Measured(200.0 * error), 3, ENGINE)
    assert len(learned.trials) == 1
    assert not learned.correction.offsets.any()
    assert "accepted: up to 0.01 rad" in learned.remark


def test_a_bag_teaches_what_the_engine_does(shipped: rx.Setup, task: rx.LineTask, tmp_path: Path) -> None:
    """Bags of two trials give the engine's errors to the last bit; from joint states alone the begin is found."""
    plan = rx.plan_line(shipped, task)
    learner = Learner(shipped, plan)
    held = 0.6  # so that the arm is held as long as run_corrected does
    for number in range(2):
        run_, measured = run_corrected(shipped, plan, learner.correction)
        bag = tmp_path / f"trial_{number}"
        rx.write_bag(run_, bag)
        joints, played, said = joints_of_bag(bag, shipped, learner.nominal)
        counts = learner.nominal.counts
        assert np.array_equal(joints[counts], measured.joints[counts])
        assert f"begun at {held:.6f} s" in said
        other = Learner(shipped, plan, previous=learner.offsets + 1e-5)  # which was not played
        with pytest.raises(ConfigError, match=r"played are up to 1e-05 rad from those that are learned from"):
            other.take(Measured(joints, played=played))
        learner.take(Measured(joints, played=played))
    series = rx.read_joint_states(tmp_path / "trial_0", "joint_states", shipped.robot.joint_names)
    rx.write_joint_states(tmp_path / "arm", [series])
    joints, unknown, said = joints_of_bag(tmp_path / "arm", shipped, learner.nominal)
    assert unknown is None
    assert abs(float(said.split("begun at ")[1].split(" s")[0]) - held) < 2e-3
    other = replace(task, end=(0.65, 0.05, 0.25))
    with pytest.raises(ConfigError, match="of the motion's range away from the path where they fit best"):
        joints_of_bag(tmp_path / "arm", shipped, Learner(shipped, rx.plan_line(shipped, other)).nominal)


def test_an_arm_goes_on_where_the_engine_has_ended(shipped: rx.Setup, task: rx.LineTask, tmp_path: Path) -> None:
    """An arm's first trial is worse than the engine's, and taught from; worse ones halve the step, the 4th fails."""
    plan = rx.plan_line(shipped, task)
    earlier = kept(rx.learn_correction(shipped, plan, 1), None, tmp_path / "engine.yaml")
    engine, error = earlier.head.worst[-1], run_corrected(shipped, plan, earlier.correction)[1].joints
    record = "encoders, record"

    def trial(factor: float, before: CorrectionFile) -> tuple[LearnedCorrection, str]:
        learner = Learner(shipped, plan, previous=before.correction.offsets)
        return learn_from_record(learner, Measured(factor * error), before)

    learned, why = trial(5.0, earlier)
    assert not why
    first = kept(learned, earlier, tmp_path / "0.yaml")
    assert first.head.worst == pytest.approx([*earlier.head.worst, 5.0 * engine], rel=0.02)
    assert first.head.seen == ("encoders, engine",) * 2 + (record,)
    file, step = first, first.correction.offsets - earlier.correction.offsets
    for number, factor in enumerate((9.0, 8.0, 7.0)):
        learned, why = trial(factor, file)
        assert why == f"worse than {first.head.worst[-1] * 1e3:.4f} mm before"
        file, step = kept(learned, file, tmp_path / f"{number + 1}.yaml"), 0.5 * step
        assert file.correction.offsets == pytest.approx(earlier.correction.offsets + step, abs=1e-12)
        assert np.array_equal(file.best, earlier.correction.offsets)
    with pytest.raises(CorrectionError, match="4 trials in a row have made the path worse"):
        trial(6.0, file)
    learned, why = trial(1.0, file)
    assert not why
    assert np.array_equal(learned.best_offsets, file.correction.offsets)


def kept(learned: LearnedCorrection, earlier: CorrectionFile | None, file: Path) -> CorrectionFile:
    rx.write_correction(learned, file, earlier)
    return rx.load_correction(file)


def test_errors_do_not_creep(shipped: rx.Setup, task: rx.LineTask) -> None:
    """Trials that are each worse by less than the noise are not kept once they are worse than the best one by more."""
    learner = Learner(shipped, rx.plan_line(shipped, task), noise=1e-6)
    error = np.zeros((len(learner.nominal.counts), 6))
    error[:, 1] = 1e-4
    worst = float(learner.distance(Measured(error)).max())
    kept = [learner.take(Measured((1.0 + k * 0.6e-6 / worst) * error)).kept for k in range(4)]
    assert kept == [True, True, False, False]


def test_an_arm_of_seven_joints_learns(tmp_path: Path) -> None:
    """From encoders and from the tip, three trials leave a third, without any coupling of motors."""
    arm = rx.load_setup(robot=write_arm(tmp_path / "arm", 7))
    first, last = np.array([[0.1, 0.4, 0.5, 0.1, 0.6, 0.1, 0.2], [0.4, 0.2, 0.7, 0.2, 0.4, 0.2, 0.4]])
    rest = np.zeros((4, 7))
    points = rx.TrajectoryPoints(np.array([0.0, 0.4, 1.6, 2.0]), np.stack([first, first, last, last]), rest, rest)
    path = rx.TrajectoryPath.of(arm, points, (0.4, 1.9))
    for tip in (False, True):
        trials = rx.learn_correction(arm, path, 3, tip=tip).trials
        assert trials[3].worst < trials[0].worst / 3.0


def test_a_tip_is_laid_under_the_path(shipped: rx.Setup, task: rx.LineTask, tmp_path: Path) -> None:
    """A tip in mm on a clock of its own, at another rate, is found to microseconds; half a path is refused."""
    plan = rx.plan_line(shipped, task)
    nominal = Learner(shipped, plan).nominal
    times = np.arange(-0.1, plan.duration + 0.1, 0.0017)
    inside = np.clip(times, 0.0, plan.duration)
    rows = np.column_stack([times + 41.2345, plan.tip(inside) * 1e3 + [0.0, 0.0, 0.05]])
    file = tmp_path / "tip.csv"
    np.savetxt(file, rows, delimiter=",", header="time [s],x [mm],y [mm],z [mm]", comments="", fmt="%.7f")
    error, said = tip_of_file(file, nominal)
    assert float(said.split("begun at ")[1].split(" s")[0]) == pytest.approx(41.2345, abs=2e-5)
    assert error[nominal.counts] == pytest.approx(np.tile([0.0, 0.0, -5e-5], (nominal.counts.sum(), 1)), abs=5e-6)
    half = rows[: len(rows) // 2]
    with pytest.raises(ConfigError, match="accepted: a record of all of the path"):
        laid_under(half[:, 0], half[:, 1:] / 1e3, nominal.tip, nominal, "half")
    torn = np.delete(rows, slice(len(rows) // 2, len(rows) // 2 + 30), axis=0)
    with pytest.raises(
        ConfigError, match=r"nothing for 0\.0527 s from 4.* s on, within the path; accepted: a record wit"
    ):
        laid_under(torn[:, 0], torn[:, 1:] / 1e3, nominal.tip, nominal, "torn")


def test_any_trajectory_is_a_path(shipped: rx.Setup, task: rx.LineTask) -> None:
    """The distance from the path of a line's trajectory is that from the line, beside it and past its end."""
    plan = rx.plan_line(shipped, task)
    path = rx.TrajectoryPath.of(shipped, plan.points, plan.counted)
    rng = np.random.default_rng(2)
    tip = plan.tip(np.linspace(*plan.counted, 50)) + 1e-4 * rng.normal(size=(50, 3))
    assert path.distance(tip) == pytest.approx(plan.distance(tip), abs=2e-9)


def test_a_closed_path_is_measured_around_where_the_tip_should_be(shipped: rx.Setup) -> None:
    """A tip 50 µm above a triangle that ends where it began is that far from it, near its ends, too."""
    corners = ((0.65, 0.0, 0.2), (0.57, 0.05, 0.2), (0.6, 0.0, 0.2))
    plan = rx.plan_path(shipped, rx.Path(corners[-1], tuple(rx.Segment((corner,)) for corner in corners)))
    for path in (plan, rx.TrajectoryPath.of(shipped, plan.points, plan.counted)):
        learner = Learner(shipped, path, tip=True)
        off = np.broadcast_to([0.0, 0.0, -5e-5], learner.nominal.tip.shape)
        assert learner.distance(Measured(np.zeros_like(learner.offsets), off)) == pytest.approx(5e-5, rel=1e-3)


def test_a_correction_is_played_on_the_motion_that_it_was_learned_on(
    shipped: rx.Setup, task: rx.LineTask, tmp_path: Path
) -> None:
    """At another speed, on another path, robot and trajectory it is refused, whether it was learned here or read."""
    learned = rx.learn_correction(shipped, task, 1)
    rx.write_correction(learned, tmp_path / "line.yaml")
    arm = replace(shipped, robot=replace(shipped.robot, urdf=shipped.robot.urdf.replace('"rx90b"', '"rx90c"')))
    for correction in (learned.correction, rx.load_correction(tmp_path / "line.yaml").correction):
        run = rx.run_line(shipped, task, correction=correction)
        assert run.path_accuracy.worst == pytest.approx(learned.best.worst, abs=2e-6)
        path = r"the correction was learned on a path .* at 100 mm/s .*, this is a path .* at {} mm/s .*; accepted: the"
        for other, speed in ((replace(task, speed=0.15), 150), (replace(task, end=(0.61, 0.05, 0.2)), 100)):
            with pytest.raises(ConfigError, match=path.format(speed)):
                rx.run_line(shipped, other, correction=correction)
        with pytest.raises(ConfigError, match="the correction was learned on the robot 'rx90b', this one is 'rx90c'"):
            rx.run_line(arm, task, correction=correction)
        points = rx.plan_line(shipped, replace(task, speed=0.15)).points
        with pytest.raises(ConfigError, match="the correction was learned on a path"):
            rx.simulate(shipped, points, correction=correction)
        with pytest.raises(ConfigError, match="the correction was learned on a path"):
            rx.learn_correction(shipped, replace(task, speed=0.15), 1, previous=correction)


def test_a_file_says_where_it_belongs(shipped: rx.Setup, task: rx.LineTask, tmp_path: Path) -> None:
    """It comes back to the bit; other offsets and another period are refused, another payload is warned of."""
    learned, file = rx.learn_correction(shipped, task, 1), tmp_path / "line.yaml"
    rx.write_correction(learned, file)
    found = rx.load_correction(file)
    plan = rx.plan_line(shipped, task)
    assert np.array_equal(found.fitting(shipped, plan).offsets, learned.correction.offsets)
    assert found.head.worst == tuple(trial.worst for trial in learned.trials)
    with pytest.warns(Rx90Warning, match=r"learned with 3\.7 kg on the last joint, there are 5 kg"):
        found.fitting(rx.with_parameters(shipped, {"arm.link_6.mass": 5.0}), plan)
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("period: 0.001", "period: 0.002"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"has offsets every 0\.002 s, the controller a set-point every 0\.001 s"):
        rx.load_correction(file).fitting(shipped, plan)
    file.write_text(text, encoding="utf-8")
    beside = file.with_suffix(".npz")
    offsets = learned.correction.offsets
    for arrays, why in (
        ({"offsets": offsets}, "best is not a file in the archive"),
        ({"offsets": offsets, "best": offsets[1:]}, "offsets of shape .*; accepted: the files written together"),
        ({"offsets": offsets + 0.02, "best": offsets}, r"the offset .*accepted: up to 0\.01 rad"),
    ):
        np.savez(beside, **arrays)
        with pytest.raises(ConfigError, match=why):
            rx.load_correction(file)
    beside.unlink()
    with pytest.raises(ConfigError, match=r"line\.npz: .*No such file.*; accepted: the file written with"):
        rx.load_correction(file)


def test_the_command_learns_and_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`rx90 correct` learns, writes what can be played, and refuses what does not go together with 2 and a line."""
    output = tmp_path / "line.yaml"
    words = ["engine", "robots/rx90b/task.yaml", "--trials", "1", "--output", str(output)]
    assert run("rx90 correct", words) == 0
    assert "trial 1: worst 0.02" in capsys.readouterr().out
    to = ["--output", str(tmp_path / "corrected.yaml")]
    assert run("rx90 correct", ["precompensate", str(output), "robots/rx90b/task.yaml", *to]) == 0
    assert "worst path error on the engine: 0.0" in capsys.readouterr().out
    assert len(rx.load_trajectory(tmp_path / "corrected.yaml", [f"joint_{k}" for k in range(1, 7)]).times) == 2801
    tables = []
    for name, more in (("asked", []), ("played", ["--correction", str(output)])):
        table = tmp_path / f"{name}.csv"
        words_of_line = ["robots/rx90b/task.yaml", "--dry-run", "--output", str(table), *more]
        assert run("rx90 line", words_of_line) == 0
        tables.append(np.loadtxt(table, delimiter=",", skiprows=1))
    asked, played = tables
    with np.load(tmp_path / "line.npz") as file:
        offsets = np.degrees(file["offsets"])
    middle = slice(100, len(asked) - 1)  # faded in, and not yet out
    assert np.abs(offsets[middle]).max() > 1e-3
    np.testing.assert_allclose(played[middle, 1:7] - asked[middle, 1:7], offsets[middle], atol=1.1e-6)
    np.testing.assert_allclose(played[-1, 1:], asked[-1, 1:], atol=1e-6)
    np.testing.assert_allclose(np.diff(played[:, 0]), 1e-3, atol=1e-9)
    robot = rx.load_setup().robot
    for row in played[200::900]:
        np.testing.assert_allclose(row[7:10], 1e3 * tip_pose(robot, np.radians(row[1:7]))[:3, 3], atol=1e-4)
    message = ["--output", str(tmp_path / "message.yaml"), *more]
    assert run("rx90 line", [*words_of_line[:2], *message]) == 0
    assert "message.yaml, without the correction; set-points with it: FILE.csv" in capsys.readouterr().out
    assert run("rx90 line", [*words_of_line, "--rate", "500"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    mine = tmp_path / "mine.npz"
    mine.write_bytes(b"mine")
    assert run("rx90 correct", [*words[:-1], str(tmp_path / "mine.yaml")]) == 2
    assert mine.read_bytes() == b"mine"
    assert "mine.npz exists" in capsys.readouterr().err


def test_offsets_beyond_the_limits_are_refused() -> None:
    """The largest offset and the fastest change have limits, named with the value, the joint and the time."""
    offsets = np.zeros((10, 6))
    offsets[4, 2] = 0.02
    with pytest.raises(rx.Rx90Error, match=r"offset 0\.02 rad in joint 3 at 0\.004 s; accepted: up to 0\.01 rad"):
        Correction(offsets, 1e-3)
    with pytest.raises(rx.Rx90Error, match=r"change 2 rad/s in joint 3 at 0\.004 s; accepted: up to 0\.5 rad/s"):
        Correction(0.1 * offsets, 1e-3)


def inverse_dynamics(setup: rx.Setup, q: Array, v: Array, a: Array) -> Array:
    drives = setup.drives
    return rigid_torque(setup.robot.model, drives.rotor_matrix, drives.spring_torque, q[None], v[None], a[None])[0]


def slopes(setup: rx.Setup, state: Array, which: int, step: float = 1e-5) -> Array:
    columns = []
    for joint in range(6):
        move = np.zeros((3, 6))
        move[which, joint] = step
        difference = inverse_dynamics(setup, *(state + move)) - inverse_dynamics(setup, *(state - move))
        columns.append(difference / (2.0 * step))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("seed", range(5))
def test_derivatives_equal_differences_of_the_inverse_dynamics(shipped: rx.Setup, seed: int) -> None:
    """M0, C0 and K0 are the slopes of the torque, rotors, wrist coupling, gravity and spring included."""
    rng = np.random.default_rng(seed)
    state = np.stack([rng.uniform(-2.0, 2.0, 6), rng.uniform(-3.0, 3.0, 6), rng.uniform(-20.0, 20.0, 6)])
    linear = linearise(shipped, state[None])
    for ours, which in ((linear.stiffness, 0), (linear.damping, 1), (linear.mass, 2)):
        expected = slopes(shipped, state, which)
        np.testing.assert_allclose(ours[0], expected, rtol=0, atol=1e-6 * np.abs(expected).max())
