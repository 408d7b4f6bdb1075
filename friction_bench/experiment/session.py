"""A measurement on a rig: its folder, the rig's port, one motion after another, and the readings.

The readings are written to a bag however the measurement ends, and the rig is stopped however a motion ends.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from friction_bench.rig.client import Port, RigClient, Sample
from friction_bench.rig.emulated import EmulatedRig, VirtualPort
from friction_bench.rig.messages import Fault, RigError, RigFaultError, State, fault_text
from friction_bench.rig.rig_file import TRAVEL_UNIT, Rig
from friction_bench.rig.serial_port import SerialPort
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, FailureError, write_error
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.process.files import made_folder
from rx90_common.process.interrupts import deferred_interrupts

_EMULATED = re.compile(r"emulated(?::(\d{1,9}))?")
REST_TICKS = 10
"""The shaft is at rest when it has not moved for so many ticks."""
REST_TIMEOUT = 30.0
LIMITS_SHARE = 0.9
"""Share of the rig's limits of travel and speed at which a motion is ended; the shaft needs the rest to stop."""
SPEED_TICKS = 5
"""Ticks over which the speed is averaged for that."""

_BAR = "{desc} {bar} {n:.0f}/{total:.0f} s [{elapsed}<{remaining}{postfix}]"


def seed_of(port: str) -> int | None:
    """Return the seed of the emulated rig that a port names, None of a serial line."""
    emulated = _EMULATED.fullmatch(port)
    if emulated is None and port.startswith("emulated"):
        raise ConfigError(
            f"--port {quoted(port)}; accepted: emulated, emulated:SEED such as emulated:7, a serial line"
        )
    return None if emulated is None else int(emulated[1] or 0)


def opened(port: str, rig: Rig) -> tuple[Port, Callable[[bool], None] | None]:
    """Return the line to the rig that `--port` names, and what couples the joint of an emulated one."""
    seed = seed_of(port)
    if seed is None:
        return SerialPort(port, rig.baud), None
    emulated = EmulatedRig(rig, seed)
    return VirtualPort(emulated), emulated.plant.load


def new_measurement(out: Path) -> None:
    """Make the folder, and check that files can be written in it: a measurement must not be lost at its end."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise write_error(out, error) from error


@dataclass
class Session:
    """A rig that has been greeted.

    Attributes:
        client: of the rig.
        couple: couples the revolute joint, or takes it off.
        bar: of the progress, over s of the rig's time.
        samples: of the whole measurement.
    """

    client: RigClient
    couple: Callable[[bool], None]
    bar: Any
    samples: list[Sample] = field(default_factory=list)

    def keep(self, sample: Sample) -> None:
        """Keep a reading, and go on by a tick."""
        self.samples.append(sample)
        self.bar.update(self.client.rig.tick)


@contextmanager
def measuring(options: argparse.Namespace, rig: Rig, seconds: float) -> Iterator[Session]:
    """Yield a session on a rig; at its end, for any reason, the readings are written as `bag` to the output folder.

    The folder is made; it is removed if nothing was measured, so that the next attempt may use its name.

    Args:
        options: of the command.
        rig: the rig.
        seconds: expected duration.
    """
    out: Path = options.output
    new_measurement(out)

    def ask(loaded: bool) -> None:
        """Let the person at the rig couple the joint or take it off; the rig is disarmed meanwhile."""
        if options.load != "both":
            return  # the option states the load, and nobody need be there
        print(
            f"{'Couple' if loaded else 'Take off'} the revolute joint, then press Enter.",
            file=sys.stderr,
        )
        try:
            input()
        except EOFError:
            raise FailureError(
                "nobody there to couple the joint; use --load none or --load joint"
            ) from None
        session.client.connect()

    with made_folder(out), ExitStack() as resources:
        port, couple = opened(options.port, rig)
        resources.callback(port.close)
        session = Session(RigClient(port, rig), couple or ask, None)
        try:
            with tqdm(
                total=round(seconds, 1), unit="s", desc="ramps", disable=None, bar_format=_BAR
            ) as session.bar:
                session.client.connect()
                if options.clear:
                    session.client.clear()
                yield session
        finally:
            with deferred_interrupts():  # a second Ctrl-C does not cost the readings
                resources.close()
                if session.samples:
                    write_joint_states(out / "bag", readings_series(session.samples, rig))


def readings_series(samples: list[Sample], rig: Rig) -> list[JointSeries]:
    """Return readings as the node publishes them: states and commands of the motor."""
    stamps = np.array([round(sample.time * NANOSECONDS) for sample in samples], dtype=np.int64)
    ticks, counts, dac, adc = sample_columns(samples)
    position = counts * rig.angle_step
    velocity = np.diff(position, prepend=position[0]) / (
        np.diff(ticks, prepend=ticks[0] - 1) * rig.tick
    )
    state = position[:, None], velocity[:, None], rig.measured_torque(adc)[:, None]
    return [
        JointSeries("/friction_bench/joint_states", ("rig_motor",), stamps, *state),
        JointSeries(
            "/friction_bench/joint_commands",
            ("rig_motor",),
            stamps,
            effort=rig.commanded_torque(dac)[:, None],
        ),
    ]


def sample_columns(samples: list[Sample]) -> tuple[Array, Array, Array, Array]:
    """Return ticks, counts, DAC and ADC codes of readings, each of shape (n,)."""
    rows = [(s.tick, s.counts, s.report.dac, s.report.adc) for s in samples]
    ticks, counts, dac, adc = np.array(rows, dtype=np.float64).T
    return ticks, counts, dac, adc


def refuse_fault(sample: Sample) -> None:
    """Raise RigFaultError if a reading has fault bits.

    Raises:
        RigFaultError: naming the faults.
    """
    report = sample.report
    if report.fault != Fault.NONE or report.state == State.FAULT:
        raise RigFaultError(
            f"the rig switched itself off: {fault_text(report.fault)}; find out why, then clear it"
        )


def wait_for_rest(client: RigClient) -> None:
    """Wait until the shaft is at rest, where a ramp must start.

    Raises:
        RigError: if it does not come to rest within REST_TIMEOUT seconds.
    """
    end = client.port.now() + REST_TIMEOUT
    still: list[int] = []
    while client.port.now() < end:
        still = [*still, *(sample.counts for sample in client.pump())][-REST_TICKS:]
        if len(still) == REST_TICKS and still[0] == still[-1]:
            return
    raise RigError(f"the shaft does not come to rest within {REST_TIMEOUT:g} s")


@contextmanager
def armed(client: RigClient) -> Iterator[None]:
    """Arm the rig, and stop it if the motion that follows raises anything, Ctrl-C above all.

    Raises:
        RigError: refused, faulted, lost or reset.
    """
    if client.last is not None:
        refuse_fault(client.last)
    try:
        client.arm()
        yield
    except BaseException:  # never leave with the power stage on
        with contextlib.suppress(RigError):  # a broken line carries no heartbeat either
            client.urgent_stop()
        # the motion's own: the next command is not overtaken by it
        client.known_stops = client.stops
        raise


def near_limits(rig: Rig, samples: list[Sample]) -> bool:
    """Tell whether the last reading of a motion lies near the limits of travel or speed, at which the firmware trips.

    Args:
        rig: with the limits.
        samples: since the rig was armed.
    """
    if len(samples) <= SPEED_TICKS:
        return False
    travel, speed = rig.limit_codes()
    last = samples[-1].counts
    moved = abs(last - samples[0].counts)
    lately = abs(last - samples[-1 - SPEED_TICKS].counts)
    too_far = moved > LIMITS_SHARE * travel * TRAVEL_UNIT
    return too_far or lately > LIMITS_SHARE * speed * SPEED_TICKS
