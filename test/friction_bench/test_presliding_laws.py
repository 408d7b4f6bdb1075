"""What the presliding experiments rest on: the rig's joint, laws along a motion, drift, stability; by other oracles."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rig_bench import greeted
from scipy.integrate import solve_ivp

from friction_bench.presliding import laws, motions, sliding
from friction_bench.presliding.job import Campaign, Run
from friction_bench.presliding.report import drift_plot
from friction_bench.rig import messages
from friction_bench.rig.client import Sample
from friction_bench.rig.plant import RigPlant
from friction_bench.rig.rig_file import Rig, load_rig
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.share import PRESLIDING_RIG, config_path
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip
from rx90_common.report.plot import Curve

C0, COULOMB, STATIC, STRIBECK = 4e3, 2.0, 2.5, 0.1
ELEMENT = FrictionElement(COULOMB, COULOMB, STATIC, STATIC, STRIBECK, 1.0, C0, 50.0, 1.0, 0.05)
SLIDING = sliding.SlidingFriction(2.0, 2.5, 0.1, 1.0, 0.4, 0.0)
LUGRE_RIG = config_path("rig/gm8224_lugre.yaml")

STILL = messages.parse_report(messages.Frame(messages.Answer.REPORT, 1, bytes(12)))


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Return the shipped rig that sees presliding."""
    return load_rig(config_path(PRESLIDING_RIG))


def _elastic_share(y: float, steady: float, elastic: float) -> float:
    """Return Dupont's alpha: 0 up to break-away, 1 in steady sliding, half a sine between."""
    if y <= elastic:
        return 0.0
    if y >= steady:
        return 1.0
    return 0.5 + 0.5 * math.sin(math.pi * (y - 0.5 * (steady + elastic)) / (steady - elastic))


@pytest.mark.parametrize(
    ("file", "changes", "torques", "share"),
    [
        (PRESLIDING_RIG, {}, (0.03, 0.06, 0.02, 0.07, 0.0), 0.0),
        (PRESLIDING_RIG, {"bristles": ElastoPlastic(0.5)}, (0.03, 0.06, 0.02, 0.07, 0.0), 0.0),
        ("rig/bipolar.yaml", {}, (0.09, -0.03, -0.09, 0.05, 0.09), 1e-3),
    ],
    ids=["LuGre", "elasto-plastic", "through zero"],
)
def test_the_rigs_joint_moves_as_scipy_integrates_it(
    file: str, changes: dict[str, Any], torques: tuple[float, ...], share: float
) -> None:
    """Joints of the emulated rig move under a torque in steps as equations 17 to 19 say, an asymmetric one, too."""
    rig = load_rig(config_path(file))
    joint = replace(rig.plant.joint, **changes)
    quiet = replace(rig.plant, gain_error=0.0, torque_noise=0.0, coulomb=0.0, joint=joint)
    plant = RigPlant(replace(rig, plant=quiet), 0)
    plant.load(True)
    of_motor = quiet.viscous * rig.gear_ratio * rig.joint_scale
    inertia = quiet.load_inertia + quiet.joint_inertia + quiet.rotor_inertia * rig.gear_ratio * rig.joint_scale

    def motion(_: float, state: Array, torque: float) -> list[float]:
        _, v, z = state
        way = "positive" if v >= 0.0 else "negative"
        coulomb, static = (getattr(joint, f"{name}_{way}") for name in ("tau_c", "tau_s"))
        steady = (coulomb + (static - coulomb) * math.exp(-abs(v) / joint.omega_s)) / joint.c0
        sense = math.copysign(1.0, v)
        alpha = _elastic_share(sense * z, steady, 0.5 * coulomb / joint.c0) if changes else 1.0
        z_dot = v * (1.0 - alpha * sense * z / steady)
        friction = joint.c0 * z + joint.c1 * math.exp(-((v / joint.omega_d) ** 2)) * z_dot + (joint.c2 + of_motor) * v
        return [v, (torque * rig.joint_scale - friction) / inertia, z_dot]

    state, found, expected = np.zeros(3), [], []
    for torque in torques:  # Nm at the motor
        for _ in range(80):
            plant.advance(torque, 1e-3)
        found.append(plant.angle / rig.gear_ratio)
        solved = solve_ivp(motion, (0.0, 0.08), state, args=(torque,), rtol=1e-9, atol=1e-13, max_step=1e-3)
        state = solved.y[:, -1]
        expected.append(float(state[0]))
    assert found == pytest.approx(expected, rel=5e-3, abs=2e-7 + share * float(np.ptp(expected)))
    assert not share or np.diff(found).min() < -1e-3


def test_a_joint_put_on_again_begins_anew() -> None:
    """Taking the joint off and on forgets the deflections: the same torques give the same motion to the last bit."""
    shipped = load_rig(LUGRE_RIG)
    joint = replace(shipped.plant.joint, bristles=MaxwellSlip((0.6, 0.4), (0.2, 0.8), 500.0))
    quiet = replace(shipped.plant, gain_error=0.0, torque_noise=0.0, coulomb=0.0, joint=joint)
    plant, paths = RigPlant(replace(shipped, plant=quiet), 1), []
    for _ in range(2):
        plant.load(True)
        plant.angle = 0.0
        paths.append([])
        for _ in range(50):
            plant.advance(0.02, 1e-3)
            paths[-1].append((plant.angle, plant.speed, plant.bristle))
    assert paths[0] == paths[1]
    assert paths[0][-1][2] > 0.0


def test_maxwell_slip_turns_round_by_masings_rule() -> None:
    """The way back of blocks is the first way doubled in both directions, and an inner loop closes where it began."""
    blocks = MaxwellSlip((0.5, 0.3, 0.2), (0.2, 0.3, 0.5), 50.0)
    law = laws.FrictionLaw("blocks", 0, bristles=lambda _: blocks)
    rigid = sliding.SlidingFriction(COULOMB, COULOMB, STRIBECK, 0.0, 0.4, 0.0)

    def way(*ends: float) -> tuple[Array, Array]:
        """Return angle and torque of a slow motion between such ends, rad, by steps of 1 urad."""
        legs = [np.arange(a, b, math.copysign(1e-6, b - a)) for a, b in zip((0.0, *ends[:-1]), ends, strict=True)]
        angle = np.concatenate([*legs, [ends[-1]]])
        block = laws.LoopBlock(angle, np.arange(1, angle.size), angle[1:], 0.02)
        (torque,) = law.predict([math.log(C0)], rigid, [block])
        return angle, np.concatenate(([0.0], torque))

    top = 4e-4
    angle, torque = way(top, -top)
    first = angle.size // 3 + 1
    virgin = sum(
        np.minimum(k * C0 * angle[:first], a * COULOMB) for k, a in zip(blocks.stiffness, blocks.share, strict=True)
    )
    assert torque[1:first] == pytest.approx(np.asarray(virgin)[1:first], abs=C0 * 1.5e-6)
    back = angle[first:]
    masing = torque[first - 1] - 2.0 * np.interp((top - back) / 2.0, angle[:first], torque[:first])
    assert torque[first:] == pytest.approx(masing, abs=C0 * 3e-6)
    _, before = way(top, 1e-4)
    _, after = way(top, 1e-4, 2.5e-4, 1e-4)
    assert after[-1] == pytest.approx(before[-1], abs=C0 * 3e-6)


def test_drift_over_swing_of_lugre_is_that_of_its_equations() -> None:
    """Slow cycles of torque move a LuGre joint on by what integration of dz/dx gives."""
    for low, high in ((0.05, 0.25), (0.2, 0.6), (0.0, 0.9)):
        up = solve_ivp(lambda z, _: [1.0 / (1.0 - z)], (low, high), [0.0], rtol=1e-10, atol=1e-12).y[0, -1]
        down = solve_ivp(lambda z, _: [1.0 / (1.0 + z)], (low, high), [0.0], rtol=1e-10, atol=1e-12).y[0, -1]
        assert sliding.lugre_ratio(low, high) == pytest.approx((up - down) / down, rel=1e-7)


def _cycled(drift: float, swing: float, phase: float | Array, cycles: int = 2000) -> motions.Trace:
    """Return a trace of small cycles between codes 5 and 25 with such a drift and swing in counts; phases by cycle."""
    code = np.concatenate(([0.0], np.tile([25.0, 25.0, 5.0, 5.0], cycles), [25.0, 25.0]))
    code[0] = 5.0
    number = (np.arange(code.size) + 1) // 4
    place = np.resize(phase, cycles + 2)[number]
    counts = np.floor(number * drift + (swing + drift) * (code == 25.0) + place)
    return motions.Trace("drift", 0.02 * np.arange(code.size), counts, code, 2e-5, 0.0236, 0.02)


@pytest.mark.parametrize(
    ("drift", "swing", "verdict"),
    [
        (2.4, 7.0, sliding.DriftVerdict.DRIFTS),
        (0.024, 0.07, sliding.DriftVerdict.DRIFTS),  # far below a count, and seen by 2000 cycles
        (0.0, 7.0, sliding.DriftVerdict.NO_DRIFT),
        (0.0004, 7.0, sliding.DriftVerdict.NO_DRIFT),  # less than a count in all
        (0.0, 0.3, sliding.DriftVerdict.UNKNOWN),  # too stiff for the encoder
        (0.4, 7.0, sliding.DriftVerdict.UNKNOWN),  # a drift that is not LuGre's
        (20.0, 7.0, sliding.DriftVerdict.UNKNOWN),
    ],
)
def test_drift_decides_or_says_that_it_cannot(drift: float, swing: float, verdict: sliding.DriftVerdict) -> None:
    """The verdict follows drift over swing against LuGre's, at any phase of the encoder."""
    for phase in (0.0, 0.3, 0.9):
        result = sliding.evaluate_drift(_cycled(drift, swing, phase), 5, 25, 100.0)
        assert result.verdict is verdict, result.reason
        assert result.drift[1] <= drift <= result.drift[2]


def test_a_swing_that_is_not_or_hardly_seen_decides_nothing() -> None:
    """Where the joint swings by noise, nothing of LuGre's law is shown; below one and a half counts it may be any."""
    result = sliding.evaluate_drift(_cycled(0.3, -0.5, 0.3), 5, 25, 100.0)
    assert result.swing < 0.0
    assert result.by_lugre is None
    (panel,) = drift_plot(result).panels
    assert [mark.label for mark in panel.marks if isinstance(mark, Curve)] == ["measured"]
    phases = np.random.default_rng(1).permutation(np.linspace(0.0, 1.0, 2002, endpoint=False))
    for swing, verdict in ((1.3, sliding.DriftVerdict.UNKNOWN), (1.7, sliding.DriftVerdict.NO_DRIFT)):
        result = sliding.evaluate_drift(_cycled(0.0, swing, phases), 5, 25, 100.0)
        assert result.swing == pytest.approx(swing, abs=0.01)
        assert result.verdict is verdict, result.reason


def _jacobian(function: Callable[[Array], Array], at: Array) -> Array:
    steps = 1e-7 * np.eye(at.size)
    return np.column_stack([(function(at + step) - function(at - step)) / 2e-7 for step in steps])


@pytest.mark.parametrize("speed", [0.01, 0.05, 0.12])
def test_the_least_stiffness_is_where_steady_sliding_becomes_stable(speed: float) -> None:
    """Eigenvalues of the non-linear joint on a spring, linearised by differences, cross the axis at Routh's stiffness.

    A host's spring that is nearly ideal, at a very short tick, lets deviations grow by these eigenvalues.
    """
    element, inertia, tick = replace(ELEMENT, c1=0.3, omega_d=math.inf), 0.4, 1e-7
    g = float(element.sliding_torque(speed)) / C0
    fall = (STATIC - COULOMB) * math.exp(-speed / STRIBECK) / STRIBECK
    rate, slope, damping = speed / g, element.c2 - fall, element.c2 - element.c1 * speed * fall / (C0 * g)
    least = -rate * slope * (inertia * rate + damping) / damping
    assert least > 0.0

    def motion(state: Array, stiffness: float) -> Array:
        stretch, v, z = state
        z_dot = v * (1.0 - z * C0 / float(element.sliding_torque(v)))
        friction = C0 * z + element.c1 * z_dot + element.c2 * v
        return np.array([speed - v, (stiffness * stretch - friction) / inertia, z_dot])

    for factor, stable in ((0.5, False), (0.97, False), (1.03, True)):
        stiffness = factor * least
        rest = np.array([float(element.steady_torque(speed)) / stiffness, speed, g])
        assert np.abs(motion(rest, stiffness)).max() < 1e-9
        growth = np.linalg.eigvals(_jacobian(lambda s, k=stiffness: motion(s, k), rest)).real.max()
        assert bool(growth < 0.0) is stable
        if factor == 0.5:
            sampled = sliding.sampled_growth(element, inertia, speed, stiffness, tick)
            assert math.log(sampled) / tick == pytest.approx(growth, rel=0.01)


def test_sliding_friction_is_found_at_changing_speed() -> None:
    """Stribeck's curve and the inertia come back from noisy readings with acceleration, some of them wrong."""
    rng = np.random.default_rng(3)
    speed, acceleration = rng.uniform(0.01, 0.35, 200), rng.normal(0.0, 1.0, 200)
    torque = SLIDING.torque(speed) + 0.4 * acceleration + rng.normal(0.0, 0.005, 200)
    torque[::40] += 1.0
    found = sliding.fit_sliding_friction(sliding.SlidingReadings(speed, acceleration, torque))
    values = found.tau_c, found.tau_s, found.omega_s, found.c2, found.inertia
    assert values == pytest.approx((2.0, 2.5, 0.1, 1.0, 0.4), rel=0.1)


def test_maxwell_law_has_shares_that_a_friction_file_accepts() -> None:
    """Any values of the fit give blocks whose stiffnesses and shares add up to 1."""
    for values in ([8.0, 0.0, 0.0, 0.0, 0.0, 0.0], [8.0, -800.0, 5.0, 700.0, 0.0, 3.0]):
        bristles = laws.MAXWELL_SLIP.element(values, SLIDING).bristles
        assert (sum(bristles.share), sum(bristles.stiffness)) == pytest.approx((1.0, 1.0))


def test_blocks_one_after_the_other_are_predicted_as_each_alone() -> None:
    """Of bristles with a memory nothing is carried from one block to the next."""
    blocks = _blocks(lambda number, torque: torque / (3e3 * 1.1**number))
    for law, values in (
        (laws.MAXWELL_SLIP, [8.0, 0.5, 0.4, 0.3, 0.2, 0.1]),
        (laws.ELASTO_PLASTIC, [8.0, -0.5]),
        (laws.STRIBECK, []),
    ):
        for found, block in zip(law.predict(values, SLIDING, blocks), blocks, strict=True):
            assert np.array_equal(found, law.predict(values, SLIDING, [block])[0])


def test_a_joint_that_sticks_later_ends_the_experiment() -> None:
    """Where the joint does not move at the highest code, slide and sweep say so; no code beyond it is sent."""
    for profile in (motions.after_slide(40, 400.0, 100, ()), motions.speeds(40, [5.0], 10, 1.0, 100, 0.02)):
        codes = [next(profile)]
        with pytest.raises(IdentificationError, match="the joint sticks at the highest code, 100"):
            codes.extend(profile.send(Sample(tick, 0.02 * tick, 0, STILL)) for tick in range(100))
        assert sorted(set(codes)) == list(range(40, 101))


def test_laws_that_sliding_refutes_refute_none_in_loops() -> None:
    """A law with a wrong sliding curve, nearest in the loops of a stiff joint, leaves the one with the right curve."""
    blocks = np.abs(np.random.default_rng(2).normal(1.0, 0.1, 10))
    loops = {laws.COULOMB: 0.08, laws.STRIBECK: 0.09, laws.LUGRE: 0.9, laws.MAXWELL_SLIP: 1.3}
    for of_coulomb, nearest, reasons in (
        (0.045, "Stribeck", ["sliding: {}", "", "loops: {}", "loops: {}"]),
        (0.003, "Coulomb and viscous", ["", "loops: {}", "loops: {}", "loops: {}"]),
    ):
        scores = []
        for law, error in loops.items():
            slides = of_coulomb if law is laws.COULOMB else 0.003
            scores.append(laws.LawScore(law, (error * blocks) ** 2, (slides * blocks) ** 2, ()))
        wanted = [reason and reason.format(f"{nearest} predicts better") for reason in reasons]
        assert [score.refuted for score in laws.with_refutations(scores)] == wanted


def test_a_law_is_refuted_by_more_than_chance_and_more_than_a_trifle() -> None:
    """In pairs: one bad block of ten, or 4 % more squared error in each, refute nothing; 30 % more in each refute."""
    noise = np.abs(np.random.default_rng(4).normal(1.0, 0.3, 10))
    chance = np.where(np.arange(10) == 3, 3.0, 1.0)
    for factor, refuted in ((1.3**0.5, True), (1.04**0.5, False), (chance, False)):
        worse = {laws.LUGRE: 1.0, laws.MAXWELL_SLIP: factor}
        scores = [laws.LawScore(law, (noise * by) ** 2, noise**2, ()) for law, by in worse.items()]
        assert [bool(score.refuted) for score in laws.with_refutations(scores)] == [False, refuted]


def _readings(static: float) -> sliding.SlidingReadings:
    """Return readings of a joint that slides, with noise."""
    rng = np.random.default_rng(5)
    speed = rng.uniform(0.01, 0.35, 200)
    torque = sliding.SlidingFriction(2.0, static, 0.1, 1.0, 0.4, 0.0).torque(speed) + rng.normal(0.0, 0.005, 200)
    return sliding.SlidingReadings(speed, np.zeros(200), torque)


def _blocks(bent: Callable[[int, Array], Array]) -> list[laws.LoopBlock]:
    """Return six blocks, torques up and down, with the angle that a function of block and torque, Nm, gives, rad."""
    rng = np.random.default_rng(6)
    held = np.concatenate((np.linspace(0.1, 1.8, 9), np.linspace(1.6, 0.1, 8)))
    blocks = []
    for number in range(6):
        torque = held * rng.uniform(0.9, 1.1)
        angle = np.concatenate(([0.0], np.repeat(bent(number, torque), 4)))
        blocks.append(laws.LoopBlock(angle, np.arange(4, angle.size, 4), torque, 0.02))
    return blocks


def test_of_laws_that_predict_alike_the_simplest_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rigid joint with one sliding torque is Coulomb's, though Stribeck's law says the same of it."""
    monkeypatch.setattr(laws, "LAWS", (laws.COULOMB, laws.STRIBECK, laws.LUGRE))
    found = laws.choose(_blocks(lambda _, torque: 0.0 * torque), _readings(static=2.0), None)
    assert [bool(score.refuted) for score in found.scores] == [False, False, True]
    assert found.text == "Coulomb and viscous"


def test_no_block_is_predicted_by_a_fit_that_has_seen_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Springs of another stiffness in each block: a block's error is that of the stiffness that the others have."""
    monkeypatch.setattr(laws, "LAWS", (laws.STRIBECK, laws.LUGRE))
    blocks = _blocks(lambda number, torque: torque / (3e3 * 1.3**number))
    found = laws.choose(blocks, _readings(static=2.5), None)
    score = found.scores[1]
    for number, block in enumerate(blocks):
        others = [other for k, other in enumerate(blocks) if k % 5 != number % 5]
        stiffness = laws.LUGRE.fit(found.sliding, others)
        rest = laws.LUGRE.predict(stiffness, found.sliding, [block])[0] - block.torque
        assert score.loops[number] == pytest.approx(np.mean(rest**2), rel=1e-6)
    assert found.remaining == (laws.LUGRE,)


def test_break_away_is_that_of_the_slowest_ramps_on_which_the_joint_slid(rig: Rig) -> None:
    """A ramp on which the joint stuck, or one that was faster, does not count; with no other there is no break-away."""
    campaign = Campaign(rig)
    code, slide = np.arange(100.0), campaign.slide
    for rate, slope, step in ((0.4, 0.001, 50.0), (0.4, 0.1, 50.0), (0.4, 0.1, 60.0), (1.6, 0.1, 80.0)):
        counts = np.maximum(code - step, 0.0) * slope * slide
        campaign.done.append(
            (Run("ramps", "", iter(()), rate), motions.Trace("", code, counts, code, 2e-5, 0.02, 0.02))
        )
        if len(campaign.done) == 1:
            with pytest.raises(IdentificationError, match="on no ramp"):
                campaign.break_away_code()
    assert campaign.break_away_code() == pytest.approx(60.0)  # half of a slide at 55 and 65


def test_the_hosts_spring_pulls_by_its_stretch() -> None:
    """The code is stiffness times stretch from the preload on, the end's way less the joint's; errors do not add up."""
    moved = [0, 0, 3, 9, 12, 12]
    profile = motions.pulled(0.37, 4.0, 5, 255, 85.0)
    assert next(profile) == 0
    codes = [profile.send(Sample(tick, 0.02 * tick, counts, STILL)) for tick, counts in enumerate(moved[:-1])]
    wanted = 85.0 + 0.37 * (4.0 * np.arange(1, 6) - np.array(moved[:-1]))
    assert np.abs(np.cumsum(codes) - np.cumsum(wanted)).max() <= 0.5
    rounding = motions.Rounding(229)
    assert sum(rounding(10.3) for _ in range(1000)) == pytest.approx(10_300, abs=0.6)
    assert [rounding(code) for code in (-3.0, 400.0)] == [0, 229]


def test_the_drift_tells_laws_that_loops_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    """Far below break-away both kinds of bristles are springs: a drift keeps LuGre, no drift the other."""
    monkeypatch.setattr(laws, "LAWS", (laws.STRIBECK, laws.LUGRE, laws.ELASTO_PLASTIC))
    noise = np.random.default_rng(7)
    springs = _blocks(lambda _, torque: 0.1 * torque / 4e3)
    blocks = [replace(block, torque=0.1 * block.torque + noise.normal(0.0, 0.01, 17)) for block in springs]
    verdicts = {}
    for cycles in (None, _cycled(2.4, 7.0, 0.3), _cycled(0.0, 7.0, 0.3)):
        drift = None if cycles is None else sliding.evaluate_drift(cycles, 5, 25, 100.0)
        verdicts[drift and drift.verdict] = laws.choose(blocks, _readings(static=2.5), drift).text
    assert verdicts == {
        None: "cannot tell: LuGre or elasto-plastic",
        sliding.DriftVerdict.DRIFTS: "LuGre, by its drift",
        sliding.DriftVerdict.NO_DRIFT: "elasto-plastic, by its drift",
    }


def test_a_code_reaches_the_dac_late_in_the_tick(rig: Rig) -> None:
    """The torque held over a tick is that of the emulated rig's DAC, slice by slice, to an eighth of the change."""
    client, on_dac = greeted(rig), []
    emulated = client.port.emulated
    advance, torque = emulated.plant.advance, rig.torque(1) * rig.joint_scale

    def logged(command: float, dt: float) -> int:
        on_dac.append((emulated.time, command * rig.joint_scale))
        return advance(command, dt)

    emulated.plant.advance = logged
    samples: list[Sample] = []
    trace = motions.follow(client, (10 * (k // 3 % 2) for k in range(30)), "steps", samples.append)
    for held, sample in list(zip(trace.held, samples, strict=True))[1:]:
        end = sample.time - 1e-3 - 1e-9  # the firmware hears of a slice's counts in the next one
        slices = [t for time, t in on_dac if end - rig.tick <= time < end]
        assert len(slices) == 20
        assert held == pytest.approx(np.mean(slices), abs=0.125 * 10 * torque)
