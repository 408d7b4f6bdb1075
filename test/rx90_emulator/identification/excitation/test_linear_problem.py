"""The linear model of excitation runs, against Pinocchio, direct convolution and random arms with known parameters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.excitation_runs import NOTHING, Disturbances, FourierMotion, measured
from benchmarks.friction_equations import FrictionLaw
from benchmarks.random_arms import SyntheticArm, random_arm
from rx90_emulator.identification.excitation.base_groups import BaseGroups
from rx90_emulator.identification.excitation.columns import StandardColumns
from rx90_emulator.identification.excitation.coulomb_viscous import coulomb_viscous
from rx90_emulator.identification.excitation.filtering import Bandwidths, FilteredRun, filter_record
from rx90_emulator.identification.excitation.least_squares import LinearFit, solve
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.model.rigid_arm import RigidArm


def plain_arm(seed: int, joints: int, *, coupled: bool) -> SyntheticArm:
    """Return a random arm whose friction is Coulomb and viscous."""
    arm = random_arm(seed, joints, coupled=coupled, stribeck=False)
    laws = tuple(FrictionLaw((law.coulomb, law.coulomb), law.c2) for law in arm.friction)
    return replace(arm, friction=laws)


def rigid_arm(arm: SyntheticArm, folder: Path) -> RigidArm:
    """Return the arm as the identification knows it: kinematics and couplings, wrong masses."""
    urdf = folder / "arm.urdf"
    urdf.write_text(arm.urdf(wrong=0.5), encoding="utf-8")
    return RigidArm.from_urdf(urdf, coupling=arm.coupling, spring=arm.spring)


def standard_values(arm: SyntheticArm) -> np.ndarray:
    """Return the true standard parameters: links, rotors, springs, offsets."""
    return np.concatenate([arm.link_parameters, arm.rotor, arm.spring[arm.spring != 0.0], arm.offset])


def runs_of(arm: SyntheticArm, rate: float, disturbances: Disturbances, bandwidths: Bandwidths | None = None,
            count: int = 1) -> tuple[FilteredRun, ...]:  # fmt: skip
    """Return filtered runs."""
    made = [measured(arm, FourierMotion.random(arm, k), rate, k, disturbances).record(arm) for k in range(count)]
    chosen = bandwidths or Bandwidths.of(made)
    return tuple(run for record in made for run in filter_record(record, chosen))


def fitted(problem: ExcitationProblem) -> tuple[tuple[str, ...], LinearFit]:
    """Return the names of all parameters and the fit with Coulomb and viscous friction."""
    names, columns = coulomb_viscous(problem)
    return problem.names + names, solve(problem, np.hstack([problem.regressor, columns]))


@pytest.mark.parametrize(("seed", "joints", "coupled"), [(3, 4, True), (5, 3, False)])
def test_exact_runs_give_back_every_base_parameter(seed: int, joints: int, coupled: bool, tmp_path: Path) -> None:
    """Without noise the base parameters are the groups of the true standard ones, and friction is the true one."""
    arm = plain_arm(seed, joints, coupled=coupled)
    problem = ExcitationProblem.of(rigid_arm(arm, tmp_path), runs_of(arm, 500.0, NOTHING, Bandwidths(100.0, 20.0)))
    _, fit = fitted(problem)
    friction = [value for law in arm.friction for value in (law.coulomb, law.c2)]
    truth = np.append(problem.base.combination @ standard_values(arm), friction)
    assert fit.determined.all()
    assert fit.value == pytest.approx(truth, abs=2e-3 * float(np.abs(truth).max()))


def test_base_parameters_are_as_many_as_the_torque_tells(tmp_path: Path) -> None:
    """Their number is the rank of the columns by singular values, and their torque is that of all parameters."""
    arm = plain_arm(7, 6, coupled=True)
    columns = StandardColumns(rigid_arm(arm, tmp_path))
    base = BaseGroups.of(columns)
    motion = np.random.default_rng(1).uniform(-2.0, 2.0, (3, 80, 6))
    torque = columns.torque(*motion)
    values = np.linalg.svd(torque.reshape(-1, torque.shape[2]), compute_uv=False)
    assert len(base.leading) == int(np.sum(values > 1e-9 * values[0]))
    standard = standard_values(replace(arm, spring=np.zeros(6)))
    expected = replace(arm, spring=np.zeros(6)).frictionless(*motion)
    assert torque[:, :, base.leading] @ (base.combination @ standard) == pytest.approx(expected, abs=1e-8)


def test_groups_are_said_in_words(tmp_path: Path) -> None:
    """Two rods about parallel axes, 1 m apart: the second mass joins the first link's group with its lever squared."""
    (tmp_path / "two.urdf").write_text(
        '<robot name="two"><link name="base"/>'
        + "".join(
            f'<link name="{name}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
            f'iyz="0"/></inertial></link><joint name="{name}" type="continuous"><parent link="{parent}"/>'
            f'<child link="{name}"/><origin xyz="{place} 0 0"/><axis xyz="0 0 1"/></joint>'
            for name, parent, place in (("a", "base", 0), ("b", "a", 0.5))
        )
        + "</robot>",
        encoding="utf-8",
    )
    base = BaseGroups.of(StandardColumns(RigidArm.from_urdf(tmp_path / "two.urdf")))
    groups = dict(zip(base.names, base.groups, strict=True))
    assert groups["IzzR_1"] == "Izz_1 + 0.25 m_2 + Ia_1"
    assert {"mx_2", "my_2", "Izz_2", "Ia_2", "offset_1", "offset_2"} == set(groups) - {"IzzR_1"}


def test_the_parallel_filter_is_a_convolution_at_the_rows() -> None:
    """Values of any shape are low-passed by the run's symmetric taps, at the run's rows and whole in one block each."""
    arm = plain_arm(5, 2, coupled=False)
    (run,) = runs_of(arm, 250.0, NOTHING, Bandwidths(40.0, 11.0))
    values = np.random.default_rng(2).normal(size=(len(run.time), 2, 3))
    direct = np.convolve(values[:, 1, 2], run.taps, mode="same")[run.rows]
    assert run.down > 1
    assert np.array_equal(run.taps, run.taps[::-1])
    filtered = run.parallel(values)
    assert filtered[:, 1, 2] == pytest.approx(direct, abs=1e-12)
    parts = [run.parallel(values[samples]) for samples, _ in run.blocks()]
    assert np.concatenate(parts) == pytest.approx(filtered, abs=1e-12)
