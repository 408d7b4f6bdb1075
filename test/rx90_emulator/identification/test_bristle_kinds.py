"""The kind of a joint's bristles from micro-motions whose truth is known."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from foreign_arms import urdf_text
from numpy.typing import NDArray
from scipy import stats

from benchmarks.bristles import led
from rx90_common.friction import FrictionElement
from rx90_common.friction.parts.bristles import BristlesPart, ElastoPlastic, MaxwellSlip
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.estimates import PARAMETERS, IdentifiedElement, ParameterEstimate
from rx90_emulator.identification.identify import FrictionIdentification
from rx90_emulator.identification.output.friction_file import friction_text
from rx90_emulator.identification.presliding import kinds as kinds_module
from rx90_emulator.identification.presliding.bristle_motion import JointGroup, KindFamily, KindMotion
from rx90_emulator.identification.presliding.fit import MovedGroup, PreslidingFit
from rx90_emulator.identification.presliding.kinds import (
    GroupFit,
    KindChoice,
    KindTrial,
    choose_kinds,
    choose_kinds_of,
    jackknife_estimates,
    kind_steps,
    steps_of,
)
from rx90_emulator.identification.presliding.micro_motion import MicroMotion
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.sliding.fit import SlidingFit
from rx90_emulator.identification.sliding.quality import CurvePoints

ELEMENT = FrictionElement(25.0, 25.0, 28.0, 28.0, 0.05, 1.0, 1e5, 100.0, 14.0, 1.0)
STEP, COUNT, MASS = 1e-3, 1600, np.array([[4.0, 1.0], [1.0, 3.0]])
FAMILIES = (KindFamily(), KindFamily(elastic=True), KindFamily(blocks=2))
ONE, WRIST = np.eye(1), np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
"""Velocities of a joint to that of its element, and of two joints to those of three, the third turning with both."""
BLOCKS = MaxwellSlip((0.6, 0.4), (0.25, 0.75), 5000.0)
Array = NDArray[np.float64]
Kinds = tuple[BristlesPart | None, ...]

NO_CURVE = CurvePoints(*[np.zeros(0)] * 5, np.zeros((3, 0)))


def micro_motions(
    coupling: Array,
    kinds: Kinds,
    sizes: tuple[float, ...],
    noise: float,
    directions: Sequence[Sequence[float]] = ((1.0,),),
    seed: int = 3,
) -> list[MicroMotion]:
    """Return motions of three tones of joints whose elements have such bristles.

    Args:
        coupling: velocities of the joints to those of the elements.
        kinds: of the elements' bristles.
        sizes: amplitudes in parts of tau_c / c0; at 1 an element comes near to break-away.
        noise: of the torques, Nm.
        directions: of the joints, each with all sizes.
        seed: of phases and noise.
    """
    rng, found, joints = np.random.default_rng(seed), [], coupling.shape[1]
    time, mass = np.arange(COUNT) * STEP, MASS[:joints, :joints]
    elements = [replace(ELEMENT, bristles=kind) for kind in kinds]
    for direction, size in itertools.product(directions, sizes):
        position: Array = np.zeros((COUNT, joints))
        for hz in (3.0, 9.0, 19.0):
            phase = rng.uniform(0.0, 2.0 * np.pi) + 0.3 * np.arange(joints)
            position += size * 2.5e-4 / 3.0 * np.sin(2.0 * np.pi * hz * time[:, None] + phase) * direction
        velocity = np.diff(position, axis=0, prepend=position[:1]) / STEP
        acceleration = np.gradient(velocity, STEP, axis=0)
        inputs = velocity @ coupling.T
        torques = [led(one, np.ascontiguousarray(inputs[:, n]), STEP)[0] for n, one in enumerate(elements)]
        drive = np.column_stack(torques) @ coupling + acceleration @ mass.T
        drive += noise * rng.standard_normal(drive.shape)
        record = JointRecord(("a", "b")[:joints], time, *np.zeros((3, COUNT, joints)), Path("bag"), "digest")
        group, interval = tuple(range(joints)), (0.0, COUNT * STEP)
        found.append(MicroMotion(group, STEP, position, velocity, acceleration, drive, mass, record, interval))
    return found


def numbers_of(bristles: BristlesPart) -> dict[str, float]:
    """Return the numbers of bristles by the names that estimates have."""
    return {f"bristles.{name}": value for name, value in bristles.numbers().items()}


def chosen(
    coupling: Array, kinds: Kinds, sizes: tuple[float, ...], families: Sequence[KindFamily] = FAMILIES, **more: Any
) -> list[KindChoice]:
    """Return what is found of elements with such bristles; further arguments are those of `choose_kinds_of`."""
    apart = ((1.0, 0.2), (0.2, 1.0), (1.0, -0.8))
    directions, seed = (((1.0,),), 3) if len(kinds) == 1 else (apart, 7)
    motions = micro_motions(coupling, kinds, sizes, 0.2, directions, seed)
    compared = [KindMotion.of(motion, coupling, [ELEMENT] * len(kinds)) for motion in motions]
    return choose_kinds_of(compared, np.full(len(kinds), 0.9e5), families, **more)


@pytest.mark.parametrize(
    ("bristles", "kind"),
    [
        (None, "LuGre"),
        (ElastoPlastic(0.45), "elasto-plastic"),
        (MaxwellSlip((0.6, 0.4), (0.25, 0.75), 5000.0), "Maxwell slip"),
    ],
)
def test_each_kind_is_told_from_the_others(bristles: BristlesPart | None, kind: str) -> None:
    """Motions up to break-away tell each kind, with its stiffness, damping and own numbers."""
    (choice,) = chosen(ONE, (bristles,), (1.1, 0.8, 0.5))
    assert choice.kind == kind, [(trial.family.name, trial.missed, trial.behind) for trial in choice.trials]
    (best,) = choice.possible
    assert choice.best is best
    assert choice.margin == min(trial.behind for trial in choice.trials if trial is not best) > 3.0
    assert best.estimates["c0"].value == pytest.approx(1e5, rel=0.05)
    assert best.estimates["c1"].value == pytest.approx(100.0, rel=0.2)
    truth = {"c0": 1e5, "c1": 100.0} | ({} if bristles is None else numbers_of(bristles))
    for name, estimate in best.estimates.items():
        if name == "bristles.attraction":
            assert not estimate.identifiable
        else:
            assert abs(estimate.value - truth[name]) < 5.0 * estimate.deviation, name
    if isinstance(bristles, ElastoPlastic):
        assert isinstance(best.bristles, ElastoPlastic)
        assert best.bristles.break_away == pytest.approx(0.45, abs=0.1)
    if isinstance(bristles, MaxwellSlip):
        assert isinstance(best.bristles, MaxwellSlip)
        assert best.bristles.stiffness == pytest.approx(bristles.stiffness, abs=0.05)


@pytest.fixture
def hinge(tmp_path: Path) -> RigidArm:
    """Return an arm of one joint."""
    urdf = tmp_path / "hinge.urdf"
    urdf.write_text(urdf_text(["joint_1"], ["0 0 1"], [4.0], "continuous"), encoding="utf-8")
    return RigidArm.from_urdf(urdf)


def presliding(sizes: tuple[float, ...], noise: float) -> PreslidingFit:
    """Return what the fit with LuGre's bristles hands on of micro-motions of one joint."""
    motions = micro_motions(ONE, (None,), sizes, noise)
    group = JointGroup((0,), (0,), np.ones((1, 1)))
    return PreslidingFit((), (), 0, (MovedGroup.of(group, motions, [ELEMENT], np.array([0.9e5])),))


def test_where_the_data_cannot_tell_the_file_has_lugre_and_says_so(
    hinge: RigidArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Motions far below break-away, where every kind is a spring, leave LuGre's bristles and name what is left."""
    monkeypatch.setattr(kinds_module, "FAMILIES", FAMILIES)
    seen: list[str] = []
    kinds = choose_kinds(presliding((0.06, 0.05, 0.04), 0.5), hinge, seen.append)
    assert len(seen) == kind_steps(hinge) == len(FAMILIES)
    (kind,) = kinds
    assert kind.decision == "cannot tell"
    assert kind.trial is None
    assert kind.choice is not None
    left = [trial.family.name for trial in kind.choice.possible]
    assert len(left) > 1
    estimates = dict.fromkeys(PARAMETERS, ParameterEstimate(1.0, 0.1))
    one = IdentifiedElement(ELEMENT, estimates, dict.fromkeys(PARAMETERS, ()))
    sliding = SlidingFit((), (NO_CURVE,), np.zeros(0), np.zeros((0, 0)), 0, quality=(None,))
    result = FrictionIdentification(hinge, (one,), sliding, PreslidingFit(()), kinds=kinds)
    content = yaml.safe_load(friction_text(result))
    element, found = content["elements"]["joint_1"], content["identification"]["bristles"]["joint_1"]
    assert "bristles" not in element
    assert element["note"] == f"bristles: cannot tell: the data do not tell {', '.join(left)} apart"
    assert found["decision"] == "cannot tell"
    assert list(found["tried"]) == [family.name for family in FAMILIES]
    assert found["bags"] == ["bag_1"]
    assert content["identification"]["bags"]["bag_1"]["path"] == "bag"


@pytest.mark.parametrize(("softer", "told"), [(1.0, True), (5.0, False)])
def test_blocks_that_slip_beyond_the_motion_are_not_told(
    hinge: RigidArm, monkeypatch: pytest.MonkeyPatch, softer: float, told: bool
) -> None:
    """A block that slips after several times the travel leaves LuGre's bristles: what it gives there is a guess."""
    seen, reach = (np.zeros(2), np.zeros(2)), 0.5 * (1.0 + np.exp(softer)) * 25.0 / 1e5
    bristles = FAMILIES[2].bristles(np.array([-softer, 0.0]), 25.0)
    others = KindTrial(FAMILIES[0], None, seen, {}, 0.1, 9.0)
    trials = (KindTrial(FAMILIES[2], bristles, seen, {}, 0.01, 0.0, 0.0, reach), others)
    choice = KindChoice(trials, np.array([0.0, 4e-4]))
    monkeypatch.setattr(kinds_module, "choose_kinds_of", lambda *_: [choice])
    (kind,) = choose_kinds(presliding((1.1, 0.8, 0.5), 0.2), hinge)
    assert (kind.decision, kind.trial is None) == (("Maxwell slip", False) if told else ("cannot tell", True))
    if not told:
        assert f"a block would slip only after {1e3 * reach:.2g} mrad" in kind.text


def test_two_motions_are_not_compared(hinge: RigidArm) -> None:
    """A joint with two micro-oscillations, and one without any, keep LuGre's bristles, with the reason."""
    for fit, count in ((presliding((0.5, 0.4), 0.2), 2), (PreslidingFit(()), 0)):
        seen: list[str] = []
        (kind,) = choose_kinds(fit, hinge, seen.append)
        assert kind.text == f"not compared: {count} micro-oscillations; 3 or more tell kinds apart"
        assert len(seen) == kind_steps(hinge)


def test_elements_that_share_joints_are_told_each() -> None:
    """Two elements that turn with the same joint are told with their kinds, stiffness and numbers."""
    kinds, seen = (BLOCKS, ElastoPlastic(0.45)), []
    choices = chosen(WRIST[[0, 2]], kinds, (1.1, 0.6), progress=lambda place, _: seen.append(place))
    assert len(seen) == steps_of(2, FAMILIES) == 9 + 6
    assert [one.kind for one in choices] == ["Maxwell slip", "elasto-plastic"]
    for choice, kind in zip(choices, kinds, strict=True):
        estimates = choice.best.estimates
        assert estimates["c0"].value == pytest.approx(1e5, rel=0.1)
        assert estimates["c1"].value == pytest.approx(100.0, rel=0.3)
        for name, value in ({} if kind is None else numbers_of(kind)).items():
            if name != "bristles.attraction":
                assert estimates[name].value == pytest.approx(value, abs=0.12), name
        measured, fitted = choice.best.seen
        assert np.std(measured - fitted) < 0.1 * np.std(measured)


def test_elements_of_a_wrist_that_hardly_moves_are_not_told() -> None:
    """Motions of a twentieth of break-away, where every kind is a spring, tell no element."""
    choices = chosen(WRIST, (None, ElastoPlastic(0.45), BLOCKS), (0.055, 0.03), FAMILIES[:2])
    assert [one.kind for one in choices] == [None] * 3


def test_deviations_of_few_motions_hold_what_they_say() -> None:
    """For a mean of four values, whose jackknife is its standard error, 1.96 deviations are Student's interval."""
    values = 1e5 + 1e4 * np.array([0.3, -0.9, 1.4, 0.1])
    whole = {"c0": float(values.mean()), "c1": 100.0}
    without = [{"c0": float(np.delete(values, k).mean()), "c1": 100.0} for k in range(4)]
    half = stats.t.interval(0.95, 3, scale=stats.sem(values))[1]
    low, high = jackknife_estimates(whole, without, {"c0": 0.0, "c1": 0.01})["c0"].bounds
    assert (high - low) / 2.0 == pytest.approx(half, rel=1e-3)


def test_the_reach_is_that_of_the_block_that_slips_last() -> None:
    """A block with half of the torque and a share s of the stiffness slips after 0.5 / s of the Coulomb torque / c0."""
    motions = [KindMotion.of(motion, np.eye(1), [ELEMENT]) for motion in micro_motions(ONE, (BLOCKS,), (1.1,), 0.0)]
    fit = GroupFit.of([FAMILIES[2]], motions, np.array([0.9e5]))
    numbers = fit.numbers(0)
    slips = [numbers[f"bristles.share[{k}]"] / numbers[f"bristles.stiffness[{k}]"] for k in range(2)]
    assert fit.reach(0) == pytest.approx(max(slips) * 25.0 / numbers["c0"], rel=1e-12)


def test_blocks_stand_in_the_order_in_which_they_slip() -> None:
    """Bristles of the same blocks in another order are the same, so that fits without one motion each compare."""
    family, shape = KindFamily(blocks=3), np.array([0.7, -0.4, 0.5, -1.1])
    stiffness, share = np.exp([0.0, 0.7, -0.4]), np.exp([0.0, 0.5, -1.1])
    other = np.concatenate([np.log(stiffness[[2, 1, 0]] / stiffness[2])[1:], np.log(share[[2, 1, 0]] / share[2])[1:]])
    one, same = (family.bristles(each, 25.0) for each in (shape, other))
    assert isinstance(one, MaxwellSlip)
    assert isinstance(same, MaxwellSlip)
    assert one.stiffness == pytest.approx(same.stiffness)
    assert one.share == pytest.approx(same.share)
    assert np.all(np.diff(np.divide(one.share, one.stiffness)) > 0.0)
