"""The run of `rx90 rig ramp` without its options: new ramps, planned from the first one, or recorded ones."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path

from friction_bench.experiment.identification import evaluate
from friction_bench.experiment.record import (
    RampRecord,
    read_csv,
    read_text,
    sliding_window,
    write_csv,
)
from friction_bench.experiment.report import write_friction, write_result
from friction_bench.experiment.session import (
    LIMITS_SHARE,
    armed,
    measuring,
    near_limits,
    new_measurement,
    refuse_fault,
    sample_columns,
    seed_of,
    wait_for_rest,
)
from friction_bench.experiment.sliding_fit import fit_sliding
from friction_bench.rig.client import RigClient, Sample
from friction_bench.rig.messages import Command, RigError, State
from friction_bench.rig.rig_file import TRAVEL_UNIT, RampPlan, Rig, load_rig
from rx90_common.base.errors import DONE, VERDICT_NO, ConfigError, IdentificationError
from rx90_common.base.models import refusals
from rx90_common.base.quoting import counted, one_line, quoted
from rx90_common.base.share import SHIPPED_RIG, SOURCE_RIG, resolve_config
from rx90_common.description.robot_files import RobotFiles
from rx90_common.friction.friction_file import FrictionFile, refuse_parts

MIN_SLIDING_TIME = 1.5
"""Shortest time for which the shaft slides in the fastest ramp, s."""
MIN_TIME_CONSTANTS = 8.0
"""The same in time constants; the longer of the two counts."""
MAX_TIME_CONSTANT = 0.5
"""The time constant, s, that is assumed if the first ramp shows a longer one: a single ramp determines it poorly."""
MIN_SLOPE_RATIO = 1.8
"""Smallest ratio of fastest to slowest slope."""
SLOPE_RATIO = 2.5
"""The ratio where the slopes are chosen here."""
MIN_SLIDING_READINGS = 300
"""Fewest readings of a sliding shaft at the fastest slope, all repeats together."""
MAX_REPEATS = 20
LOADS = {False: "no-load", True: "loaded"}
_CHOSEN_LOADS = {"none": (False,), "joint": (True,), "both": (False, True)}


def run_ramp(
    client: RigClient,
    slope: float,
    end_torque: float,
    loaded: bool,
    label: str,
    on_sample: Callable[[Sample], None] = lambda _: None,
) -> RampRecord:
    """Arm the rig, run one ramp of `slope` Nm/s up to `end_torque` Nm and return its record.

    A ramp that comes near the limits of travel or speed is ended there. The rig is disarmed again when this returns,
    and stopped when it raises.

    Raises:
        RigError: refused, faulted, lost or reset.
    """
    rig = client.rig
    slope = rig.slope_of_step(rig.ramp_step(slope))
    end = client.end_code(end_torque)  # refused before anything is switched on
    wait_for_rest(client)
    with armed(client):
        samples = _follow(client, client.start_ramp(slope, end_torque), on_sample)
    # a held end torque is no ramp
    samples = [sample for sample in samples if sample.report.dac < end]
    if len(samples) < 2:
        raise RigError(
            f"{label}: {counted(len(samples), 'reading')} during the ramp; accepted: at least 2"
        )
    ticks, counts, dac, adc = sample_columns(samples)
    return RampRecord(
        time=ticks * rig.tick - samples[0].time,
        angle=(counts - counts[0]) * rig.angle_step,
        slope=slope,
        angle_step=rig.angle_step,
        torque=rig.commanded_torque(dac),
        measured_torque=rig.measured_torque(adc),
        loaded=loaded,
        label=label,
    )


def _follow(
    client: RigClient, first: list[Sample], on_sample: Callable[[Sample], None]
) -> list[Sample]:
    samples = [sample for sample in first if sample.report.state == State.RAMPING]
    while not near_limits(client.rig, samples):
        for sample in client.pump():
            refuse_fault(sample)
            if sample.report.ramp_done:
                return samples
            if sample.report.state != State.RAMPING:
                raise RigError("the ramp was stopped before its end")
            samples.append(sample)
            on_sample(sample)
    client.request(Command.STOP)
    return samples


def run_planned(
    run: Callable[[float, str], RampRecord],
    plan: RampPlan,
    loaded: bool,
    choose: Callable[[RampRecord], RampPlan],
) -> None:
    """Run all ramps under one load: the first of the slowest slope, then those of the plan that is chosen by it.

    Args:
        run: one ramp of a slope, Nm/s, with a label.
        plan: for the first ramp.
        loaded: for the labels.
        choose: the plan for the rest, from the first ramp; the first ramp counts where it has one of its slopes.
    """
    slowest = min(plan.slopes)
    chosen = choose(run(slowest, f"{LOADS[loaded]} {slowest:g} Nm/s #1"))
    for repeat in range(chosen.repeats):
        for slope in sorted(chosen.slopes):
            if (repeat, slope) != (0, slowest):
                run(slope, f"{LOADS[loaded]} {slope:g} Nm/s #{repeat + 1}")


def plan_from(first: RampRecord, plan: RampPlan, rig: Rig) -> RampPlan:
    """Return the plan, with other slopes and more repeats if the first ramp shows that its own are unsuitable.

    Args:
        first: a ramp of the plan's slowest slope.
        plan: initial slopes and end torques; the end torques do not change.
        rig: for the limits of travel and speed.
    """
    fit = fit_sliding([sliding_window(first)])
    coulomb, viscous, inertia = fit.values.tolist()
    if not (viscous > 0.0 and inertia > 0.0):
        raise IdentificationError(
            f"{first.label}: the shaft does not slide as a ramp torque lets it, the viscous friction would be "
            f"{viscous:.3g} Nm s/rad; saturation, or the joint runs against a stop"
        )
    # One ramp shows the time constant poorly: this one is hardly exceeded.
    constant = (inertia + 2.0 * math.sqrt(max(float(fit.covariance[2, 2]), 0.0))) / viscous
    travel, speed = rig.limit_codes()
    top = LIMITS_SHARE * speed * first.angle_step / rig.tick
    rise = min(plan.end(first.loaded) - coulomb, viscous * top)
    if rise <= 0.0:
        return plan
    fastest = rise / max(MIN_SLIDING_TIME, MIN_TIME_CONSTANTS * min(constant, MAX_TIME_CONSTANT))
    farthest = LIMITS_SHARE * travel * TRAVEL_UNIT * first.angle_step
    slowest = rise**2 / (2.0 * viscous * farthest)  # slower ones turn the shaft too far
    slopes = plan.slopes
    if not (
        max(slopes) <= fastest
        and min(slopes) >= slowest
        and max(slopes) >= MIN_SLOPE_RATIO * min(slopes)
    ):
        high = min(max(fastest, SLOPE_RATIO * slowest), max(slopes))
        low = max(high / SLOPE_RATIO, rig.slope_of_step(1))
        slopes = (float(f"{low:.3g}"), float(f"{high:.3g}"))
    readings = rise / max(slopes) / rig.tick
    repeats = min(max(plan.repeats, math.ceil(MIN_SLIDING_READINGS / readings)), MAX_REPEATS)
    return plan.replaced(slopes=slopes, repeats=repeats)


def run(options: argparse.Namespace) -> int:
    """Measure or read ramps, identify friction, and write the report.

    Returns:
        The exit code: 1 if a requested load has no estimate.
    """
    rig = load_rig(
        resolve_config(SOURCE_RIG if options.source and options.rig == SHIPPED_RIG else options.rig)
    )
    out: Path = options.output
    path = RobotFiles.of_options(options).friction
    base = FrictionFile.read(path)
    _check(options, base, path)
    if options.files:
        records = _read(options, rig)
        new_measurement(out)
        origin = counted(len(records), "recorded ramp")
    else:
        records = _measure(options, rig, _plan(options, rig))
        measured_by = (
            "emulated rig" if seed_of(options.port) is not None else f"rig at {options.port}"
        )
        origin = f"{counted(len(records), 'ramp')} on the {measured_by}"
    found = evaluate(records, rig, options.source)
    write_result(out, found, rig, origin)
    print(one_line(f"report: {out / 'report.html'}"))
    if found.failures:
        print(
            "parameters for rx90_sim: not written, as a load carries no estimate", file=sys.stderr
        )
        return VERDICT_NO
    for text in found.unphysical:
        print(one_line(f"not physical: {text}"), file=sys.stderr)
    if found.written[0].value > 0.0:
        write_friction(out / "friction.yaml", found, options.element, base)
        print(one_line(f"parameters for rx90_sim: {out / 'friction.yaml'}"))
    else:
        print(
            "parameters for rx90_sim: not written, as the Coulomb friction is not positive",
            file=sys.stderr,
        )
    return VERDICT_NO if found.unphysical else DONE


def _check(options: argparse.Namespace, base: FrictionFile, path: Path) -> None:
    """Refuse errors now that would otherwise be noticed after minutes of ramps."""
    elements = base.elements.entries
    if options.element not in elements:
        known = ", ".join(elements)
        raise ConfigError(f"--element is {quoted(options.element)}; accepted: {known}")
    replaced = {options.element: elements[options.element]}
    refuse_parts(replaced, "the element that a ramp test replaces", f"{path}: elements.")
    seed_of(options.port)


def _plan(options: argparse.Namespace, rig: Rig) -> RampPlan:
    slopes = tuple(options.slopes or rig.ramps.slopes)
    torque = options.end_torque
    if torque is not None and not 0.0 < torque <= rig.torque.dac_full_scale:
        raise ConfigError(
            f"--end-torque is {torque:g}; accepted: (0, {rig.torque.dac_full_scale:g}] Nm"
        )
    for slope in slopes:
        rig.ramp_step(slope)
        if slopes.count(slope) > 1:
            raise ConfigError(
                f"--slopes has {slope:g} twice; accepted: each slope once, and --repeats for more ramps"
            )
    with refusals(RampPlan):
        return RampPlan(
            slopes=slopes,
            end_torque=torque or rig.ramps.end_torque,
            end_torque_loaded=torque or rig.ramps.end_torque_loaded,
            repeats=options.repeats or rig.ramps.repeats,
            hold=rig.ramps.hold,
        )


def _measure(options: argparse.Namespace, rig: Rig, plan: RampPlan) -> list[RampRecord]:
    """Run the ramps of all loads; each is written as a CSV file when it ends."""
    records: list[RampRecord] = []
    loads = _CHOSEN_LOADS[options.load]
    seconds = sum(plan.duration(loaded) for loaded in loads)
    with measuring(options, rig, seconds) as session:
        bar = session.bar

        def run_one(slope: float, label: str) -> RampRecord:
            bar.set_postfix_str(label, refresh=False)
            record = run_ramp(session.client, slope, plan.end(loaded), loaded, label, session.keep)
            records.append(record)
            write_csv(record, options.output / f"ramp_{len(records):02d}.csv")
            return record

        def choose(first: RampRecord) -> RampPlan:
            if options.source:
                return planned
            chosen = plan_from(first, plan, rig)
            slopes = plan.slopes if options.slopes else chosen.slopes
            chosen = chosen.replaced(slopes=slopes, repeats=options.repeats or chosen.repeats)
            if chosen != plan:
                text = f"{' and '.join(f'{slope:g}' for slope in slopes)} Nm/s, {chosen.repeats} repeats"
                bar.write(f"{LOADS[loaded]}: {text}, by the first ramp", sys.stderr)
                bar.total = round(bar.total + chosen.duration(loaded) - plan.duration(loaded), 1)
            return chosen

        for loaded in loads:
            session.couple(loaded)
            try:
                planned = plan.replaced(slopes=(plan.slopes[loaded],)) if options.source else plan
                run_planned(run_one, planned, loaded, choose)
            except (
                IdentificationError
            ) as error:  # earlier measurements are on disk, and are evaluated
                bar.write(f"{error}; no more ramps", sys.stderr)
                break
    return records


def _read(options: argparse.Namespace, rig: Rig) -> list[RampRecord]:
    records = []
    for loaded, entries in ((False, options.no_load_file), (True, options.loaded_file)):
        for entry in entries:
            text, _, file = entry.partition(":")
            try:
                slope = float(text)
            except ValueError:
                slope = math.nan
            if not 0.0 < slope < math.inf or not file:
                raise ConfigError(
                    f"file is {quoted(entry)}; accepted: slope:file, for example 0.05:ramp_01.csv"
                )
            if options.text:
                records.append(
                    read_text(Path(file), options.text, slope, rig.angle_step, rig.tick, loaded)
                )
            else:
                records.append(read_csv(Path(file), slope, rig.angle_step, loaded))
    return records
