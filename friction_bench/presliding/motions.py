"""Motions of the rig: profiles of torque, which the host follows tick by tick, and the resulting readings.

Codes are those of the DAC. On a unipolar rig torque has one direction, from zero to the motor's limit: a motion is
reversed by reducing the torque, and the deflected bristles drive it back. So loops lie between zero and
break-away, and a sliding joint is never reversed. On a bipolar rig codes below 0 are torque backward: loops go through
zero, and the joint slides in both directions, by the same profiles counted the other way.

The host answers each report at once with the protocol's TORQUE command. A code reaches the DAC some 15 ms
after the reading that it answers (9 ms for the report on the line at 19200 baud, 4 ms for the command, the firmware's
loop): a delay of less than a tick, and the next report contains the code on the DAC.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from friction_bench.experiment.record import write_table
from friction_bench.experiment.session import armed, last_near_limits, refuse_fault, sample_columns
from friction_bench.rig.client import RigClient, Sample
from friction_bench.rig.messages import Command, CommandResult, RigError, RigRefusedError, State
from friction_bench.rig.rig_file import Rig
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError

DAC_DELAY = 0.7
"""Part of a tick after which the answer to a reading is on the DAC: 9 ms for the report and 4 for the command."""
DWELL_TICKS = 4
"""Ticks for which a torque is held in loops: the joint has come to rest at their end."""
INTEGRAL_TIME = 0.25
"""Time of the integral of the speed's loop, s."""
_REST_TICKS = 15
"""Ticks for which a joint that slid is left alone, without torque."""
SLIDE = 8e-3
"""Sliding distance before an experiment, rad: beyond any presliding, so that it removes the memory of earlier
motion."""
_LEVELS = (
    (0.85, 0.25, 0.6, 0.25, 0.85, 0.0),
    (0.8, 0.1, 0.5, 0.3, 0.5, 0.1, 0.8, 0.0),
    (0.9, 0.4, 0.75, 0.4, 0.9, 0.0),
    (0.5, 0.0, 0.3, 0.1, 0.3, 0.0, 0.7, 0.0),
    (0.75, 0.5, 0.65, 0.5, 0.88, 0.0, 0.4, 0.0),
)
"""Where blocks of loops turn round, in parts of the break-away torque: large loops with inner ones, which begin and end
at the same torque, so that a law with a memory of its own closes them there."""
_LEVELS_THROUGH_ZERO = (
    (0.85, -0.85, 0.85, -0.85, 0.0),
    (0.8, -0.5, 0.3, -0.5, 0.8, -0.8, 0.0),
    (0.9, -0.9, 0.4, -0.4, 0.4, -0.9, 0.0),
    (-0.85, 0.85, -0.3, 0.6, -0.3, 0.85, -0.85, 0.0),
    (0.5, -0.5, 0.75, -0.75, 0.88, -0.88, 0.0),
)
"""The same for torque of both signs, in parts of each direction's break-away torque: whole loops with inner ones."""

Profile: TypeAlias = Generator[int, Sample, None]
"""Yields the code to put on the DAC, and is sent the reading that follows."""


@dataclass(frozen=True, eq=False)
class Trace:
    """Readings of one experiment, joint side.

    Attributes:
        label: name of the experiment in messages and plots.
        time: of each reading, s, from 0, shape (n,).
        counts: of the encoder, from 0, shape (n,).
        code: on the DAC at the reading, shape (n,).
        angle_step: angle of a count, rad.
        torque_step: torque of a code, Nm.
        tick: period of the readings, s.
    """

    label: str
    time: Array
    counts: Array
    code: Array
    angle_step: float
    torque_step: float
    tick: float

    @classmethod
    def of(cls, label: str, samples: list[Sample], rig: Rig) -> Trace:
        """Return the readings of an experiment on a rig."""
        ticks, counts, code, _ = sample_columns(samples)
        time = (ticks - ticks[0]) * rig.tick
        return cls(label, time, counts - counts[0], code, rig.joint_step, rig.joint_code, rig.tick)

    @property
    def mirrored(self) -> Trace:
        """Return the same readings counted the other way."""
        return replace(self, counts=-self.counts, code=-self.code)

    @property
    def held(self) -> Array:
        """Return the mean of the motor's torque at the joint over the tick before each reading, Nm, shape (n,)."""
        torque = self.code * self.torque_step
        return DAC_DELAY * np.concatenate((torque[:1], torque[:-1])) + (1.0 - DAC_DELAY) * torque

    def write(self, path: Path) -> None:
        """Write the readings as CSV.

        Raises:
            Rx90Error: if the file cannot be written.
        """
        comment = f"{self.label}; a count is {self.angle_step!r} rad, a code {self.torque_step!r} Nm"
        whole = {"counts": self.counts.astype(int).tolist(), "code": self.code.astype(int).tolist()}
        write_table(path, comment, {"time": [f"{time:.6g}" for time in self.time], **whole})


def follow(
    client: RigClient, profile: Profile, label: str, on_sample: Callable[[Sample], None] = lambda _: None
) -> Trace:
    """Arm the rig, follow the profile to its end, switch the rig off and return the readings.

    A motion that comes near the limits of travel or speed is ended there. The rig is stopped when this raises.

    Raises:
        RigError: refused, faulted, lost or reset.
    """
    samples: list[Sample] = []
    with armed(client):
        code = next(profile)
        with contextlib.suppress(StopIteration):  # the profile's end
            while not last_near_limits(client.rig, samples):
                client.send_torque(code)
                received: list[Sample] = []
                while not received:
                    received = client.pump()
                for sample in received:
                    refuse_fault(sample)
                    if sample.report.result != CommandResult.OK:
                        raise RigRefusedError(f"TORQUE: {sample.report.result_text}")
                    if sample.report.state != State.ARMED:
                        raise RigError("the experiment was stopped before its end")
                    samples.append(sample)
                    on_sample(sample)
                    code = profile.send(sample)
        client.request(Command.STOP)
    return Trace.of(label, samples, client.rig)


def mirrored(profile: Profile) -> Profile:
    """Follow a profile backward: its codes and counts change their signs."""
    code = next(profile)
    with contextlib.suppress(StopIteration):  # the profile's end
        while True:
            sample = yield -code
            code = profile.send(replace(sample, counts=-sample.counts))


def ramp(rate: float, counts: float, limit: int) -> Profile:
    """Raise the torque by `rate` codes a tick until the joint has moved by so many counts, or up to `limit`."""
    first = yield 0
    ticks = code = 0
    while code < limit:
        ticks += 1
        code = min(round(ticks * rate), limit)
        if (yield code).counts - first.counts >= counts:
            break
    for _ in range(_REST_TICKS):
        yield 0


def after_slide(start: int, counts: float, limit: int, codes: Iterable[int]) -> Profile:
    """Slide the joint by so many counts, by a code more a tick from `start` on; let it rest; then follow the codes.

    Raises:
        IdentificationError: if it has not slid at `limit`.
    """
    code = start
    first = yield code
    while (yield code).counts - first.counts < counts:
        code = _raised(code, limit)
    for code in (*[0] * _REST_TICKS, *codes):  # not `yield from`: a list cannot be sent readings
        yield code


def _raised(code: int, limit: int) -> int:
    """Return the next code for a joint that does not move yet, though it broke away before."""
    if code >= limit:
        raise IdentificationError(f"the joint sticks at the highest code, {limit}, though it slid on the ramps")
    return code + 1


def loop_codes(break_away: int, block: int, stride: int, backward: int | None = None) -> Iterator[int]:
    """Yield the codes of a block of loops below break-away, in strides of so many codes, each held for a dwell.

    Args:
        break_away: code at which the joint breaks away.
        block: number of the block.
        stride: codes.
        backward: size of the code at which it breaks away backward; None for loops that do not go through zero.
    """
    code, levels = 0, _LEVELS if backward is None else _LEVELS_THROUGH_ZERO
    for share in levels[block % len(levels)]:
        level = math.floor(share * break_away) if share >= 0.0 else -math.floor(-share * (backward or 0))
        while code != level:
            code += max(-stride, min(stride, level - code))
            yield from [code] * DWELL_TICKS


def cycle_codes(low: int, high: int, half: int, number: int) -> Iterator[int]:
    """Yield codes up to `low`, then so many cycles of `high` and `low`, each for `half` ticks."""
    for code in range(low + 1):
        yield from [code] * 2
    for _ in range(number):
        yield from [high] * half + [low] * half


class Rounding:
    """Rounds torques to codes so that the errors do not add up: each is carried to the next code."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._carried = 0.0

    def __call__(self, code: float) -> int:
        """Return the whole code; beyond the amplifier's range its end."""
        wanted = min(max(code + self._carried, 0.0), float(self._limit))
        self._carried = wanted - round(wanted)
        return round(wanted)


def speeds(start: int, wanted: Sequence[float], ticks: int, gain: float, limit: int, tick: float) -> Profile:
    """Hold one speed after the other, each for so many ticks, by a PI loop on the counts.

    Args:
        start: a code at which the joint does not slide yet.
        wanted: speeds, counts per tick.
        ticks: for each of them.
        gain: proportional gain, codes for a count per tick; the integral's time is INTEGRAL_TIME.
        limit: the highest code.
        tick: s.

    Raises:
        IdentificationError: if the joint does not move at `limit`.
    """
    rounding = Rounding(limit)
    code = start
    before = yield code
    while (sample := (yield code)).counts - before.counts < wanted[0]:
        before, code = sample, _raised(code, limit)
    integral = float(code)
    for speed in wanted:
        for _ in range(ticks):
            error = speed - (sample.counts - before.counts) / (sample.tick - before.tick)
            integral += gain * error * tick / INTEGRAL_TIME
            before, sample = sample, (yield rounding(integral + gain * error))


def pulled(stiffness: float, speed: float, ticks: int, limit: int, preload: float) -> Profile:
    """Pull the joint by a spring whose other end moves at a steady speed; the host computes the spring.

    Args:
        stiffness: codes for a count.
        speed: counts per tick.
        ticks: how long.
        limit: the highest code.
        preload: code at the beginning.
    """
    rounding = Rounding(limit)
    first = sample = yield 0
    end = preload / stiffness
    for _ in range(ticks):
        end += speed
        sample = yield rounding(stiffness * (end - (sample.counts - first.counts)))
