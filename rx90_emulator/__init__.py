"""The emulated Stäubli RX90B or another robot, its controller and its friction, from Python; no ROS needed.

    import rx90_emulator as rx

    setup = rx.load_setup()                                                 # robot, drives, friction, controller
    stiff = rx.with_parameters(setup, {"friction.joint_2.tau_s": 60.0})     # a copy; SI units
    run = rx.run_line(stiff, rx.load_task())                                # the closed loop along a straight line
    run.path_accuracy.worst                                                 # m
    run.series["joint_states"].position                                     # rad, a row for each stamp
    rx.write_bag(run, "out/stiff")                                          # as if the nodes had been recorded

Setups          load_setup, parameters, with_parameters, Setup, Rates
Motions         load_task, plan_line, load_trajectory, LineTask, LinePlan, TrajectoryPoints
Runs            run_line, simulate, path_accuracy, LineRun, RunResult, PathAccuracy; for hours: repeat_line,
                RepeatedLine; small deviations from a motion: prepare_perturbation, PerturbationModel,
                PerturbationResult
Series and bags read_bag, read_joint_states, write_bag, write_joint_states, save_arrays, JointSeries
Comparison      compare_bags, compare_series, comparison_text, BagComparison, TopicComparison, Scope, Tolerances,
                Verdict
Measured runs   compare_measured, measured_summary, write_measured, MeasuredComparison, MeasuredLayout,
                MeasuredTolerances
Friction        FrictionFile, FrictionSet, FrictionElement, and its parts LoadPart, TemperaturePart, RipplePart,
                ScatterPart, ElastoPlastic, MaxwellSlip
Sweeps          load_sweep_plan, run_sweep, read_sweep, Sweep, SweepPlan, SweepBase, RobotFiles, Block,
                SweptParameter, Values, Uniform, LogUniform, Normal
Identification  plan_experiments, record_on_engine, identify_friction, identification_summary, write_identification,
                check_friction, Experiment, FrictionIdentification, IdentificationBags, RobotOptions, Validation,
                ValidationTolerances; from excitation runs: identify_excitation, excitation_summary,
                write_excitation, read_payloads, ExcitationIdentification, ExcitationTolerances, Payload
Errors          Rx90Error, of which every refusal is one: a line with the offending value and what is accepted;
                Rx90Warning, of a run that means less than it seems to

Units are SI throughout. Setups, tasks and results are frozen: with_parameters() and dataclasses.replace() give changed
copies. Files are named by a path, or by the name of a shipped file below config/. The names above are imported when
they are first used; docs/tutorials/python.md shows them at work. Everything else is internal and may change.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rx90_common.bags.comparison import (
        BagComparison,
        Scope,
        TopicComparison,
        Verdict,
        compare_bags,
        compare_series,
    )
    from rx90_common.bags.joint_series import JointSeries
    from rx90_common.bags.reading import read_bag, read_joint_states
    from rx90_common.bags.tables import comparison_text
    from rx90_common.bags.tolerance import Tolerances
    from rx90_common.bags.writing import write_joint_states
    from rx90_common.base.errors import Rx90Error, Rx90Warning
    from rx90_common.base.rates import Rates
    from rx90_common.description.robot_files import RobotFiles
    from rx90_common.friction import FrictionElement, FrictionSet
    from rx90_common.friction.friction_file import FrictionFile
    from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip
    from rx90_common.friction.parts.load import LoadPart
    from rx90_common.friction.parts.ripple import RipplePart
    from rx90_common.friction.parts.scatter import ScatterPart
    from rx90_common.friction.parts.temperature import TemperaturePart
    from rx90_controller.lines.plan import LinePlan
    from rx90_controller.lines.task import LineTask, load_task
    from rx90_controller.trajectory import TrajectoryPoints
    from rx90_emulator.identification.excitation.identify import identify_excitation
    from rx90_emulator.identification.excitation.payload import Payload, read_payloads
    from rx90_emulator.identification.excitation.result import ExcitationIdentification
    from rx90_emulator.identification.experiments.folder import IdentificationBags
    from rx90_emulator.identification.experiments.plan import Experiment, plan_experiments
    from rx90_emulator.identification.experiments.series import record_on_engine
    from rx90_emulator.identification.identify import FrictionIdentification, check_friction, identify_friction
    from rx90_emulator.identification.job import write_excitation, write_identification, write_measured
    from rx90_emulator.identification.options import (
        ExcitationTolerances,
        MeasuredLayout,
        MeasuredTolerances,
        RobotOptions,
        ValidationTolerances,
    )
    from rx90_emulator.identification.output.summary import (
        excitation_summary,
        identification_summary,
        measured_summary,
    )
    from rx90_emulator.identification.validation.measured import MeasuredComparison, compare_measured
    from rx90_emulator.identification.validation.prediction import Validation
    from rx90_emulator.loop.closed_loop import simulate
    from rx90_emulator.loop.line import LineRun, PathAccuracy, path_accuracy, plan_line, run_line
    from rx90_emulator.loop.parameters import parameters, with_parameters
    from rx90_emulator.loop.result import RunResult, save_arrays, write_bag
    from rx90_emulator.loop.setup import Setup, load_setup
    from rx90_emulator.loop.trajectory_file import load_trajectory
    from rx90_emulator.loop.working_day import RepeatedLine, repeat_line
    from rx90_emulator.perturbation.model import PerturbationModel, PerturbationResult, prepare_perturbation
    from rx90_emulator.sweep.execution import read_sweep, run_sweep
    from rx90_emulator.sweep.plan import (
        Block,
        LogUniform,
        Normal,
        SweepBase,
        SweepPlan,
        SweptParameter,
        Uniform,
        Values,
    )
    from rx90_emulator.sweep.plan_file import load_sweep_plan
    from rx90_emulator.sweep.sweep import Sweep

__all__ = [
    "BagComparison",
    "Block",
    "ElastoPlastic",
    "ExcitationIdentification",
    "ExcitationTolerances",
    "Experiment",
    "FrictionElement",
    "FrictionFile",
    "FrictionIdentification",
    "FrictionSet",
    "IdentificationBags",
    "JointSeries",
    "LinePlan",
    "LineRun",
    "LineTask",
    "LoadPart",
    "LogUniform",
    "MaxwellSlip",
    "MeasuredComparison",
    "MeasuredLayout",
    "MeasuredTolerances",
    "Normal",
    "PathAccuracy",
    "Payload",
    "PerturbationModel",
    "PerturbationResult",
    "Rates",
    "RepeatedLine",
    "RipplePart",
    "RobotFiles",
    "RobotOptions",
    "RunResult",
    "Rx90Error",
    "Rx90Warning",
    "ScatterPart",
    "Scope",
    "Setup",
    "Sweep",
    "SweepBase",
    "SweepPlan",
    "SweptParameter",
    "TemperaturePart",
    "Tolerances",
    "TopicComparison",
    "TrajectoryPoints",
    "Uniform",
    "Validation",
    "ValidationTolerances",
    "Values",
    "Verdict",
    "check_friction",
    "compare_bags",
    "compare_measured",
    "compare_series",
    "comparison_text",
    "excitation_summary",
    "identification_summary",
    "identify_excitation",
    "identify_friction",
    "load_setup",
    "load_sweep_plan",
    "load_task",
    "load_trajectory",
    "measured_summary",
    "parameters",
    "path_accuracy",
    "plan_experiments",
    "plan_line",
    "prepare_perturbation",
    "read_bag",
    "read_joint_states",
    "read_payloads",
    "read_sweep",
    "record_on_engine",
    "repeat_line",
    "run_line",
    "run_sweep",
    "save_arrays",
    "simulate",
    "with_parameters",
    "write_bag",
    "write_excitation",
    "write_identification",
    "write_joint_states",
    "write_measured",
]

_HOMES = {
    "rx90_common.bags.comparison": "BagComparison Scope TopicComparison Verdict compare_bags compare_series",
    "rx90_common.bags.joint_series": "JointSeries",
    "rx90_common.bags.reading": "read_bag read_joint_states",
    "rx90_common.bags.tables": "comparison_text",
    "rx90_common.bags.tolerance": "Tolerances",
    "rx90_common.bags.writing": "write_joint_states",
    "rx90_common.base.errors": "Rx90Error Rx90Warning",
    "rx90_common.base.rates": "Rates",
    "rx90_common.description.robot_files": "RobotFiles",
    "rx90_common.friction": "FrictionSet FrictionElement",
    "rx90_common.friction.friction_file": "FrictionFile",
    "rx90_common.friction.parts.bristles": "ElastoPlastic MaxwellSlip",
    "rx90_common.friction.parts.load": "LoadPart",
    "rx90_common.friction.parts.ripple": "RipplePart",
    "rx90_common.friction.parts.scatter": "ScatterPart",
    "rx90_common.friction.parts.temperature": "TemperaturePart",
    "rx90_controller.lines.plan": "LinePlan",
    "rx90_controller.lines.task": "LineTask load_task",
    "rx90_controller.trajectory": "TrajectoryPoints",
    "rx90_emulator.identification.excitation.identify": "identify_excitation",
    "rx90_emulator.identification.excitation.payload": "Payload read_payloads",
    "rx90_emulator.identification.excitation.result": "ExcitationIdentification",
    "rx90_emulator.identification.experiments.folder": "IdentificationBags",
    "rx90_emulator.identification.experiments.plan": "Experiment plan_experiments",
    "rx90_emulator.identification.experiments.series": "record_on_engine",
    "rx90_emulator.identification.identify": "check_friction identify_friction FrictionIdentification",
    "rx90_emulator.identification.job": "write_excitation write_identification write_measured",
    "rx90_emulator.identification.options": (
        "ExcitationTolerances MeasuredLayout MeasuredTolerances RobotOptions ValidationTolerances"
    ),
    "rx90_emulator.identification.output.summary": "excitation_summary identification_summary measured_summary",
    "rx90_emulator.identification.validation.measured": "compare_measured MeasuredComparison",
    "rx90_emulator.identification.validation.prediction": "Validation",
    "rx90_emulator.loop.parameters": "parameters with_parameters",
    "rx90_emulator.loop.closed_loop": "simulate",
    "rx90_emulator.loop.line": "LineRun PathAccuracy path_accuracy plan_line run_line",
    "rx90_emulator.loop.result": "RunResult save_arrays write_bag",
    "rx90_emulator.loop.setup": "Setup load_setup",
    "rx90_emulator.loop.trajectory_file": "load_trajectory",
    "rx90_emulator.loop.working_day": "RepeatedLine repeat_line",
    "rx90_emulator.perturbation.model": "prepare_perturbation PerturbationModel PerturbationResult",
    "rx90_emulator.sweep.execution": "read_sweep run_sweep",
    "rx90_emulator.sweep.plan": "Block LogUniform Normal SweepBase SweepPlan SweptParameter Uniform Values",
    "rx90_emulator.sweep.plan_file": "load_sweep_plan",
    "rx90_emulator.sweep.sweep": "Sweep",
}
"""The modules that the names come from, as in the imports above, which type checkers and editors read."""

if not TYPE_CHECKING:  # so that type checkers know of no other names

    def __getattr__(name: str) -> Any:
        """Import a name of the API when it is first used."""
        home = next((module for module, names in _HOMES.items() if name in names.split()), None)
        if home is None:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}; help({__name__}) lists them")
        globals()[name] = found = getattr(import_module(home), name)
        return found


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
