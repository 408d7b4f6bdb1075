"""The emulated Stäubli RX90B or another robot, its controller and its friction, from Python; no ROS needed.

    import rx90_emulator as rx

    setup = rx.load_setup()                                                 # robot, drives, friction, controller
    stiff = rx.with_parameters(setup, {"friction.joint_2.tau_s": 60.0})     # a copy; SI units
    run = rx.run_line(stiff, rx.load_task())                                # the closed loop along a straight line
    run.path_accuracy.worst                                                 # m
    run.series["joint_states"].position                                     # rad, a row for each stamp
    rx.write_bag(run, "out/stiff")                                          # as if the nodes had been recorded

Setups          load_setup, parameters, with_parameters, Setup, Rates, RobotFiles; their friction: FrictionFile,
                FrictionElement; for other simulators: export_robot, write_export
Motions         load_task, plan_line, load_trajectory, LineTask, TrajectoryPoints; of lines, arcs and splines:
                load_path, plan_path, Path, Segment
Runs            run_line, run_path, simulate, path_accuracy, RunResult; of set-points in a bag: followed_accuracy;
                with a controller of one's own: run_controller; many of them: load_sweep_plan, run_sweep, read_sweep,
                Sweep, SweepPlan; a refusal, in a line with the offending value and what is accepted: Rx90Error; a
                warning of a run that means less than it seems to: Rx90Warning
Corrections     learn_correction, load_correction, write_correction, NormOptimal, TrajectoryPath; from a record:
                Learner, measured, learn_from_record
Series and bags read_bag, read_joint_states, write_bag, write_joint_states, JointSeries; compared:
                compare_bags, compare_series, comparison_text, Scope, Tolerances, Verdict; of a real arm beside the
                model: compare_measured, measured_summary, write_measured, MeasuredLayout
Identification  plan_experiments, record_on_engine, identify_friction, identification_summary, write_identification,
                check_friction, IdentificationBags, RobotOptions; from excitation runs: identify_excitation; for one of
                your own: regressor, excitation_problem, predict_torque, RigidArm

Units are SI throughout. Setups, tasks and results are frozen: with_parameters() and dataclasses.replace() give changed
copies; help() of a result explains its fields. Files are named by a path, or by the name of a shipped file below
config/. The names above are imported when they are first used; docs/tutorials/python.md shows them at work. Everything
else is internal and may change.
"""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path as _File
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rx90_common.bags.comparison import (
        Scope as Scope,
        Verdict as Verdict,
        compare_bags as compare_bags,
        compare_series as compare_series,
    )
    from rx90_common.bags.joint_series import JointSeries as JointSeries
    from rx90_common.bags.reading import (
        read_bag as read_bag,
        read_joint_states as read_joint_states,
    )
    from rx90_common.bags.tables import comparison_text as comparison_text
    from rx90_common.bags.tolerance import Tolerances as Tolerances
    from rx90_common.bags.writing import write_joint_states as write_joint_states
    from rx90_common.base.errors import Rx90Error as Rx90Error, Rx90Warning as Rx90Warning
    from rx90_common.base.rates import Rates as Rates
    from rx90_common.description.robot_files import RobotFiles as RobotFiles
    from rx90_common.friction import FrictionElement as FrictionElement
    from rx90_common.friction.friction_file import FrictionFile as FrictionFile
    from rx90_controller.lines.task import LineTask as LineTask, load_task as load_task
    from rx90_controller.paths.path import Path as Path, Segment as Segment
    from rx90_controller.trajectory import TrajectoryPoints as TrajectoryPoints
    from rx90_emulator.export.export import (
        export_robot as export_robot,
        write_export as write_export,
    )
    from rx90_emulator.correction.file import (
        load_correction as load_correction,
        write_correction as write_correction,
    )
    from rx90_emulator.correction.learning import (
        Learner as Learner,
        learn_correction as learn_correction,
    )
    from rx90_emulator.correction.methods import NormOptimal as NormOptimal
    from rx90_emulator.correction.path import TrajectoryPath as TrajectoryPath
    from rx90_emulator.correction.recorded import (
        learn_from_record as learn_from_record,
        measured as measured,
    )
    from rx90_emulator.identification.arm import RigidArm as RigidArm
    from rx90_emulator.identification.excitation import (
        excitation_problem as excitation_problem,
        identify_excitation as identify_excitation,
        predict_torque as predict_torque,
        regressor as regressor,
    )
    from rx90_emulator.identification.experiments.plan import (
        IdentificationBags as IdentificationBags,
        plan_experiments as plan_experiments,
    )
    from rx90_emulator.identification.experiments.series import record_on_engine as record_on_engine
    from rx90_emulator.identification.identify import (
        check_friction as check_friction,
        identify_friction as identify_friction,
    )
    from rx90_emulator.identification.job import (
        write_identification as write_identification,
    )
    from rx90_emulator.identification.options import (
        MeasuredLayout as MeasuredLayout,
        RobotOptions as RobotOptions,
    )
    from rx90_emulator.identification.output.summary import (
        identification_summary as identification_summary,
    )
    from rx90_emulator.measured_runs.compare import compare_measured as compare_measured
    from rx90_emulator.measured_runs.output import (
        measured_summary as measured_summary,
        write_measured as write_measured,
    )
    from rx90_emulator.loop.closed_loop import simulate as simulate
    from rx90_emulator.loop.line import (
        followed_accuracy as followed_accuracy,
        path_accuracy as path_accuracy,
        plan_line as plan_line,
        plan_path as plan_path,
        run_line as run_line,
        run_path as run_path,
    )
    from rx90_emulator.loop.own_controller import run_controller as run_controller
    from rx90_emulator.loop.parameters import (
        parameters as parameters,
        with_parameters as with_parameters,
    )
    from rx90_emulator.loop.path_file import (
        load_path as load_path,
        load_trajectory as load_trajectory,
    )
    from rx90_emulator.loop.result import (
        RunResult as RunResult,
        write_bag as write_bag,
    )
    from rx90_emulator.loop.setup import Setup as Setup, load_setup as load_setup
    from rx90_emulator.sweep.execution import run_sweep as run_sweep
    from rx90_emulator.sweep.plan import (
        SweepPlan as SweepPlan,
        load_sweep_plan as load_sweep_plan,
    )
    from rx90_emulator.sweep.store import read_sweep as read_sweep
    from rx90_emulator.sweep.sweep import Sweep as Sweep


_HOMES = {
    name: module
    for module, names in re.findall(
        r"^    from (\S+) import (\([^)]*\)|.*)$",
        _File(__file__).read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    for name in re.findall(r"(\w+) as", names)
}
"""The module of each name, by the imports above, which type checkers and editors read."""

if not TYPE_CHECKING:  # so that type checkers know of no other names
    __all__ = list(_HOMES)

    def __getattr__(name: str) -> Any:
        """Import a name of the API when it is first used."""
        if name not in _HOMES:
            raise AttributeError(
                f"module {__name__!r} has no attribute {name!r}; help({__name__}) lists them"
            )
        globals()[name] = found = getattr(import_module(_HOMES[name]), name)
        return found


def __dir__() -> list[str]:
    return sorted({*_HOMES, *(name for name in globals() if name.startswith("__"))})
