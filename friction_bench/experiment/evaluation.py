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
from rx90_common.base.errors import IdentificationError


@dataclass(frozen=True)
class RampTestResult:
    """The result of a measurement; each part None where it was not run."""

    unloaded: RampIdentification | None
    loaded: RampIdentification | None
    joint: JointFrictionEstimate | None
    comparison: FourWay | None
    failures: tuple[str, ...] = ()
    """Why a load that was run carries no estimate, one line each."""

    @property
    def parts(self) -> list[tuple[str, RampIdentification]]:
        """Return the identified loads by name."""
        both = (("no-load", self.unloaded), ("loaded", self.loaded))
        return [(name, part) for name, part in both if part is not None]


def evaluate(records: Sequence[RampRecord], rig: Rig) -> RampTestResult:
    """Identify friction from all ramps of a measurement, and compare one ramp with the models.

    Raises:
        IdentificationError: if no load carries an estimate.
    """
    parts: dict[bool, RampIdentification] = {}
    failures = []
    for loaded in (False, True):
        chosen = [record for record in records if record.loaded is loaded]
        try:
            if chosen:
                parts[loaded] = identify_ramps(chosen, rig.scale_uncertainty)
        except IdentificationError as error:
            failures.append(str(error))
    if not parts:
        raise IdentificationError(failures[0] if failures else "no ramp to identify from")
    joint = joint_friction(parts[False], parts[True], rig) if len(parts) == 2 else None
    comparison = _comparison(parts[max(parts)], rig)
    return RampTestResult(parts.get(False), parts.get(True), joint, comparison, tuple(failures))


def _comparison(part: RampIdentification, rig: Rig) -> FourWay | None:
    """Compare the first ramp of the slowest slope; without an identified inertia there is no model of it."""
    best = part.best
    if best.inertia is None or best.inertia.value <= 0.0:
        return None
    slowest = slopes_of(part.ramps)[0]
    ramp = min(part.ramps, key=lambda r: abs(r.slope - slowest))
    release = max(ramp.break_away * ramp.slope - best.coulomb.value, 0.0)
    model = RampModel(best.coulomb.value, best.viscous.value, best.inertia.value, ramp.slope, release)
    return compare(ramp.record, model, rig.gear_ratio)
