"""The linear model of excitation runs, against Pinocchio, direct convolution and random arms with known parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitation_arms import Array, all_columns, plain_arm, rigid_arm, runs_of, standard_values, truth

from benchmarks.excitation_runs import NOTHING
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation import filtering
from rx90_emulator.identification.excitation.filtering import Bandwidths
from rx90_emulator.identification.excitation.least_squares import solve
from rx90_emulator.identification.excitation.payload import Payload
from rx90_emulator.identification.excitation.problem import (
    BaseGroups,
    ExcitationProblem,
    StandardColumns,
    described_inertials,
    element_states,
)
from rx90_emulator.identification.excitation.result import undetermined


@pytest.mark.parametrize(("seed", "joints", "coupled"), [(3, 4, True), (5, 3, False)])
def test_exact_runs_give_back_every_base_parameter(seed: int, joints: int, coupled: bool, tmp_path: Path) -> None:
    """Without noise the base parameters are the groups of the true standard ones, and friction is the true one."""
    arm = plain_arm(seed, joints, coupled=coupled)
    problem = ExcitationProblem.of(
        rigid_arm(arm, tmp_path), runs_of(arm, 400.0, NOTHING, Bandwidths(100.0, 20.0), periods=1)
    )
    _, columns = all_columns(problem)
    fit = solve(problem, columns)
    expected = truth(problem, arm)
    assert fit.determined.all()
    assert undetermined(problem, fit) == ()
    assert fit.value == pytest.approx(expected, abs=2e-3 * float(np.abs(expected).max()))


def test_base_parameters_are_as_many_as_the_torque_tells(tmp_path: Path) -> None:
    """Their number is the rank of the columns by singular values, and their torque is that of all parameters."""
    arm = replace(plain_arm(7, 6, coupled=True), spring=np.array([0.0, 30.0, 0.0, 0.0, 0.0, 0.0]))
    columns = StandardColumns(rigid_arm(arm, tmp_path))
    base = BaseGroups.of(columns)
    motion = np.random.default_rng(1).uniform(-2.0, 2.0, (3, 80, 6))
    torque = columns.torque(*motion)
    values = np.linalg.svd(torque.reshape(-1, torque.shape[2]), compute_uv=False)
    assert len(base.leading) == int(np.sum(values > 1e-9 * values[0]))
    parameters = base.combination @ standard_values(arm)
    assert torque[:, :, base.leading] @ parameters == pytest.approx(arm.frictionless(*motion), abs=1e-8)


def two_links(folder: Path, first: float, second: float) -> BaseGroups:
    """Return the groups of two links 0.5 m apart, each turned about x by an angle, rad."""
    links = "".join(
        f'<link name="{name}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        f'</inertial></link><joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{name}"/>'
        f'<origin xyz="{place} 0 0" rpy="{turn} 0 0"/><axis xyz="0 0 1"/></joint>'
        for name, parent, place, turn in (("a", "base", 0, first), ("b", "a", 0.5, second))
    )
    (folder / "two.urdf").write_text(f'<robot name="two"><link name="base"/>{links}</robot>', encoding="utf-8")
    return BaseGroups.of(StandardColumns(RigidArm.from_urdf(folder / "two.urdf")))


def test_groups_are_said_in_words(tmp_path: Path) -> None:
    """Of two parallel links the second's mass joins the first's inertia and first moment by its lever."""
    base = two_links(tmp_path, np.pi / 2.0, 0.0)
    groups = dict(zip(base.names, base.groups, strict=True))
    assert groups.pop("IzzR_1") == "Izz_1 + 0.25 m_2 + Ia_1"
    assert groups.pop("mxR_1") == "mx_1 + 0.5 m_2"
    assert set(groups) == {"my_1", "mx_2", "my_2", "Izz_2", "Ia_2", "offset_1", "offset_2"}


def test_a_rounded_right_angle_makes_no_parameters(tmp_path: Path) -> None:
    """Upright and level axes with the 1.5708 of many a description have the groups of exact right angles."""
    assert two_links(tmp_path, 0.0, 1.5708).groups == two_links(tmp_path, 0.0, np.pi / 2.0).groups


def test_the_parallel_filter_is_a_convolution_at_the_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values of any shape are low-passed by the run's symmetric taps at its rows, whole or block by block."""
    arm = plain_arm(5, 2, coupled=False)
    (run,) = runs_of(arm, 250.0, NOTHING, Bandwidths(40.0, 11.0))
    values = np.random.default_rng(2).normal(size=(len(run.time), 2, 3))
    direct = np.convolve(values[:, 1, 2], run.taps, mode="same")[run.rows]
    assert run.down > 1
    assert np.array_equal(run.taps, run.taps[::-1])
    filtered = run.parallel(values)
    assert filtered[:, 1, 2] == pytest.approx(direct, abs=1e-12)
    monkeypatch.setattr(filtering, "_BLOCK_SAMPLES", 500)
    parts = [run.parallel(values[samples]) for samples, _ in run.blocks()]
    assert len(parts) > 3
    assert [len(part) for part in parts] == [rows.stop - rows.start for _, rows in run.blocks()]
    assert np.concatenate(parts) == pytest.approx(filtered, abs=1e-12)


def test_rows_leave_out_pauses_and_keep_reversals(tmp_path: Path) -> None:
    """A joint's rows are missing where an element on it pauses, the coupled one among them; a reversal stays."""
    arm = plain_arm(4, 2, coupled=True)
    (run,) = runs_of(arm, 200.0, NOTHING, Bandwidths(40.0, 20.0))
    time = np.arange(len(run.time)) / 200.0
    # Joint 1 turns back at 2 s and pauses after 8 s; joint 2 undoes what joint 1 does from 4 to 6 s.
    first = np.where(time < 8.0, np.cos(np.pi * np.minimum(time, 8.0) / 4.0), 1.0)
    rate = np.gradient(first, time)
    second = np.where((time > 4.0) & (time < 6.0), -rate, 1.0)
    velocity = np.column_stack([rate, second])
    moved = replace(run, time=time, velocity=velocity)
    problem = ExcitationProblem.of(rigid_arm(arm, tmp_path), [moved])
    there = [problem.time[problem.joint == joint] for joint in (0, 1)]
    for times in there:
        assert not np.any((times > 4.0) & (times < 6.0))
    assert not np.any(there[0] > 8.0)
    assert np.any(there[1] > 8.5)
    (turning,) = (problem.time[problem.reversal & (problem.joint == 0) & (problem.time < 3.9)] for _ in (0,))
    assert len(turning) == 0 or np.all(np.abs(np.sin(np.pi * turning / 4.0)) < 0.1)


@pytest.mark.parametrize(
    ("velocity", "out"),
    [
        (lambda t: 2.0 * t**2, True),
        (lambda t: 0.9 * t**2 - 1.6 * t**3, True),
        (lambda t: 6.0 * (t + 1e-4), False),
    ],
    ids=["stops and goes on", "stops, and turns back soon after", "turns back quickly"],
)
def test_a_stop_is_left_out_and_a_quick_reversal_is_not(velocity: Callable[[Array], Array], out: bool) -> None:
    """An element that stops without turning back has no known sign there, one that turns back between samples has."""
    arm = plain_arm(5, 2, coupled=False)
    (run,) = runs_of(arm, 60.0, NOTHING, Bandwidths(18.0, 6.0))
    time = np.arange(len(run.time)) / 60.0 - 5.0
    moved = replace(run, time=time, velocity=np.column_stack([velocity(time), 1.0 + 0.0 * time]))
    rests = element_states(moved, np.eye(2))[0][:, 0]
    nearest = np.argmin(np.abs(time[run.rows]))
    assert rests[nearest] == out
    assert np.mean(rests) < 0.1


def test_a_prior_holds_what_runs_do_not_tell(tmp_path: Path) -> None:
    """With one joint moving alone what belongs to the others is named as undetermined; the description stands in."""
    arm = plain_arm(5, 3, coupled=False)
    rigid = rigid_arm(arm, tmp_path, wrong=0.0)
    (run,) = runs_of(arm, 200.0, NOTHING, Bandwidths(40.0, 20.0))
    still = replace(
        run,
        **{name: getattr(run, name) * np.array([1.0, 0.0, 0.0]) for name in ("position", "velocity", "acceleration")},
    )
    noise = 0.1 * np.random.default_rng(0).normal(size=run.torque.shape)
    torque = arm.frictionless(still.position, still.velocity, still.acceleration) + noise
    problem = ExcitationProblem.of(rigid, [replace(still, torque=torque)])
    columns = problem.regressor
    fit = solve(problem, columns)
    names = undetermined(problem, fit)
    assert "offset_2" in names
    prior = described_inertials(problem.columns, problem.base, 0.1)
    held = solve(problem, columns, prior=prior)
    expected = problem.base.combination @ problem.columns.values()
    links = [k for k, name in enumerate(problem.names) if name.startswith(("mx", "my", "I"))]
    alone = [k for k in links if "Ia" not in problem.base.groups[k]]
    assert held.determined.all()
    assert held.value[alone] == pytest.approx(expected[alone], abs=1e-2 * float(np.abs(expected).max()))


def test_a_known_payload_is_taken_off_the_torque(tmp_path: Path) -> None:
    """With the payload of a run given, its rows hold the torque of the arm alone."""
    arm = plain_arm(6, 3, coupled=False)
    (run,) = runs_of(arm, 200.0, NOTHING, Bandwidths(40.0, 20.0))
    payload = Payload(3.0, (0.1, 0.0, 0.2), 0.01 * np.eye(3))
    last = arm.links[-1]
    body = payload.parameters() + last.parameters
    mass, center = body[0], body[1:4] / body[0]
    about = np.array([[body[4], body[5], body[7]], [body[5], body[6], body[8]], [body[7], body[8], body[9]]])
    inertia = about - mass * (center @ center * np.eye(3) - np.outer(center, center))
    heavy = replace(arm, links=(*arm.links[:-1], replace(last, mass=mass, center=center, inertia=inertia)))
    motion = run.position, run.velocity, run.acceleration
    loaded = replace(run, torque=heavy.frictionless(*motion))
    problem = ExcitationProblem.of(rigid_arm(arm, tmp_path), [loaded], payloads=[payload])
    bare = problem.rows_of([arm.frictionless(*motion)[:, :, None]])[:, 0]
    assert problem.torque == pytest.approx(bare, abs=1e-8)
    assert np.abs(problem.payload).max() > 1.0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((0.0, (0, 0, 0), np.eye(3)), "payload of 0.0 kg; accepted: a mass above 0"),
        ((1.0, (0, 0), np.eye(3)), "accepted: 3 numbers"),
        ((1.0, (0, 0, 0), np.eye(3) + 0.1 * np.tri(3)), "accepted: a symmetric 3 x 3 matrix"),
        ((1.0, (0, 0, 0), np.diag([1.0, 1.0, 3.0])), "none above the sum of the others"),
    ],
)
def test_a_payload_that_no_body_is_is_refused(given: tuple, said: str) -> None:  # type: ignore[type-arg]
    """Mass, centre and inertia are checked where they are given."""
    with pytest.raises(IdentificationError, match=said):
        Payload(*given)
