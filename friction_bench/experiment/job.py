"""The run of `friction_ramp`, apart from its options: they are checked first, as the import takes two seconds."""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import replace
from pathlib import Path

from friction_bench.experiment.evaluation import evaluate
from friction_bench.experiment.planning import plan_from, run_planned
from friction_bench.experiment.ramp import run_ramp
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
