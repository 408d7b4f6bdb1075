"""What follows from all ramps of a measurement: friction without and with the joint, and the joint's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from friction_bench.experiment.four_way import FourWay, compare
from friction_bench.experiment.identification import (
    JointFrictionEstimate,
    RampIdentification,
    identify_ramps,
    joint_friction,
    slopes_of,
)
from friction_bench.experiment.ramp_model import RampModel
from friction_bench.experiment.record import RampRecord
from friction_bench.rig.rig_file import Rig


@dataclass(frozen=True)
class RampTestResult:
    """The result of a measurement; each part None where it was not run."""

    unloaded: RampIdentification | None
    loaded: RampIdentification | None
    joint: JointFrictionEstimate | None
    comparison: FourWay | None

    @property
    def parts(self) -> list[tuple[str, RampIdentification]]:
        """Return the identified loads by name."""
        both = (("no-load", self.unloaded), ("loaded", self.loaded))
        return [(name, part) for name, part in both if part is not None]


def evaluate(records: Sequence[RampRecord], rig: Rig) -> RampTestResult:
    """Identify friction from all ramps of a measurement, and compare one ramp with the models.

    Raises:
        IdentificationError: if a ramp does not carry an estimate.
    """
    parts: dict[bool, RampIdentification] = {}
    for loaded in (False, True):
        chosen = [record for record in records if record.loaded is loaded]
        if chosen:
            parts[loaded] = identify_ramps(chosen, rig.scale_uncertainty)
    joint = joint_friction(parts[False], parts[True], rig) if len(parts) == 2 else None
    last = parts[max(parts)] if parts else None
    return RampTestResult(parts.get(False), parts.get(True), joint, _comparison(last, rig) if last else None)


def _comparison(part: RampIdentification, rig: Rig) -> FourWay | None:
    """Compare the first ramp of the slowest slope; without an identified inertia there is no model of it."""
    best = part.best
    if best.inertia is None or best.inertia.value <= 0.0:
        return None
    slowest = slopes_of(part.fits)[0]
    fit = min(part.fits, key=lambda f: abs(f.slope - slowest))
    model = RampModel(best.coulomb.value, best.viscous.value, best.inertia.value, fit.slope)
    return compare(fit.record, model, rig.gear_ratio)
