"""A measurement on a rig: its folder, the rig's port, and the readings, which stand in a bag whatever ends it."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from friction_bench.experiment.ramp import Readings
from friction_bench.protocol.serial_port import SerialPort
from friction_bench.rig.client import RigClient, Sample
from friction_bench.rig.emulated import EmulatedRig, VirtualPort
from friction_bench.rig.line import Port
from friction_bench.rig.pty_rig import PtyRig
from friction_bench.rig.rig_file import Rig
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.errors import ConfigError, FailureError, Rx90Error, write_error
from rx90_common.base.quoting import plain
from rx90_common.process.interrupts import interrupts_later

EMULATED = "emulated"
"""As a port."""
Couple = Callable[[bool, RigClient], None]

_BAR = "{desc} {bar} {n:.0f}/{total:.0f} s [{elapsed}<{remaining}{postfix}]"


class Session(NamedTuple):
    """A rig that has been greeted.

    Attributes:
        client: of the rig.
        couple: couples the revolute joint, or takes it off.
        bar: of the progress, over s of the rig's time.
        readings: of the whole measurement.
    """

    client: RigClient
    couple: Couple
    bar: Any
    readings: Readings

    def keep(self, sample: Sample) -> None:
        """Keep a reading, and go on by a tick."""
        self.readings.samples.append(sample)
        self.bar.update(self.client.rig.tick)


def check_ranges(options: argparse.Namespace, ranges: Sequence[tuple[str, int, int]]) -> None:
    """Refuse numbers of options out of their ranges, each a name, the least and the largest; None is left out.

    Raises:
        ConfigError: naming the option.
    """
    for name, low, high in ranges:
        value = getattr(options, name)
        if value is not None and not low <= value <= high:
            raise ConfigError(f"--{name} is {value}; accepted: {low} to {high}")


def check_port(options: argparse.Namespace) -> None:
    """Refuse options of an emulated rig with a real one, and of a line with an emulated one.

    Raises:
        ConfigError: naming the option.
    """
    if options.port != EMULATED:
        given = "seed" if options.seed is not None else "real-time" if options.real_time else ""
        if given:
            raise ConfigError(f"--{given} with --port {plain(options.port)}; accepted: with the emulated rig alone")
    elif options.baud is not None:
        raise ConfigError(f"--baud {options.baud} with the emulated rig; accepted: with --port of a serial line")


def new_measurement(out: Path) -> None:
    """Make the folder, and make sure that files can be written in it: a measurement must not be lost at its end."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise write_error(out, error) from error


def origin_of(options: argparse.Namespace) -> str:
    """Return in words which rig measures."""
    return "emulated rig" if options.port == EMULATED else f"rig at {options.port}"


@contextmanager
def measuring(options: argparse.Namespace, rig: Rig, out: Path, seconds: float, what: str) -> Iterator[Session]:
    """Yield a session on a rig; at its end, however it comes, the readings stand as `bag` in the folder.

    Args:
        options: of the command.
        rig: what to measure on.
        out: the folder, which is made; it goes again if nothing was measured, so that the next try may take its name.
        seconds: how long it is to take.
        what: before the progress bar.

    Raises:
        Rx90Error: for a folder that cannot be made, a rig that cannot be reached, a bag that cannot be written.
    """
    new_measurement(out)
    try:
        port, couple, close = _open(options, rig)
    except Rx90Error:
        out.rmdir()
        raise
    readings = Readings(rig)
    try:
        with tqdm(total=round(seconds, 1), unit="s", desc=what, disable=None, bar_format=_BAR) as bar:
            client = RigClient(port, rig)
            client.connect()
            if options.clear:
                client.clear()
            yield Session(client, couple, bar, readings)
    finally:
        with interrupts_later():  # a second Ctrl-C does not cost the readings
            port.close()
            close()
            if readings.samples:
                write_joint_states(out / "bag", readings.series())
            else:
                out.rmdir()


def _open(options: argparse.Namespace, rig: Rig) -> tuple[Port, Couple, Callable[[], None]]:
    """Return the port, what couples the joint, and what ends an emulated rig."""
    if options.port != EMULATED:
        port: Port = SerialPort(options.port, options.baud or rig.baud)
        # With --load none or joint the joint is as the option says, and nobody need be there.
        return port, _ask if options.load == "both" else lambda *_: None, lambda: None
    emulated = EmulatedRig(rig, options.seed or 0)
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
