"""The run of `friction_ramp`, apart from its options: they are checked first, as the import takes two seconds."""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from tqdm import tqdm

from friction_bench.experiment.evaluation import evaluate
from friction_bench.experiment.ramp import Readings, run_ramps
from friction_bench.experiment.record import RampRecord, RecordError, read_csv, read_text, write_csv
from friction_bench.experiment.report import result_text, write_estimates, write_html, write_yaml
from friction_bench.protocol.serial_port import SerialPort
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, VirtualPort
from friction_bench.rig.line import Port
from friction_bench.rig.pty_rig import PtyRig
from friction_bench.rig.rig_file import RampPlan, Rig, load_rig
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.errors import ConfigError, FailureError, write_error
from rx90_common.base.quoting import quoted
from rx90_common.base.share import config_path, resolve_config
from rx90_common.description.robot_files import SHIPPED
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.process.interrupts import interrupts_later

_LOADS = {"none": (False,), "joint": (True,), "both": (False, True)}


def run(options: argparse.Namespace) -> None:
    """Measure or read ramps, identify friction, and write the report.

    Raises:
        Rx90Error: for what is refused; what has been measured until then stands in the folder.
    """
    rig = load_rig(resolve_config(options.rig))
    out: Path = options.output
    base = FrictionFile.read(config_path(SHIPPED["friction"]))
    _check(options, base)
    if options.no_load_file or options.loaded_file:
        _folder(out)
        records = _read(options, rig)
        origin = f"{len(records)} recorded ramps"
    else:
        plan = _plan(options, rig)
        records, origin = _measure(options, rig, plan, out)
    result = evaluate(records, rig)
    write_html(out / "report.html", result, rig, origin)
    write_estimates(out / "estimates.yaml", result)
    write_yaml(out / "friction.yaml", result, rig, options.element, base)
    print(result_text(result))
    print(f"report: {out / 'report.html'}\nparameters for rx90_sim: {out / 'friction.yaml'}")


def _check(options: argparse.Namespace, base: FrictionFile) -> None:
    """Refuse now what would otherwise be noticed after minutes of ramps."""
    if options.element not in base.elements:
        known = ", ".join(base.elements)
        raise ConfigError(f"--element is {quoted(options.element)}; accepted: {known}")
    for name, low, high in (("seed", 0, 2**31 - 1), ("repeats", 1, 1000), ("baud", 1200, 1_000_000)):
        value = getattr(options, name)
        if value is not None and not low <= value <= high:
            raise ConfigError(f"--{name} is {value}; accepted: {low} to {high}")
    if options.text and not (options.no_load_file or options.loaded_file):
        raise ConfigError("--text is given without a file; accepted: with --no-load-file or --loaded-file")


def _folder(out: Path) -> None:
    """Make the folder, and make sure that files can be written in it: a measurement must not be lost at its end."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise write_error(out, error) from error


def _plan(options: argparse.Namespace, rig: Rig) -> RampPlan:
    slopes = tuple(options.slopes or rig.ramps.slopes)
    torque = options.end_torque
    if torque is not None and not 0.0 < torque <= rig.dac_full_scale:
        raise ConfigError(f"--end-torque is {torque:g}; accepted: (0, {rig.dac_full_scale:g}] Nm")
    for slope in slopes:
        rig.ramp_step(slope)
    return RampPlan(
        slopes=slopes,
        repeats=options.repeats or rig.ramps.repeats,
        end_torque=options.end_torque or rig.ramps.end_torque,
        end_torque_loaded=options.end_torque or rig.ramps.end_torque_loaded,
    )


def _measure(options: argparse.Namespace, rig: Rig, plan: RampPlan, out: Path) -> tuple[list[RampRecord], str]:
    bag = out / "bag"
    for old in (bag, *sorted(out.glob("ramp_*.csv"))[:1]):
        if old.exists():
            raise RecordError(f"{old} exists; accepted: a folder without a measurement, for example --output {out}_2")
    _folder(out)
    port, couple, close = _open(options, rig)
    readings = Readings(rig)
    records: list[RampRecord] = []
    loads = _LOADS[options.load]
    total = sum(plan.duration(loaded) for loaded in loads)
    try:
        with tqdm(total=round(total, 1), unit="s", desc="ramps", disable=None, bar_format=_BAR) as bar:
            client = RigClient(port, rig)
            client.connect()
            if options.clear:
                client.clear()

            def progress(seconds: float, label: str) -> None:
                bar.set_postfix_str(label, refresh=False)
                bar.update(seconds)

            def keep(record: RampRecord) -> None:
                records.append(record)
                write_csv(record, out / f"ramp_{len(records):02d}.csv")

            for loaded in loads:
                couple(loaded, client)
                run_ramps(client, plan, loaded, readings, progress, keep)
    finally:
        with interrupts_later():  # a second Ctrl-C does not cost the readings
            port.close()
            close()
            if readings.samples:
                write_joint_states(bag, readings.series())
    kind = "emulated rig" if options.port == "emulated" else f"rig at {options.port}"
    return records, f"{len(records)} ramps on the {kind}"


_BAR = "{desc} {bar} {n:.0f}/{total:.0f} s [{elapsed}<{remaining}{postfix}]"


def _open(options: argparse.Namespace, rig: Rig) -> tuple[Port, Callable[[bool, RigClient], None], Callable[[], None]]:
    """Return the port, what couples the joint, and what ends an emulated rig."""
    if options.port != "emulated":
        port: Port = SerialPort(options.port, options.baud or rig.baud)
        # With --load none or joint the joint is as the option says, and nobody need be there.
        return port, _ask if options.load == "both" else lambda *_: None, lambda: None
    emulated = EmulatedRig(rig, options.seed)
    if not options.real_time:
        return VirtualPort(emulated), lambda loaded, _: emulated.plant.load(loaded), lambda: None
    pty_rig = PtyRig(emulated)
    return SerialPort(pty_rig.path, rig.baud), lambda loaded, _: pty_rig.load(loaded), pty_rig.close


def _ask(loaded: bool, client: RigClient) -> None:
    """Let the person at the rig couple the joint or take it off; the rig is disarmed meanwhile."""
    print(f"{'Couple' if loaded else 'Take off'} the revolute joint, then press Enter.", file=sys.stderr)
    try:
        input()
    except EOFError:
        raise FailureError("nobody there to couple the joint; use --load none or --load joint") from None
    client.connect()


def _read(options: argparse.Namespace, rig: Rig) -> list[RampRecord]:
    step = math.tau / rig.counts_per_revolution
    records = []
    for loaded, entries in ((False, options.no_load_file), (True, options.loaded_file)):
        for entry in entries:
            slope, file = _split(entry)
            if options.text:
                records.append(read_text(file, options.text, slope, step, rig.tick, loaded))
            else:
                records.append(read_csv(file, slope, step, loaded))
    return records


def _split(entry: str) -> tuple[float, Path]:
    text, _, file = entry.partition(":")
    try:
        slope = float(text)
    except ValueError:
        slope = math.nan
    if not 0.0 < slope < math.inf or not file:
        raise ConfigError(f"file is {quoted(entry)}; accepted: slope:file, for example 0.05:ramp_01.csv")
    return slope, Path(file)
