"""The whole measurement: n repeats at some slopes, no-load and loaded, and what follows from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from friction_bench.experiment.four_way import FourWay, compare
from friction_bench.experiment.identification import (
    Identification,
    JointFrictionEstimate,
    identify,
    joint_friction,
    slopes_of,
)
from friction_bench.experiment.ramp import run_ramp
from friction_bench.experiment.ramp_model import RampModel
from friction_bench.experiment.record import RampRecord
from friction_bench.rig.client import RigClient, Sample
from friction_bench.rig.rig_file import Rig
from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.rates import NANOSECONDS


@dataclass(frozen=True)
class Plan:
    """What to run: slopes Nm/s, repeats, and the end torque, Nm, with and without the joint."""

    slopes: tuple[float, ...]
    repeats: int
    end_torque: float
    end_torque_loaded: float

    def end(self, loaded: bool) -> float:
        """Return the end torque under this load, Nm."""
        return self.end_torque_loaded if loaded else self.end_torque

    def duration(self, loaded: bool) -> float:
        """Return the time of all ramps under this load, s."""
        return self.repeats * sum(self.end(loaded) / slope for slope in self.slopes)


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


def run_series(
    client: RigClient,
    plan: Plan,
    loaded: bool,
    readings: Readings,
    on_progress: Callable[[float, str], None],
    on_record: Callable[[RampRecord], None],
) -> None:
    """Run all ramps under one load.

    Args:
        client: greeted.
        plan: slopes, repeats and end torques.
        loaded: whether the joint is coupled.
        readings: takes every reading.
        on_progress: called with seconds of ramp time done since the last call, and what is running.
        on_record: called with each ramp as soon as it is done.

    Raises:
        RigError: refused, faulted, lost or reset.
    """

    def take(sample: Sample) -> None:
        readings.samples.append(sample)
        on_progress(client.rig.tick, label)

    for repeat in range(plan.repeats):
        for slope in plan.slopes:
            label = f"{'loaded' if loaded else 'no-load'} {slope:g} Nm/s #{repeat + 1}"
            on_record(run_ramp(client, slope, plan.end(loaded), loaded, label, take))


@dataclass(frozen=True)
class Result:
    """What a measurement says; each part None where it was not run."""

    unloaded: Identification | None
    loaded: Identification | None
    joint: JointFrictionEstimate | None
    comparison: FourWay | None

    @property
    def parts(self) -> list[tuple[str, Identification]]:
        """Return the identified loads by name."""
        both = (("no-load", self.unloaded), ("loaded", self.loaded))
        return [(name, part) for name, part in both if part is not None]


def evaluate(records: Sequence[RampRecord], rig: Rig) -> Result:
    """Identify friction from all ramps of a measurement, and compare one ramp with the models.

    Raises:
        IdentificationError: if a ramp does not carry an estimate.
    """
    parts: dict[bool, Identification] = {}
    for loaded in (False, True):
        chosen = [record for record in records if record.loaded is loaded]
        if chosen:
            parts[loaded] = identify(chosen, rig.scale_uncertainty)
    joint = None
    if len(parts) == 2:
        joint = joint_friction(
            parts[False],
            parts[True],
            rig.scale_uncertainty,
            rig.gear_ratio,
            rig.gear_efficiency,
            rig.efficiency_uncertainty,
        )
    last = parts[max(parts)] if parts else None
    return Result(parts.get(False), parts.get(True), joint, _comparison(last, rig) if last else None)


def _comparison(part: Identification, rig: Rig) -> FourWay | None:
    """Compare the first ramp of the slowest slope; without an identified inertia there is no model of it."""
    best = part.best
    if best.inertia is None or best.inertia.value <= 0.0:
        return None
    slowest = slopes_of(part.fits)[0]
    fit = min(part.fits, key=lambda f: abs(f.slope - slowest))
    model = RampModel(best.coulomb.value, best.viscous.value, best.inertia.value, fit.slope)
    return compare(fit.record, model, rig.gear_ratio)
