"""The kind of a joint's bristles from micro-motions whose truth is known, by functions and by the command.

A friction file with other bristles than LuGre's as `--fallback`: they go with its c0.
"""

from __future__ import annotations

import io
import itertools
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from foreign_arms import write_fallback, write_urdf
from hinge_arm import Hinge
from numpy.typing import NDArray
from report_pages import leave_plots_out
from schema_faults import schema_faults
from scipy import stats
from terminal import Terminal

import rx90_emulator as rx
from benchmarks.bristles import led
from rx90_common.base.errors import DONE
from rx90_common.description.coupling import RX_WRIST
from rx90_common.friction import FrictionElement, FrictionSet, load_friction
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.parts.bristles import BristlesPart, ElastoPlastic, MaxwellSlip
from rx90_emulator.cli.frame import run
from rx90_emulator.identification import identify as identification
from rx90_emulator.identification.arm import JointGroup, RigidArm
from rx90_emulator.identification.estimates import SLIDING, ElementEstimate, ParameterEstimate
from rx90_emulator.identification.excitation.result import simulated_elements
from rx90_emulator.identification.experiments.plan import PlanOptions, make_plan
from rx90_emulator.identification.experiments.series import run_on_engine
from rx90_emulator.identification.identify import identify_records
from rx90_emulator.identification.options import RobotOptions
from rx90_emulator.identification.presliding import kinds as kinds_module
from rx90_emulator.identification.presliding.bristle_motion import KindFamily, KindMotion
from rx90_emulator.identification.presliding.fit import MovedGroup, PreslidingFit
from rx90_emulator.identification.presliding.kinds import (
    ElementKind,
    GroupFit,
    KindTrial,
    choose_kinds,
    choose_kinds_of,
    jackknife_estimates,
    kind_steps,
    steps_of,
)
from rx90_emulator.identification.presliding.micro_motion import MicroMotion
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.robot import RecordedRobot
from rx90_emulator.loop.setup import Setup

ELEMENT = FrictionElement(25.0, 25.0, 28.0, 28.0, 0.05, 1.0, 1e5, 100.0, 14.0, 1.0)
STEP, COUNT, MASS = 1e-3, 1600, np.array([[4.0, 1.0], [1.0, 3.0]])
FAMILIES = (KindFamily(), KindFamily(elastic=True), KindFamily(blocks=2))
ONE, SHARED = np.eye(1), np.array([[1.0, 0.0], [1.0, 1.0]])
"""Velocities of a joint to that of its element, and of two joints to those of two, the second turning with both."""
BLOCKS = MaxwellSlip((0.6, 0.4), (0.25, 0.75), 5000.0)
Array = NDArray[np.float64]
Kinds = tuple[BristlesPart | None, ...]


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
) -> list[ElementKind]:
    """Return what is found of elements with such bristles; further arguments are those of `choose_kinds_of`."""
    apart = ((1.0, 0.2), (0.2, 1.0), (1.0, -0.8))
    directions, seed = (((1.0,),), 3) if len(kinds) == 1 else (apart, 7)
    motions = micro_motions(coupling, kinds, sizes, 0.2, directions, seed)
    compared = [KindMotion.of(motion, coupling, [ELEMENT] * len(kinds)) for motion in motions]
    return choose_kinds_of(compared, np.full(len(kinds), 0.9e5), "abc"[: len(kinds)], families, **more)


@pytest.mark.parametrize(
    ("bristles", "kind"),
    [
        (None, "LuGre"),
        (ElastoPlastic(0.45), "elasto-plastic"),
        (BLOCKS, "Maxwell slip"),
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
def single(tmp_path: Path) -> RigidArm:
    """Return an arm of one joint."""
    return RigidArm.from_urdf(write_urdf(tmp_path, ["joint_1"], ["0 0 1"], [4.0], "continuous"))


def presliding(sizes: tuple[float, ...], noise: float) -> PreslidingFit:
    """Return what the fit with LuGre's bristles hands on of micro-motions of one joint."""
    motions = micro_motions(ONE, (None,), sizes, noise)
    group = JointGroup((0,), (0,), np.ones((1, 1)))
    return PreslidingFit((), (), 0, (MovedGroup.of(group, motions, [ELEMENT], np.array([0.9e5])),))


def test_where_the_data_cannot_tell_lugres_bristles_stay(single: RigidArm, monkeypatch: pytest.MonkeyPatch) -> None:
    """Motions far below break-away, where every kind is a spring, leave LuGre's bristles and name what is left."""
    monkeypatch.setattr(kinds_module, "FAMILIES", FAMILIES)
    seen: list[str] = []
    kinds = choose_kinds(presliding((0.06, 0.05, 0.04), 0.5), single, seen.append)
    assert len(seen) == kind_steps(single) == len(FAMILIES)
    (kind,) = kinds
    assert kind.decision == "cannot tell"
    assert kind.trial is None
    left = [trial.family.name for trial in kind.possible]
    assert len(left) > 1
    assert kind.text == f"cannot tell: the data do not distinguish {', '.join(left)}"


@pytest.mark.parametrize(("softer", "told"), [(1.0, True), (5.0, False)])
def test_blocks_that_slip_beyond_the_motion_are_not_told(
    single: RigidArm, monkeypatch: pytest.MonkeyPatch, softer: float, told: bool
) -> None:
    """A block that slips after several times the travel leaves LuGre's bristles: what it gives there is a guess."""
    seen, reach = (np.zeros(2), np.zeros(2)), 0.5 * (1.0 + np.exp(softer)) * 25.0 / 1e5
    bristles = FAMILIES[2].bristles(np.array([-softer, 0.0]), 25.0)
    others = KindTrial(FAMILIES[0], None, seen, {}, 0.1, 9.0)
    trials = (KindTrial(FAMILIES[2], bristles, seen, {}, 0.01, 0.0, 0.0, reach), others)
    choice = ElementKind("joint_1", trials, np.array([0.0, 4e-4]))
    monkeypatch.setattr(kinds_module, "choose_kinds_of", lambda *_: [choice])
    (kind,) = choose_kinds(presliding((1.1, 0.8, 0.5), 0.2), single)
    assert (kind.decision, kind.trial is None) == (("Maxwell slip", False) if told else ("cannot tell", True))
    if not told:
        assert f"a block would slip only after {1e3 * reach:.2g} mrad" in kind.text


def test_two_motions_are_not_compared(single: RigidArm) -> None:
    """A joint with two micro-oscillations, and one without any, keep LuGre's bristles, with the reason."""
    for fit, count in ((presliding((0.5, 0.4), 0.2), 2), (PreslidingFit(()), 0)):
        seen: list[str] = []
        (kind,) = choose_kinds(fit, single, seen.append)
        assert kind.text == f"not compared: {count} micro-oscillations; 3 or more tell kinds apart"
        assert len(seen) == kind_steps(single)


def test_elements_that_share_joints_are_told_each() -> None:
    """Two elements that turn with the same joint are told with their kinds, stiffness and numbers."""
    kinds, seen = (BLOCKS, ElastoPlastic(0.45)), list[str]()
    choices = chosen(SHARED, kinds, (1.1, 0.6), progress=seen.append)
    assert len(seen) == steps_of(2, FAMILIES) == 9 + 6
    assert [one.kind for one in choices] == ["Maxwell slip", "elasto-plastic"]
    for choice, kind in zip(choices, kinds, strict=True):
        estimates = choice.best.estimates
        assert estimates["c0"].value == pytest.approx(1e5, rel=0.1)
        assert estimates["c1"].value == pytest.approx(100.0, rel=0.3)
        for name, value in ({} if kind is None else numbers_of(kind)).items():
            if name != "bristles.attraction":
                assert estimates[name].value == pytest.approx(value, abs=0.12), name
        measured, fitted = choice.best.friction_torques
        assert np.std(measured - fitted) < 0.1 * np.std(measured)


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


TRUTH = ElastoPlastic(0.6)


class Outcome(NamedTuple):
    """What the command wrote and said: friction file, its content, standard output and error, and the bags."""

    file: Path
    content: dict[str, Any]
    said: str
    shown: str
    bags: dict[str, Path]


@pytest.fixture(scope="module")
def outcome(shipped: Setup, tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """Run sweeps and three micro-oscillations of joint 4, whose bristles are elasto-plastic, and identify it."""
    folder = tmp_path_factory.mktemp("kinds")
    elements = list(shipped.friction.elements)
    elements[3] = replace(elements[3], bristles=TRUTH)
    truth = replace(shipped, friction=FrictionSet(shipped.friction.names, tuple(elements)))
    options = PlanOptions(
        speeds=8, groups=("joint_4",), presliding_cycles=(2e-3,) * 3, tone_amplitudes=(1.2e-4, 6e-5, 3e-5), burst=2.4
    )
    bags = {}
    for experiment in make_plan(truth.robot, truth.drives, options):
        bags[str(experiment.kind)] = folder / experiment.name
        run_on_engine(truth, experiment, folder / experiment.name)
    file, said, shown = folder / "friction.yaml", io.StringIO(), Terminal()
    words = [word for use, bag in bags.items() for word in (f"--{use}", str(bag))]
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said), redirect_stderr(shown):
        patch.setattr(kinds_module, "FAMILIES", FAMILIES)  # blocks of one number: more take longer
        leave_plots_out(patch)
        assert run("rx90_identify", [*words, "--output", str(file), "--bristle-kinds"]) == DONE, said.getvalue()
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    return Outcome(file, content, said.getvalue(), shown.getvalue(), bags)


def test_the_file_carries_the_kind_and_where_it_comes_from(outcome: Outcome) -> None:
    """The kind is that of the plant, its break-away within four deviations, by the bag of micro-oscillations.

    Joints that did not move, those of the coupled wrist as well, have LuGre's bristles and the reason. Terminal and
    page show the decision and how sure it is; progress names joint and kind and ends complete.
    """
    found = outcome.content["identification"]["bristles"]["joint_4"]
    assert found["decision"] == "elasto-plastic"
    assert list(found["tried"]) == [family.name for family in FAMILIES]
    (label,) = found["bags"]
    bags = outcome.content["identification"]["bags"]
    assert bags[label]["path"] == str(outcome.bags["presliding"])
    number = outcome.content["identification"]["parameters"]["joint_4"]["bristles.break_away"]
    assert number["provenance"] == "identified"
    assert number["bags"] == [label]
    error = number["value"] - TRUTH.break_away
    assert abs(error) < min(0.1, 4.0 * number["deviation"] + 0.02)
    assert outcome.content["elements"]["joint_4"]["note"].startswith("bristles: elasto-plastic, better")
    assert schema_faults("friction", outcome.file) == []
    for name, reason in (("joint_1", "0 micro-oscillations; 3"), ("joint_5_6", "0 micro-oscillations; 6")):
        assert "bristles" not in outcome.content["elements"][name]
        assert outcome.content["elements"][name]["note"].startswith(f"bristles: not compared: {reason}")
        assert outcome.content["identification"]["bristles"][name]["decision"] == "not compared"
    assert "bristles of joint_4: elasto-plastic, better than the others by" in outcome.said
    assert "bristles of joint_5, joint_6, joint_5_6: not compared: 0 micro-oscillations; 6 or more" in outcome.said
    assert "joint_4: elasto-plastic" in outcome.shown
    assert "| 54/54 [" in outcome.shown  # three bags, two fits, four joints and the wrist's 27 + 9, one validation
    text = outcome.file.with_suffix(".html").read_text(encoding="utf-8")
    assert "Kinds of bristles" in text
    assert "better than the others by" in text


def test_the_plant_runs_with_the_file(outcome: Outcome, shipped: Setup) -> None:
    """The plant that loads the file has the bristles written there, c0 near the truth, and runs a motion with them.

    The run that was not used confirms the identification, and the file given by itself.
    """
    element = load_friction(outcome.file, RX_WRIST.element_names(shipped.robot.joint_names)).elements[3]
    written = outcome.content["elements"]["joint_4"]["bristles"]
    assert element.bristles == ElastoPlastic(written["break_away"])
    truth = shipped.friction.elements[3]
    assert element.c0 == pytest.approx(truth.c0, rel=0.05)
    setup = rx.load_setup(friction=outcome.file)
    names, rest = shipped.robot.joint_names, np.zeros(6)
    points = rx.TrajectoryPoints.create(names, names, [0.0, 0.2], [rest, 1e-3 * np.eye(6)[3]], [rest] * 2, [rest] * 2)
    series = rx.simulate(setup, points).series["friction_states"]
    assert series.effort is not None
    assert np.isfinite(series.effort).all()
    assert f"validation {outcome.bags['validation']}: confirmed" in outcome.said
    words = ["--friction", str(outcome.file), "--validation", str(outcome.bags["validation"])]
    assert run("rx90_identify", words) == DONE


SLIPPING = {"kind": "maxwell_slip", "stiffness": [0.61234567, 0.38765433], "share": [0.25, 0.75], "attraction": 5000.0}
ELASTIC = {"kind": "elasto_plastic", "break_away": 0.4512345678}
PARTS = (MaxwellSlip((0.61234567, 0.38765433), (0.25, 0.75), 5000.0), ElastoPlastic(0.4512345678))


def fallback(path: Path, bristles: dict[str, Any]) -> Path:
    """Write a fallback for the joint with such a block."""
    content = yaml.safe_load(write_fallback(path, ["hinge"]).read_text(encoding="utf-8"))
    content["elements"]["hinge"]["bristles"] = bristles
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def test_a_joint_without_micro_oscillations_takes_c0_and_bristles(
    hinge: Hinge, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Sweeps alone leave c0 and block of the fallback, to the last digit, marked as assumed, on page and terminal."""
    given, file = fallback(tmp_path / "given.yaml", SLIPPING), tmp_path / "friction.yaml"
    words = ["--sliding", str(hinge.bag), "--urdf", str(hinge.urdf), "--fallback", str(given), "--output", str(file)]
    assert run("rx90_identify", words) == DONE
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    element = content["elements"]["hinge"]
    assert (element["bristles"], element["c0"]) == (SLIPPING, 12345.0)
    assert element["note"] == f"bristles: as its c0 those of {given}, assumed"
    numbers = content["identification"]["parameters"]["hinge"]
    expected = {"stiffness[0]": 0.61234567, "stiffness[1]": 0.38765433, "share[0]": 0.25, "share[1]": 0.75}
    for name, value in {**expected, "attraction": 5000.0}.items():
        one = numbers[f"bristles.{name}"]
        assert (one["value"], one["provenance"], one["taken_from"]) == (value, "assumed", str(given)), name
    assert schema_faults("friction", file) == []
    assert FrictionFile.read(file).elements["hinge"].bristles == PARTS[0]
    assert f"bristles of hinge: as c0 those of {given}, assumed" in capsys.readouterr().out
    assert "With c0 the bristles of hinge are those of that file" in file.with_suffix(".html").read_text("utf-8")


LUGRE = SimpleNamespace(decided=True, trial=None)
OPEN = SimpleNamespace(decided=False, trial=None)
TOLD = SimpleNamespace(decided=True, sources=())


@pytest.mark.parametrize(
    ("known", "kind", "expected"),
    [
        (False, None, PARTS[0]),
        (True, None, None),
        (False, OPEN, PARTS[0]),
        (True, OPEN, None),
        (False, LUGRE, None),
        (True, TOLD, PARTS[1]),
        (False, TOLD, PARTS[1]),
    ],
    ids=["c0 open", "c0 known", "both open", "kind open", "LuGre told", "all told", "kind told"],
)
def test_bristles_go_with_c0_unless_they_are_told(
    hinge: Hinge,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    known: bool,
    kind: SimpleNamespace | None,
    expected: BristlesPart | None,
) -> None:
    """The fallback's block comes with its c0; a c0 of LuGre's fit stays LuGre's, and a kind that is told stays.

    Without a fallback, c1, here a large one, fades so that the element gives energy at no speed.
    """
    options = RobotOptions(urdf=str(hinge.urdf), fallback=str(fallback(tmp_path / "given.yaml", SLIPPING)))
    robot = RecordedRobot.load(options)
    c0 = ParameterEstimate(2e4, 1e2) if known else ParameterEstimate.unknown("too small")
    cycles = ElementEstimate("hinge", {"c0": c0, "c1": c0}, np.eye(2), ())
    slides = ElementEstimate("hinge", dict.fromkeys(SLIDING, ParameterEstimate(1.0, 0.1)), np.eye(7), ())
    if kind is TOLD:
        kind.trial = SimpleNamespace(
            bristles=PARTS[1], estimates={"c0": c0, "c1": c0, "bristles.break_away": ParameterEstimate(0.45, 0.1)}
        )
    monkeypatch.setattr(identification, "identify_sliding", lambda *_, **__: SimpleNamespace(estimates=[slides]))
    monkeypatch.setattr(identification, "identify_presliding", lambda *_: SimpleNamespace(estimates=[cycles]))
    monkeypatch.setattr(identification, "choose_kinds", lambda *_: (kind,))
    (one,) = identify_records([], [None], robot, bristle_kinds=kind is not None).elements  # type: ignore[list-item]
    assert one.element.bristles == expected
    assert one.given_bristles == (expected == PARTS[0])
    assert one.element.c0 == (2e4 if known else 12345.0)
    if known:
        alone = RecordedRobot.load(replace(options, fallback="none"))
        (own,) = identify_records([], [None], alone, bristle_kinds=kind is not None).elements  # type: ignore[list-item]
        assert replace(own.element, omega_d=one.element.omega_d) == one.element
        assert own.element.passivity_limit(1e3) == np.inf


@pytest.mark.parametrize("known", [True, False])
def test_excitation_runs_take_bristles_with_c0(tmp_path: Path, known: bool) -> None:
    """Where excitation runs do not tell c0, they take the fallback's with its block; where they do, LuGre's stay."""
    given = FrictionFile.read(fallback(tmp_path / "given.yaml", ELASTIC)).select(["hinge"])
    estimates = {name: ParameterEstimate(1.0, 0.1) for name in ("tau_c_positive", "tau_c_negative")}
    if known:
        estimates["c0"] = ParameterEstimate(2e4, 1e2)
    covariance = np.eye(len(estimates))
    (one,) = simulated_elements([ElementEstimate("hinge", estimates, covariance, ())], given)
    assert one.element.bristles == (None if known else PARTS[1])
    assert ("bristles.break_away" in one.estimates) == one.given_bristles == (not known)
