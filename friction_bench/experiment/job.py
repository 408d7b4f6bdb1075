"""The run of `friction_ramp`, apart from its options: they are checked first, as the import takes two seconds."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from friction_bench.experiment.evaluation import evaluate
from friction_bench.experiment.ramp import Guard, run_ramp
from friction_bench.experiment.record import INSTANTANEOUS, RampRecord, read_csv, read_text, write_csv
from friction_bench.experiment.report import result_text, write_estimates, write_html, write_yaml
from friction_bench.experiment.session import (
    EMULATED,
    Session,
    check_port,
    check_ranges,
    measuring,
    new_measurement,
    origin_of,
)
from friction_bench.experiment.sliding_fit import fit_sliding
from friction_bench.experiment.window import SlidingWindow, sliding_window
from friction_bench.rig.rig_file import RampPlan, Rig, load_rig
from rx90_common.base.errors import (
    DONE,
    VERDICT_NO,
    ConfigError,
    IdentificationError,
)
from rx90_common.base.quoting import one_line, quoted
from rx90_common.base.share import resolve_config
from rx90_common.description.robot_files import RobotFiles
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.friction_set import refuse_parts

_LOADS = {"none": (False,), "joint": (True,), "both": (False, True)}
LEAST_SLIDING = 1.5
"""Shortest time for which the shaft slides in the fastest ramp, s."""
LEAST_CONSTANTS = 8.0
"""The same in time constants; the longer of the two counts."""
LONGEST_CONSTANT = 0.5
"""The time constant, s, that is taken if the first ramp shows a longer one: a single ramp tells it poorly."""
LEAST_RATIO = 1.8
"""Smallest ratio of fastest to slowest slope."""
RATIO = 2.5
"""The ratio where the slopes are chosen here."""
READINGS = 300
"""Fewest readings of a sliding shaft at the fastest slope, all repeats together."""
MOST_REPEATS = 20


def plan_from(first: RampRecord, plan: RampPlan, rig: Rig) -> RampPlan:
    """Return the plan, with other slopes and more repeats where the first ramp shows that its own do not do.

    Args:
        first: a ramp of the plan's slowest slope.
        plan: slopes and end torques to begin with; the end torques are kept.
        rig: for the limits of travel and speed.

    Raises:
        IdentificationError: if the first ramp cannot be used, for then the others cannot either.
    """
    window = sliding_window(first)
    coulomb, viscous, constant = _roughly(window)
    limits = Guard.of(rig)
    top = limits.speed * first.angle_step / rig.tick
    rise = min(plan.end(first.loaded) - coulomb, viscous * top)
    if rise <= 0.0:
        return plan
    sliding = max(LEAST_SLIDING, LEAST_CONSTANTS * min(constant, LONGEST_CONSTANT))
    fastest = rise / sliding
    slowest = rise**2 / (2.0 * viscous * limits.travel * first.angle_step)  # slower ones turn the shaft too far
    slopes = plan.slopes
    kept = max(slopes) <= fastest and min(slopes) >= slowest and max(slopes) >= LEAST_RATIO * min(slopes)
    if not kept:
        high = min(max(fastest, RATIO * slowest), max(slopes))
        low = max(high / RATIO, rig.slope_of_step(1))
        slopes = (_rounded(low), _rounded(high))
    readings = rise / max(slopes) / rig.tick
    repeats = min(max(plan.repeats, math.ceil(READINGS / readings)), MOST_REPEATS)
    return replace(plan, slopes=slopes, repeats=repeats)


def _roughly(window: SlidingWindow) -> tuple[float, float, float]:
    """Return f_c, Nm, f_v, Nm s/rad, and a time constant, s, that is hardly exceeded, by one ramp."""
    fit = fit_sliding([window])
    coulomb, viscous, inertia = (float(value) for value in fit.values)
    if not (viscous > 0.0 and inertia > 0.0):
        raise IdentificationError(
            f"{window.record.label}: the shaft does not slide as a ramp torque lets it, the viscous friction would be "
            f"{viscous:.3g} Nm s/rad; saturation, or the joint runs against a stop"
        )
    spread = math.sqrt(max(float(fit.covariance[2, 2]), 0.0))
    return coulomb, viscous, (inertia + 2.0 * spread) / viscous


def _rounded(slope: float) -> float:
    return float(f"{slope:.3g}")


Run = Callable[[float, str], RampRecord]
"""Runs one ramp of a slope, Nm/s, with a label."""


def run_planned(run: Run, plan: RampPlan, loaded: bool, choose: Callable[[RampRecord], RampPlan]) -> RampPlan:
    """Run all ramps under one load: the first of the slowest slope, then those of the plan that is chosen by it.

    Args:
        run: one ramp.
        plan: for the first ramp.
        loaded: for the labels.
        choose: the plan for the rest, from the first ramp; the first ramp counts where it has one of its slopes.

    Raises:
        IdentificationError: of `choose`; RigError: of `run`.
    """
    load = "loaded" if loaded else "no-load"
    slowest = min(plan.slopes)
    first = run(slowest, f"{load} {slowest:g} Nm/s #1")
    chosen = choose(first)
    for repeat in range(chosen.repeats):
        for slope in sorted(chosen.slopes):
            if (repeat, slope) != (0, slowest):
                run(slope, f"{load} {slope:g} Nm/s #{repeat + 1}")
    return chosen


def run(options: argparse.Namespace) -> int:
    """Measure or read ramps, identify friction, and write the report.

    Returns:
        The exit code: 1 where a load that was asked for carries no estimate.

    Raises:
        Rx90Error: for what is refused; what has been measured until then stands in the folder.
    """
    rig = load_rig(resolve_config(options.rig))
    out: Path = options.output
    base = FrictionFile.read(RobotFiles.of_options(options).friction)
    _check(options, base)
    if options.no_load_file or options.loaded_file:
        records = _read(options, rig)
        new_measurement(out)
        origin = f"{len(records)} recorded ramps"
    else:
        plan = _plan(options, rig)
        records, origin = _measure(options, rig, plan, out)
    result = evaluate(records, rig)
    write_html(out / "report.html", result, rig, origin)
    write_estimates(out / "estimates.yaml", result)
    print(result_text(result))
    print(one_line(f"report: {out / 'report.html'}"))
    if result.failures:
        print("parameters for rx90_sim: not written, as a load carries no estimate", file=sys.stderr)
        return VERDICT_NO
    write_yaml(out / "friction.yaml", result, options.element, base)
    print(one_line(f"parameters for rx90_sim: {out / 'friction.yaml'}"))
    return DONE


def _check(options: argparse.Namespace, base: FrictionFile) -> None:
    """Refuse now what would otherwise be noticed after minutes of ramps."""
    if options.element not in base.elements:
        known = ", ".join(base.elements)
        raise ConfigError(f"--element is {quoted(options.element)}; accepted: {known}")
    replaced = {options.element: base.elements[options.element]}
    refuse_parts(replaced, "the element that a ramp test replaces", f"{base.path}: elements.")
    check_ranges(options, (("seed", 0, 2**31 - 1), ("repeats", 1, 1000), ("baud", 1200, 1_000_000)))
    check_port(options)
    if options.no_load_file or options.loaded_file:
        _check_of_files(options)
    elif options.text:
        raise ConfigError("--text is given without a file; accepted: with --no-load-file or --loaded-file")
    if options.velocity and options.text != "velocity":
        raise ConfigError(f"--velocity is {options.velocity}; accepted: with --text velocity alone")


def _check_of_files(options: argparse.Namespace) -> None:
    """Refuse options of a measurement with old data, of which nothing is measured."""
    usual = {"port": EMULATED, "load": "both"}
    for name in ("port", "slopes", "repeats", "end_torque", "load", "clear", "seed", "real_time"):
        value = getattr(options, name)
        if value is not None and value is not False and value != usual.get(name):
            raise ConfigError(f"--{name.replace('_', '-')} with old data; accepted: with a rig")


def _plan(options: argparse.Namespace, rig: Rig) -> RampPlan:
    slopes = tuple(options.slopes or rig.ramps.slopes)
    torque = options.end_torque
    if torque is not None and not 0.0 < torque <= rig.dac_full_scale:
        raise ConfigError(f"--end-torque is {torque:g}; accepted: (0, {rig.dac_full_scale:g}] Nm")
    for slope in slopes:
        rig.ramp_step(slope)
        if slopes.count(slope) > 1:
            raise ConfigError(f"--slopes has {slope:g} twice; accepted: each slope once, and --repeats for more ramps")
    return RampPlan(
        slopes=slopes,
        repeats=options.repeats or rig.ramps.repeats,
        end_torque=options.end_torque or rig.ramps.end_torque,
        end_torque_loaded=options.end_torque or rig.ramps.end_torque_loaded,
    )


def _measure(options: argparse.Namespace, rig: Rig, plan: RampPlan, out: Path) -> tuple[list[RampRecord], str]:
    records: list[RampRecord] = []
    loads = _LOADS[options.load]
    with measuring(options, rig, out, sum(plan.duration(loaded) for loaded in loads), "ramps") as session:
        for loaded in loads:
            session.couple(loaded, session.client)
            try:
                _run_load(session, options, plan, loaded, (out, records))
            except IdentificationError as error:  # what was measured before stands, and is evaluated
                session.bar.write(f"{error}; no more ramps", sys.stderr)
                break
    return records, f"{len(records)} ramps on the {origin_of(options)}"


def _run_load(
    session: Session, options: argparse.Namespace, plan: RampPlan, loaded: bool, kept: tuple[Path, list[RampRecord]]
) -> None:
    """Run the ramps under one load; `kept` is folder and records."""
    client, bar, (out, records) = session.client, session.bar, kept

    def one(slope: float, label: str) -> RampRecord:
        bar.set_postfix_str(label, refresh=False)
        record = run_ramp(client, slope, plan.end(loaded), loaded, label, session.keep)
        records.append(record)
        write_csv(record, out / f"ramp_{len(records):02d}.csv")
        return record

    def choose(first: RampRecord) -> RampPlan:
        chosen = plan_from(first, plan, client.rig)
        chosen = replace(
            chosen,
            slopes=plan.slopes if options.slopes else chosen.slopes,
            repeats=plan.repeats if options.repeats else chosen.repeats,
        )
        if chosen != plan:
            slopes = " and ".join(f"{slope:g}" for slope in chosen.slopes)
            text = f"{'loaded' if loaded else 'no-load'}: {slopes} Nm/s, {chosen.repeats} repeats, by the first ramp"
            bar.write(text, sys.stderr)
            bar.total = round(bar.total + chosen.duration(loaded) - plan.duration(loaded), 1)
        return chosen

    run_planned(one, plan, loaded, choose)


def _read(options: argparse.Namespace, rig: Rig) -> list[RampRecord]:
    step = math.tau / rig.counts_per_revolution
    records = []
    for loaded, entries in ((False, options.no_load_file), (True, options.loaded_file)):
        for entry in entries:
            slope, file = _split(entry)
            if options.text:
                records.append(read_text(file, _text(options), slope, step, rig.tick, loaded))
            else:
                records.append(read_csv(file, slope, step, loaded))
    return records


def _text(options: argparse.Namespace) -> str:
    return INSTANTANEOUS if options.velocity == "instantaneous" else str(options.text)


def _split(entry: str) -> tuple[float, Path]:
    text, _, file = entry.partition(":")
    try:
        slope = float(text)
    except ValueError:
        slope = math.nan
    if not 0.0 < slope < math.inf or not file:
        raise ConfigError(f"file is {quoted(entry)}; accepted: slope:file, for example 0.05:ramp_01.csv")
    return slope, Path(file)
