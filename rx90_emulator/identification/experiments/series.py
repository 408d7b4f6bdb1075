"""What `rx90_experiment` does with a plan: show it, search for excitation runs with a progress bar, and record it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from tqdm import tqdm

from rx90_common.bags.topics import absolute
from rx90_common.bags.writing import string_message, write_joint_states
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.exchange.topics import MOTOR_NAMES
from rx90_emulator.identification.experiments.excitation import ROWS, ExcitationPlan, plan_excitation
from rx90_emulator.identification.experiments.folder import TOPICS, write_emulated, write_index
from rx90_emulator.identification.experiments.limits import COUPLED_MOTORS, TURNS, check_experiment
from rx90_emulator.identification.experiments.options import ExcitationOptions
from rx90_emulator.identification.experiments.plan import Experiment
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup


def describe(plan: Sequence[Experiment], setup: Setup) -> str:
    """Return a table of the plan: runs, time, and how near each experiment comes to the arm's limits.

    Raises:
        IdentificationError: if an experiment leaves a limit.
    """
    lines = [f"{'experiment':<30}{'runs':>6}{'time s':>9}   most of the speed limit   most of the torque limit"]
    names = (*setup.robot.joint_names, *MOTOR_NAMES)
    for experiment in plan:
        shares, _ = check_experiment(experiment, setup)
        speed, torque = (np.append(shares[name], shares[f"motor_{name}"]) for name in ("speed", "torque"))
        fast, strong = int(np.argmax(speed)), int(np.argmax(torque))
        lines.append(
            f"{experiment.name:<30}{experiment.sweeps:>6}{experiment.duration:>9.1f}"
            f"   {speed[fast]:>6.0%} ({names[fast]})          {torque[strong]:>6.0%} ({names[strong]})"
        )
    runs = sum(experiment.sweeps for experiment in plan)
    return "\n".join([*lines, f"{len(plan)} experiments, {runs} runs, {_whole_time(plan)}"])


def _whole_time(plan: Sequence[Experiment]) -> str:
    total = sum(experiment.duration for experiment in plan)
    return f"{total:.0f} s of motion ({total / 60.0:.1f} min)"


def describe_excitation(plan: ExcitationPlan) -> str:
    """Return the table of a plan: what each run uses of the limits, and which deviations are to be expected.

    Raises:
        IdentificationError: if a run leaves a limit.
    """
    search, information = plan.search, plan.search.before
    lines = [f"{'run':<16}{'time s':>7}  {'share of the limits: position, speed, acceleration, torque'}"]
    for experiment in plan.experiments:
        lines += _run_lines(plan, experiment)
    size = np.sqrt(np.diag(information))
    condition = np.sqrt(np.linalg.cond(information / np.outer(size, size))) if size.all() else np.inf
    noise = "as given" if search.options.torque_noise else "1 % of the URDF's effort, assumed"
    lines += [
        f"{', '.join(MOTOR_NAMES[number] for number in COUPLED_MOTORS)}: through their gears; accepted are the speed "
        "of their joint alone (assumed) and the drive's peak torque",
        f"condition number {condition:.3g}, log det of the information {np.linalg.slogdet(information)[1]:.4g} "
        f"({len(information)} parameters; without the validation)",
        f"expected deviations at a torque noise ({noise}) of "
        f"{', '.join(f'{value:.3g}' for value in search.columns.noise)} Nm in {ROWS:g} independent samples per second; "
        "in % of the value in the robot's files, else in SI units:",
        *_parameter_lines(plan),
    ]
    if search.workspace.meshes:
        lines.append(f"meshes do not count for collisions: those of {', '.join(search.workspace.meshes)}")
    if search.workspace.uncounted:
        lines.append(f"too near to each other at home to count: {', '.join(search.workspace.uncounted)}")
    return "\n".join([*lines, f"{len(plan.experiments)} runs, {_whole_time(plan.experiments)}"])


def _run_lines(plan: ExcitationPlan, experiment: Experiment) -> Iterator[str]:
    setup, workspace = plan.search.setup, plan.search.workspace
    shares, setpoints = check_experiment(experiment, setup)
    shown = [shares[name] for name in ("position", "speed", "acceleration", "torque")]
    for number, name in enumerate(setup.robot.joint_names):
        head = f"{experiment.name:<16}{experiment.duration:>7.1f}" if number == 0 else f"{'':<23}"
        cells = "".join(f"{share[number]:>6.0%}" for share in shown)
        yield f"{head}  {name:<10}{cells}   {_speeds(setpoints[:, 1, number])}"
    for number in COUPLED_MOTORS:
        used = f"{shares['motor_speed'][number]:>12.0%}{shares['motor_torque'][number]:>12.0%}"
        yield f"{'':<25}{MOTOR_NAMES[number]:<10}{used}   {_speeds(setpoints[:, 1] @ TURNS[number])}"
    for wall, (distance, name) in zip(workspace.walls, workspace.lowest(setpoints[::5, 0]), strict=True):
        yield f"{'':<25}{wall.name}: {name} comes as near as {distance:.3f} m"


def _speeds(velocity: Array) -> str:
    """Return the speeds of nine tenths of the moving time in each direction."""
    parts = []
    for sign in (1.0, -1.0):
        speed = np.abs(velocity[sign * velocity > 0.0])
        low, high = np.percentile(speed, (5.0, 95.0)) if len(speed) else (0.0, 0.0)
        parts.append(f"{'+' if sign > 0.0 else '-'}{low:.2g} to {high:.2g}")
    return f"{', '.join(parts)} rad/s"


_PER_LINE = 3
_SMALL = 1e-3  # of the largest parameter of its kind: an expected value below it is as good as zero


def _parameter_lines(plan: ExcitationPlan) -> Iterator[str]:
    """Yield the expected deviations, in parts of the values that the robot's files have."""
    columns, information = plan.search.columns, plan.search.before
    elements = plan.search.setup.friction.elements
    base = columns.base.combination @ columns.standard.values()
    coulomb = [0.5 * (one.tau_c_positive + one.tau_c_negative) for one in elements]
    expected = [*base.tolist(), *coulomb, *(one.c2 for one in elements)]
    size = np.sqrt(np.diag(information))
    deviations = np.sqrt(np.diag(np.linalg.pinv(information / np.outer(size, size), hermitian=True))) / size
    kinds = [name.split(".")[-1][:1] for name in columns.names]
    largest = {kind: max(abs(v) for v, k in zip(expected, kinds, strict=True) if k == kind) for kind in kinds}
    cells = []
    for name, kind, value, deviation in zip(columns.names, kinds, expected, deviations, strict=True):
        known = abs(value) > _SMALL * largest[kind]
        cells.append(f"{name:<17}{f'{deviation / abs(value):.2%}' if known else f'{deviation:.2g}':>10}")
    for first in range(0, len(cells), _PER_LINE):
        yield "  " + "   ".join(cells[first : first + _PER_LINE])


_BAR = "{desc:<16}{bar}| {n_fmt}/{total_fmt} steps [{elapsed}<{remaining}]"


def plan_with_progress(setup: Setup, options: ExcitationOptions) -> ExcitationPlan:
    """Plan excitation runs with a progress bar.

    Raises:
        Rx90Error: as `plan_excitation`.
    """
    total = (options.runs + options.validation) * options.steps
    names: list[str] = []
    # The bar comes with the first step: what is refused before needs none.
    with tqdm(total=total, bar_format=_BAR, disable=None, delay=1e-9) as bar:

        def step(name: str) -> None:
            if name not in names:  # the search before may have needed fewer steps
                names.append(name)
                bar.set_description_str(name, refresh=False)
                bar.update((len(names) - 1) * options.steps - bar.n)
            bar.update()

        return plan_excitation(setup, options, step)


_SETTLING_S = 0.2  # s, after the end


def run_on_engine(setup: Setup, experiment: Experiment, bag: Path, storage: str = "mcap") -> None:
    """Simulate one experiment and write its bag.

    Raises:
        BagError: if the bag exists or cannot be written.
        DivergenceError: naming joint and tick.
    """
    topics = TOPICS[experiment.kind]
    result = simulate(
        setup, experiment.points, duration=experiment.duration + _SETTLING_S, record_fast="motor_states" in topics
    )
    wanted = [absolute(topic) for topic in topics]
    series = [one for one in result.series.values() if one.topic in wanted]
    description = string_message("/robot_description", setup.robot.urdf)
    write_joint_states(bag, series, storage=storage, messages=[description])


def record_on_engine(setup: Setup, plan: Sequence[Experiment], folder: Path | str, storage: str = "mcap") -> None:
    """Run experiments in the closed loop without ROS, each into a bag of a new folder.

    Raises:
        Rx90Error: for what cannot be done; complete bags stay.
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
    """Run experiments on a controller node, each into a bag of a new folder; waits for the nodes for `timeout`, s.

    Raises:
        Rx90Error: for what cannot be done; complete bags stay.
    """
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
        # A folder without any bag would refuse the next attempt.
        with suppress(OSError):
            folder.rmdir()
