"""Run ramps on a rig and keep what they measured."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from friction_bench.experiment.record import RampRecord
from friction_bench.protocol.errors import RigError
from friction_bench.protocol.messages import Command, State
from friction_bench.rig.client import RigClient, Sample, raise_fault
from friction_bench.rig.rig_file import TRAVEL_UNIT, Rig
from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.arrays import Mask
from rx90_common.base.rates import NANOSECONDS

REST_TICKS = 10
"""The shaft is at rest when it has not moved for so many ticks."""
REST_TIMEOUT = 30.0


def wait_for_rest(client: RigClient) -> None:
    """Wait until the shaft stands still, for a ramp starts from rest.

    Raises:
        RigError: if it does not come to rest within REST_TIMEOUT seconds.
    """
    end = client.port.now() + REST_TIMEOUT
    still: list[int] = []
    while client.port.now() < end:
        for sample in client.pump():
            still = [*still[-REST_TICKS + 1 :], sample.counts]
        if len(still) == REST_TICKS and still[0] == still[-1]:
            return
    raise RigError(f"the shaft does not come to rest within {REST_TIMEOUT:g} s")


@dataclass
class Guard:
    """Notices, before the firmware trips, that a ramp comes near the rig's limits of travel and speed."""

    travel: float
    """Counts since arming."""
    speed: float
    """Counts per tick."""

    SHARE: ClassVar[float] = 0.9
    """Of the limits; the rest is for what the shaft does until a stop has arrived."""
    SMOOTHING: ClassVar[int] = 5
    """Ticks over which the speed is averaged."""

    @classmethod
    def of(cls, rig: Rig) -> Guard:
        """Return the guard of a rig."""
        travel, speed = rig.limit_codes()
        return cls(cls.SHARE * travel * TRAVEL_UNIT, cls.SHARE * speed)

    def reached(self, counts: ArrayLike) -> Mask:
        """Tell for each reading of a ramp whether it lies beyond travel or speed, shape (n,)."""
        values = np.asarray(counts, dtype=np.float64) - np.asarray(counts)[0]
        before = np.concatenate((np.zeros(self.SMOOTHING), values))[: values.size]
        return np.asarray((values > self.travel) | (values - before > self.speed * self.SMOOTHING))


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
    step = rig.ramp_step(slope)
    client.end_code(end_torque)  # refused before anything is switched on
    wait_for_rest(client)
    if client.last is not None:
        raise_fault(client.last.report)
    try:
        client.arm()
        samples = _follow(client, client.start_ramp(slope, end_torque), on_sample)
    except BaseException:  # Ctrl-C above all: never leave with the power stage on
        with contextlib.suppress(RigError):  # a line that is gone carries no heartbeat either
            client.line.urgent_stop()
        # This stop is the ramp's own: the next command is not overtaken by it.
        client.line.known_stops = client.line.stops
        raise
    return _record(samples, rig, rig.slope_of_step(step), loaded, label)


def _follow(client: RigClient, first: list[Sample], on_sample: Callable[[Sample], None]) -> list[Sample]:
    samples = [sample for sample in first if sample.report.state == State.RAMPING]
    guard = Guard.of(client.rig)
    while True:
        for sample in client.pump():
            raise_fault(sample.report)
            if sample.report.ramp_done:
                return samples
            if sample.report.state != State.RAMPING:
                raise RigError("the ramp was stopped before its end")
            samples.append(sample)
            on_sample(sample)
        window = [samples[0].counts, *(sample.counts for sample in samples[-guard.SMOOTHING - 1 :])]
        if len(samples) > guard.SMOOTHING and guard.reached(window)[-1]:
            client.request(Command.STOP)
            return samples


def _record(samples: list[Sample], rig: Rig, slope: float, loaded: bool, label: str) -> RampRecord:
    if len(samples) < 2:
        raise RigError(f"{label}: {len(samples)} readings during the ramp; accepted: at least 2")
    step = 2 * np.pi / rig.counts_per_revolution
    counts = np.array([sample.counts for sample in samples], dtype=np.float64)
    return RampRecord(
        time=np.array([sample.time - samples[0].time for sample in samples]),
        angle=(counts - counts[0]) * step,
        slope=slope,
        angle_step=step,
        torque=np.array([rig.torque(sample.report.dac) for sample in samples]),
        measured_torque=np.array([rig.measured_torque(sample.report.adc) for sample in samples]),
        loaded=loaded,
        label=label,
    )


@dataclass
class Readings:
    """Every reading of a measurement, for the bag."""

    rig: Rig
    samples: list[Sample] = field(default_factory=list)

    def series(self) -> list[JointSeries]:
        """Return the readings as the node publishes them: states and commands of the motor."""
        ticks = [s.tick for s in self.samples]
        stamps = np.array([round(s.time * NANOSECONDS) for s in self.samples], dtype=np.int64)
        scale = 2 * np.pi / self.rig.counts_per_revolution
        position = np.array([s.counts for s in self.samples], dtype=np.float64) * scale
        elapsed = np.diff(np.array(ticks), prepend=ticks[0] - 1) * self.rig.tick
        velocity = np.diff(position, prepend=position[0]) / elapsed
        measured = np.array([self.rig.measured_torque(s.report.adc) for s in self.samples])
        commanded = np.array([self.rig.torque(s.report.dac) for s in self.samples])
        names = ("rig_motor",)
        return [
            JointSeries(
                "/friction_bench/joint_states",
                names,
                stamps,
                position[:, None],
                velocity[:, None],
                measured[:, None],
            ),
            JointSeries("/friction_bench/joint_commands", names, stamps, effort=commanded[:, None]),
        ]
