"""The work of `rx90_experiment` with a plan: show it, search for excitation runs with a progress bar, and record it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from tqdm import tqdm

from rx90_common.bags.topics import absolute
from rx90_common.bags.writing import string_message, write_joint_states
from rx90_common.base.arrays import Array
from rx90_common.base.config import yaml_text
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import counted, plain
from rx90_common.process.files import write_all
from rx90_controller.trajectory.points import message_content
from rx90_controller.trajectory.spline import interpolate
from rx90_emulator.identification.experiments.arms import PlannedArm
from rx90_emulator.identification.experiments.excitation import ROWS, ExcitationPlan, plan_excitation
from rx90_emulator.identification.experiments.plan import TOPICS, Experiment, write_emulated, write_index
from rx90_emulator.identification.options import ExcitationOptions
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup


def describe(plan: Sequence[Experiment], arm: PlannedArm) -> str:
    """Return a table of the plan: runs, time, and the largest use of the arm's limits in each experiment."""
    lines = [f"{'experiment':<30}{'runs':>6}{'time s':>9}   most of the speed limit   most of the torque limit"]
    names = (*arm.robot.joint_names, *arm.motors)
    for one in plan:
        shares, _ = arm.check(one)
        used = [np.append(shares[name], shares[f"motor_{name}"]) for name in ("speed", "torque")]
        speed, torque = (f"{share.max():>6.0%} ({names[int(np.argmax(share))]})" for share in used)
        lines.append(f"{one.name:<30}{one.sweeps:>6}{one.duration:>9.1f}   {speed}          {torque}")
    runs = counted(sum(one.sweeps for one in plan), "run")
    return "\n".join([*lines, f"{counted(len(plan), 'experiment')}, {runs}, {_whole_time(plan)}"])


def _whole_time(plan: Sequence[Experiment]) -> str:
    total = sum(experiment.duration for experiment in plan)
    return f"{total:.0f} s of motion ({total / 60.0:.1f} min)"


_PER_LINE = 3
_SMALL = 1e-3  # of the largest parameter of its kind: a smaller expected value counts as zero
_LARGEST_SHARE = 100.0  # of the expected value: a larger deviation is given in its unit


def describe_excitation(plan: ExcitationPlan) -> str:
    """Return the table of a plan: use of the limits by each run, and the expected deviations."""
    information = plan.information
    workspace = plan.workspace
    arm = plan.arm
    home = ", ".join(f"{angle:.4g}" for angle in arm.home)
    lines = [
        f"home {home} rad: {arm.chosen_home}",
        f"{'run':<16}{'time s':>7}  {'share of the limits: position, speed, acceleration, torque'}",
    ]
    for experiment in plan.experiments:
        lines += _run_lines(plan, experiment)
    size = np.sqrt(np.diag(information))
    scaled = information / np.outer(size, size)
    condition = np.sqrt(np.linalg.cond(scaled)) if size.all() else np.inf
    noise = "as given" if plan.options.torque_noise else "1 % of the URDF's effort, assumed"
    if arm.coupled:
        lines.append(
            f"{', '.join(arm.motors[number] for number in arm.coupled)}: through their gears; accepted are the speed "
            "of their joint alone (assumed) and the drive's peak torque"
        )
    lines += arm.remarks
    lines += [
        f"condition number {condition:.3g}, log det of the information {np.linalg.slogdet(information)[1]:.4g} "
        f"({len(information)} parameters; without the validation)",
        f"expected deviations at a torque noise ({noise}) of {', '.join(f'{value:.3g}' for value in plan.noise)} Nm in "
        f"{ROWS:g} independent samples per second; in % of the value in the robot's files, else in SI units:",
    ]
    base = plan.base.combination @ plan.standard.values()
    expected = np.abs(np.concatenate([base, *arm.friction]))
    kinds = np.array([name.split(".")[-1][:1] for name in plan.names])
    deviations = np.sqrt(np.diag(np.linalg.pinv(scaled, hermitian=True))) / size
    known = expected > _SMALL * np.array([expected[kinds == kind].max() for kind in kinds])
    known &= deviations < _LARGEST_SHARE * expected  # a kind of which all are 0 but for rounding
    cells = [
        f"{name:<17}{f'{deviation / value:.2%}' if is_known else f'{deviation:.2g}':>10}"
        for name, value, is_known, deviation in zip(plan.names, expected, known, deviations, strict=True)
    ]
    lines += ["  " + "   ".join(cells[first : first + _PER_LINE]) for first in range(0, len(cells), _PER_LINE)]
    if workspace.meshes:
        lines.append(f"meshes do not count for collisions: those of {', '.join(workspace.meshes)}")
    if workspace.uncounted:
        lines.append(f"too near to each other at home to count: {', '.join(workspace.uncounted)}")
    return "\n".join([*lines, f"{counted(len(plan.experiments), 'run')}, {_whole_time(plan.experiments)}"])


def _run_lines(plan: ExcitationPlan, experiment: Experiment) -> Iterator[str]:
    """Yield lines on joints, coupled motors and walls of a run; speeds are those of nine tenths of the moving time."""
    shares, setpoints = plan.arm.check(experiment)

    def speeds(velocity: Array) -> str:
        parts = []
        for sign, moving in (("+", velocity[velocity > 0.0]), ("-", velocity[velocity < 0.0])):
            low, high = np.percentile(np.abs(moving), (5.0, 95.0)) if len(moving) else (0.0, 0.0)
            parts.append(f"{sign}{low:.2g} to {high:.2g}")
        return f"{', '.join(parts)} rad/s"

    head = f"{experiment.name:<16}{experiment.duration:>7.1f}"
    for number, name in enumerate(plan.arm.robot.joint_names):
        cells = "".join(f"{shares[key][number]:>6.0%}" for key in ("position", "speed", "acceleration", "torque"))
        yield f"{head:<23}  {name:<10}{cells}   {speeds(setpoints[:, 1, number])}"
        head = ""
    for number in plan.arm.coupled:
        used = f"{shares['motor_speed'][number]:>12.0%}{shares['motor_torque'][number]:>12.0%}"
        yield f"{'':<25}{plan.arm.motors[number]:<10}{used}   {speeds(setpoints[:, 1] @ plan.arm.turns[number])}"
    for wall, (distance, name) in zip(plan.workspace.walls, plan.workspace.lowest(setpoints[::5, 0]), strict=True):
        yield f"{'':<25}{wall.name}: {name} comes as near as {distance:.3f} m"


def write_motions(folder: Path, plan: Sequence[Experiment], arm: PlannedArm, rate: float) -> None:
    """Write motions for a controller that is not this project's, two files for each, all or none.

    `NAME.yaml` is a trajectory_msgs/JointTrajectory with knots to be joined by quintics. `NAME.csv` contains the
    set-points at an even rate: time, and position, velocity and acceleration of each joint, named as in exported bags.

    Args:
        folder: made if it is not there.
        plan: the motions.
        arm: for the joints' names.
        rate: of the set-points, Hz.
    """
    names = arm.robot.joint_names
    files = dict[Path, bytes]()
    quantities = ("position [rad]", "velocity [rad/s]", "acceleration [rad/s^2]")
    head = ",".join(["time [s]", *(plain(f"{name} {what}") for what in quantities for name in names)])
    for one in plan:
        points = one.points
        assert points.velocity is not None  # a Motion has all three
        curve = interpolate(points.times, points.position, points.velocity, points.acceleration)
        time = np.arange(math.floor(one.duration * rate) + 1) / rate
        rows = zip(time.tolist(), curve.sample(time).reshape(len(time), -1).tolist(), strict=True)
        text = "\n".join([head, *(f"{at:.9f},{','.join(map(repr, row))}" for at, row in rows), ""])
        files[folder / f"{one.name}.csv"] = text.encode()
        files[folder / f"{one.name}.yaml"] = yaml_text(message_content(names, points)).encode()
    with _new_folder(folder):
        write_all(files)


def plan_with_progress(arm: PlannedArm, options: ExcitationOptions) -> ExcitationPlan:
    """Plan excitation runs with a progress line."""
    with tqdm(unit="step", disable=None, delay=1e-9) as bar:  # what is refused before the first step needs none

        def step(name: str) -> None:
            bar.set_description_str(name, refresh=False)
            bar.update()

        return plan_excitation(arm, options, step)


_SETTLING_S = 0.2  # s, after the end


def run_on_engine(setup: Setup, experiment: Experiment, bag: Path, storage: str = "mcap") -> None:
    """Simulate one experiment and write its bag.

    Raises:
        DivergenceError: naming joint and tick.
    """
    topics = TOPICS[experiment.kind]
    result = simulate(
        setup, experiment.points, duration=experiment.duration + _SETTLING_S, record_fast="motor_states" in topics
    )
    series = [one for one in result.series.values() if one.topic in map(absolute, topics)]
    description = string_message("/robot_description", setup.robot.urdf)
    write_joint_states(bag, series, storage=storage, messages=[description])


def record_on_engine(setup: Setup, plan: Sequence[Experiment], folder: Path | str, storage: str = "mcap") -> None:
    """Run experiments in the closed loop without ROS, each into a bag of a new folder.

    Raises:
        Rx90Error: for every refusal and failure; complete bags stay.
    """
    # An interrupt ends the bar's line.
    with _new_folder(Path(folder)) as new, tqdm(plan, desc="engine", unit="experiment", disable=None) as bar:
        for number, experiment in enumerate(bar):
            run_on_engine(setup, experiment, new / experiment.name, storage)
            if not number:
                write_emulated(new, setup.friction)
            write_index(new, plan[: number + 1])


def record_on_nodes(
    setup: Setup, plan: Sequence[Experiment], folder: Path, controller: str = "rx90_controller", timeout: float = 60.0
) -> None:
    """Run experiments on a controller node, each into a bag of a new folder; waits for the nodes for `timeout`, s."""
    with _new_folder(folder):
        from rx90_common.exchange.ros_start import prepare

        prepare()
        from rx90_emulator.identification.experiments.nodes import run_on_nodes

        run_on_nodes(setup, plan, folder, controller, timeout)


@contextmanager
def _new_folder(folder: Path) -> Iterator[Path]:
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise IdentificationError(f"--output {folder}: {error.strerror}; accepted: a folder to be made") from error
    try:
        yield folder
    finally:
        # An empty folder would block the next attempt.
        with suppress(OSError):
            folder.rmdir()
