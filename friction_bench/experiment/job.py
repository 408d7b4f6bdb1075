"""The run of `friction_ramp`, apart from its options: they are checked first, as the import takes two seconds."""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import replace
from pathlib import Path

from friction_bench.experiment.identification import evaluate
from friction_bench.experiment.ramp import plan_from, run_planned, run_ramp
from friction_bench.experiment.record import INSTANTANEOUS, RampRecord, read_csv, read_text, write_csv
from friction_bench.experiment.report import result_text, write_estimates, write_html, write_yaml
from friction_bench.experiment.session import EMULATED, check_options, measuring, new_measurement, origin_of
from friction_bench.rig.rig_file import RampPlan, Rig, load_rig
from rx90_common.base.errors import DONE, VERDICT_NO, ConfigError, IdentificationError
from rx90_common.base.quoting import one_line, quoted
from rx90_common.base.share import resolve_config
from rx90_common.description.robot_files import RobotFiles
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.friction_set import refuse_parts

_LOADS = {"none": (False,), "joint": (True,), "both": (False, True)}
_OF_A_RIG = {"port": EMULATED, "load": "both", "slopes": None, "repeats": None, "end_torque": None, "seed": None}
"""Options with which nothing can be done when old data are read, and their defaults."""


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
        records = _measure(options, rig, _plan(options, rig))
        origin = f"{len(records)} ramps on the {origin_of(options)}"
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
    check_options(options)
    if options.no_load_file or options.loaded_file:
        for name, usual in {**_OF_A_RIG, "clear": False, "real_time": False}.items():
            if getattr(options, name) not in (None, usual):
                raise ConfigError(f"--{name.replace('_', '-')} with old data; accepted: with a rig")
    elif options.text:
        raise ConfigError("--text is given without a file; accepted: with --no-load-file or --loaded-file")
    if options.velocity and options.text != "velocity":
        raise ConfigError(f"--velocity is {options.velocity}; accepted: with --text velocity alone")


def _plan(options: argparse.Namespace, rig: Rig) -> RampPlan:
    slopes = tuple(options.slopes or rig.ramps.slopes)
    torque = options.end_torque
    if torque is not None and not 0.0 < torque <= rig.dac_full_scale:
        raise ConfigError(f"--end-torque is {torque:g}; accepted: (0, {rig.dac_full_scale:g}] Nm")
    for slope in slopes:
        rig.ramp_step(slope)
        if slopes.count(slope) > 1:
            raise ConfigError(f"--slopes has {slope:g} twice; accepted: each slope once, and --repeats for more ramps")
    ends = torque or rig.ramps.end_torque, torque or rig.ramps.end_torque_loaded
    return RampPlan(slopes, *ends, options.repeats or rig.ramps.repeats)


def _measure(options: argparse.Namespace, rig: Rig, plan: RampPlan) -> list[RampRecord]:
    """Run the ramps of all loads; each stands as a CSV file when it is over."""
    records: list[RampRecord] = []
    out, loads = options.output, _LOADS[options.load]
    with measuring(options, rig, out, sum(plan.duration(loaded) for loaded in loads), "ramps") as session:
        bar = session.bar

        def one(slope: float, label: str) -> RampRecord:
            bar.set_postfix_str(label, refresh=False)
            record = run_ramp(session.client, slope, plan.end(loaded), loaded, label, session.keep)
            records.append(record)
            write_csv(record, out / f"ramp_{len(records):02d}.csv")
            return record

        def choose(first: RampRecord) -> RampPlan:
            chosen = plan_from(first, plan, rig)
            if options.slopes:
                chosen = replace(chosen, slopes=plan.slopes)
            if options.repeats:
                chosen = replace(chosen, repeats=plan.repeats)
            if chosen != plan:
                slopes = " and ".join(f"{slope:g}" for slope in chosen.slopes)
                load = "loaded" if loaded else "no-load"
                bar.write(f"{load}: {slopes} Nm/s, {chosen.repeats} repeats, by the first ramp", sys.stderr)
                bar.total = round(bar.total + chosen.duration(loaded) - plan.duration(loaded), 1)
            return chosen

        for loaded in loads:
            session.couple(loaded)
            try:
                run_planned(one, plan, loaded, choose)
            except IdentificationError as error:  # what was measured before stands, and is evaluated
                bar.write(f"{error}; no more ramps", sys.stderr)
                break
    return records


def _read(options: argparse.Namespace, rig: Rig) -> list[RampRecord]:
    kind = INSTANTANEOUS if options.velocity == "instantaneous" else options.text
    records = []
    for loaded, entries in ((False, options.no_load_file), (True, options.loaded_file)):
        for entry in entries:
            text, _, file = entry.partition(":")
            try:
                slope = float(text)
            except ValueError:
                slope = math.nan
            if not 0.0 < slope < math.inf or not file:
                raise ConfigError(f"file is {quoted(entry)}; accepted: slope:file, for example 0.05:ramp_01.csv")
            if kind:
                records.append(read_text(Path(file), kind, slope, rig.angle_step, rig.tick, loaded))
            else:
                records.append(read_csv(Path(file), slope, rig.angle_step, loaded))
    return records
