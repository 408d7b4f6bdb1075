"""What an experiment measured: torque and angle at the joint, tick by tick, as data and as a CSV file."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from friction_bench.rig.client import Sample
from friction_bench.rig.rig_file import Rig
from rx90_common.base.arrays import Array
from rx90_common.process.files import written_beside

COLUMNS = ("time", "counts", "code")

LATE = 0.7
"""Part of a tick after which the answer to a reading is on the DAC: 9 ms for the report and 4 for the command."""


@dataclass(frozen=True, eq=False)
class Trace:
    """Readings of one experiment, joint side.

    Attributes:
        label: names it in messages and plots.
        time: of each reading, s, from 0, shape (n,).
        counts: of the encoder, from 0, shape (n,).
        code: on the DAC at the reading, shape (n,).
        angle_step: what a count stands for, rad.
        torque_step: what a code stands for, Nm.
        tick: period of the readings, s.
    """

    label: str
    time: Array
    counts: Array
    code: Array
    angle_step: float
    torque_step: float
    tick: float

    @property
    def angle(self) -> Array:
        """Return the joint's angle, rad, shape (n,)."""
        return self.counts * self.angle_step

    @property
    def torque(self) -> Array:
        """Return the torque that the motor puts on the joint, Nm, shape (n,)."""
        return self.code * self.torque_step

    @property
    def held(self) -> Array:
        """Return the mean torque over the tick before each reading, Nm, shape (n,)."""
        before = np.concatenate((self.torque[:1], self.torque[:-1]))
        return LATE * before + (1.0 - LATE) * self.torque

    def part(self, first: int, last: int | None = None) -> Trace:
        """Return the readings from `first` on, up to `last`."""
        cut = slice(first, last)
        return replace(self, time=self.time[cut], counts=self.counts[cut], code=self.code[cut])


def trace_of(label: str, samples: Sequence[Sample], rig: Rig) -> Trace:
    """Return the readings of an experiment."""
    ticks = np.array([sample.tick for sample in samples], dtype=np.float64)
    counts = np.array([sample.counts for sample in samples], dtype=np.float64)
    code = np.array([sample.report.dac for sample in samples], dtype=np.float64)
    return Trace(
        label,
        (ticks - ticks[0]) * rig.tick,
        counts - counts[0],
        code,
        rig.joint_step,
        rig.torque(1) * rig.joint_scale,
        rig.tick,
    )


def write_trace(trace: Trace, path: Path) -> None:
    """Write a trace as CSV.

    Raises:
        Rx90Error: if the file cannot be written.
    """
    with written_beside(path) as (beside,), beside.open("w", newline="", encoding="utf-8") as stream:
        stream.write(f"# {trace.label}; a count is {trace.angle_step!r} rad, a code {trace.torque_step!r} Nm\n")
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        for time, counts, code in zip(trace.time, trace.counts, trace.code, strict=True):
            writer.writerow([f"{time:.6g}", int(counts), int(code)])
