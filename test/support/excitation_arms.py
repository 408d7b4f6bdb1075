"""Random arms with Coulomb and viscous friction, their filtered runs, and what is true of them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.excitation_runs import Disturbances, FourierMotion, measured
from benchmarks.random_arms import FrictionLaw, SyntheticArm, random_arm
from rx90_common.base.arrays import Array
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.rows.excitation import ExcitationProblem
from rx90_emulator.identification.rows.filtering import Bandwidths, FilteredRun, filter_record


def plain_arm(seed: int, joints: int, *, coupled: bool) -> SyntheticArm:
    arm = random_arm(seed, joints, coupled=coupled, stribeck=False)
    laws = tuple(FrictionLaw((law.coulomb, law.coulomb), law.c2) for law in arm.friction)
    return replace(arm, friction=laws)


def rigid_arm(arm: SyntheticArm, folder: Path, wrong: float = 0.5) -> RigidArm:
    urdf = folder / "arm.urdf"
    urdf.write_text(arm.urdf(wrong), encoding="utf-8")
    return RigidArm.from_urdf(urdf, coupling=arm.coupling, spring=arm.spring)


def standard_values(arm: SyntheticArm) -> Array:
    return np.concatenate([arm.link_parameters, arm.rotor, arm.spring[arm.spring != 0.0], arm.offset])


def runs_of(
    arm: SyntheticArm,
    rate: float,
    disturbances: Disturbances,
    bandwidths: Bandwidths | None = None,
    seeds: Sequence[int] = (0,),
    periods: int = 2,
) -> tuple[FilteredRun, ...]:
    made = [measured(arm, FourierMotion.random(arm, k, periods=periods), rate, k, disturbances) for k in seeds]
    records = [run.record(arm) for run in made]
    chosen = bandwidths or Bandwidths.of(records)
    return tuple(part for record in records for part in filter_record(record, chosen))


def truth(problem: ExcitationProblem, arm: SyntheticArm) -> tuple[Array, Array]:
    friction = [value for law in arm.friction for value in (law.coulomb, law.c2)]
    return problem.base.combination @ standard_values(arm), np.array(friction)
