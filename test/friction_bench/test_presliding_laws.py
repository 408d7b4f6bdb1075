"""What the presliding experiments rest on: the rig's joint, laws along a motion, drift, stability; by other oracles."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from friction_bench.presliding.drift import DriftVerdict, evaluate_drift, lugre_ratio
from friction_bench.presliding.five_laws import MAXWELL_SLIP, LoopBlock, settled, torque_along
from friction_bench.presliding.sliding import SlidingFriction, SlidingReadings, fit_sliding_friction
from friction_bench.presliding.stick_slip import SteadySliding
from friction_bench.presliding.trace import Trace
from friction_bench.protocol.codec import Frame, FrameDecoder, encode
from friction_bench.protocol.messages import Command, Fault, limits_payload, parse_report
from friction_bench.rig.joint_parts import joint_record
from friction_bench.rig.native import NativeBoard, native_library
from friction_bench.rig.plant import RigPlant
from friction_bench.rig.rig_file import Rig, load_rig
from rx90_common.base.arrays import Array
from rx90_common.base.share import PRESLIDING_RIG, config_path
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip

C0, COULOMB, STATIC, STRIBECK = 4e3, 2.0, 2.5, 0.1
ELEMENT = FrictionElement(COULOMB, COULOMB, STATIC, STATIC, STRIBECK, 1.0, C0, 50.0, 1.0, 0.05)


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Return the shipped rig that sees presliding."""
    return load_rig(config_path(PRESLIDING_RIG))


def test_firmware_counts_down_and_limits_travel_both_ways(rig: Rig) -> None:
    """Built for a decoder, the firmware counts below zero, and limits the travel of a motor that turns back."""
    board = NativeBoard(rig.baud, native_library(rig.firmware_figures))
    decoder, last = FrameDecoder(), None
    script = [(Command.HELLO, bytes([1])), (Command.LIMITS, limits_payload(2, 300)), (Command.ARM, b"")]
    for number, (command, payload) in enumerate(script):
        board.write(encode(Frame(command, number + 1, payload)))
        board.run(60_000, 0, 0)
    seen = []
    for _ in range(5):
        board.write(encode(Frame(Command.BEAT, 9, b"")))
        board.run(20_000, -200, 0)
        for frame in decoder.feed(board.read()):
            last = parse_report(frame) or last
        assert last is not None
        seen.append((last.counts, last.fault))
    assert seen[0] == (2**24 - 200, Fault.NONE)
    assert Fault.TRAVEL in seen[-1][1]  # beyond 2 x 256 counts


def _elastic_share(y: float, steady: float, elastic: float) -> float:
    """Return Dupont's alpha: 0 up to break-away, 1 in steady sliding, half a sine between."""
    if y <= elastic:
        return 0.0
    if y >= steady:
        return 1.0
    return 0.5 + 0.5 * math.sin(math.pi * (y - 0.5 * (steady + elastic)) / (steady - elastic))


@pytest.mark.parametrize("break_away", [None, 0.5])
def test_the_rigs_joint_moves_as_scipy_integrates_it(rig: Rig, break_away: float | None) -> None:
    """LuGre and elasto-plastic joints of the emulated rig move under a torque in steps as their equations say."""
    assert rig.plant is not None
    bristles = None if break_away is None else ElastoPlastic(break_away)
    quiet = replace(
        rig.plant,
        gain_error=0.0,
        torque_noise=0.0,
        coulomb=0.0,
        joint=replace(ELEMENT, bristles=bristles),
    )
    plant = RigPlant(quiet, rig.counts_per_revolution, 0, counts_down=True)
    plant.load(True)
    steps = [0.03, 0.06, 0.02, 0.07, 0.0]  # Nm at the motor
    found = []
    for torque in steps:
        for _ in range(60):
            plant.advance(torque, 1e-3)
        found.append(plant.angle / rig.gear_ratio)
    of_motor = quiet.viscous * rig.gear_ratio * rig.joint_scale
    inertia = quiet.load_inertia + quiet.joint_inertia + quiet.rotor_inertia * rig.gear_ratio * rig.joint_scale

    def motion(_: float, state: Array, torque: float) -> list[float]:
        _, v, z = state
        steady = (COULOMB + (STATIC - COULOMB) * math.exp(-abs(v) / STRIBECK)) / C0
        sense = math.copysign(1.0, v)
        alpha = 1.0 if break_away is None else _elastic_share(sense * z, steady, break_away * COULOMB / C0)
        z_dot = v * (1.0 - alpha * sense * z / steady)
        friction = C0 * z + 50.0 * math.exp(-((v / 0.05) ** 2)) * z_dot + (1.0 + of_motor) * v
        return [v, (torque * rig.joint_scale - friction) / inertia, z_dot]

    state, expected = np.zeros(3), []
    for torque in steps:
        solved = solve_ivp(motion, (0.0, 0.06), state, args=(torque,), rtol=1e-9, atol=1e-13, max_step=1e-3)
        state = solved.y[:, -1]
        expected.append(float(state[0]))
    assert found == pytest.approx(expected, rel=5e-3, abs=2e-7)


def test_maxwell_slip_turns_round_by_masings_rule() -> None:
    """The way back of blocks is the first way doubled in both directions, and an inner loop closes where it began."""
    blocks = MaxwellSlip((0.5, 0.3, 0.2), (0.2, 0.3, 0.5), 50.0)
    element = replace(ELEMENT, tau_s_positive=COULOMB, tau_s_negative=COULOMB, c1=0.0, c2=0.0, bristles=blocks)

    def way(*ends: float) -> tuple[Array, Array]:
        """Return angle and torque of a slow motion between such ends, rad, by steps of 1 urad."""
        legs = [np.arange(a, b, math.copysign(1e-6, b - a)) for a, b in zip((0.0, *ends[:-1]), ends, strict=True)]
        angle = np.concatenate([*legs, [ends[-1]]])
        return angle, torque_along(joint_record(element, 1.0, 0.02, 0), angle, 0.02)

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
        assert lugre_ratio(low, high) == pytest.approx((up - down) / down, rel=1e-7)


def _cycled(drift: float, swing: float, phase: float, cycles: int = 2000) -> Trace:
    """Return a trace of small cycles between codes 5 and 25 with such a drift and swing in counts."""
    code = np.concatenate(([0.0], np.tile([25.0, 25.0, 5.0, 5.0], cycles), [25.0, 25.0]))
    code[0] = 5.0
    number = (np.arange(code.size) + 1) // 4
    counts = np.floor(number * drift + (swing + drift) * (code == 25.0) + phase)
    return Trace("drift", 0.02 * np.arange(code.size), counts, code, 2e-5, 0.0236, 0.02)


@pytest.mark.parametrize(
    ("drift", "swing", "verdict"),
    [
        (2.4, 7.0, DriftVerdict.DRIFTS),
        (0.024, 0.07, DriftVerdict.DRIFTS),  # far below a count, and seen by 2000 cycles
        (0.0, 7.0, DriftVerdict.STAYS),
        (0.0, 0.3, DriftVerdict.UNKNOWN),  # too stiff for the encoder
        (0.4, 7.0, DriftVerdict.UNKNOWN),  # a drift that is not LuGre's
        (20.0, 7.0, DriftVerdict.UNKNOWN),
    ],
)
def test_drift_decides_or_says_that_it_cannot(drift: float, swing: float, verdict: DriftVerdict) -> None:
    """The verdict follows drift over swing against LuGre's, at any phase of the encoder."""
    for phase in (0.0, 0.3, 0.9):
        result = evaluate_drift(_cycled(drift, swing, phase), 5, 25, 100.0)
        assert result.verdict is verdict, result.reason
        assert result.drift[1] <= drift <= result.drift[2]


def _jacobian(function: Callable[[Array], Array], at: Array) -> Array:
    steps = 1e-7 * np.eye(at.size)
    return np.column_stack([(function(at + step) - function(at - step)) / 2e-7 for step in steps])


@pytest.mark.parametrize("speed", [0.01, 0.05, 0.12])
def test_the_least_stiffness_is_where_steady_sliding_becomes_stable(speed: float) -> None:
    """Eigenvalues of the non-linear joint on a spring, linearised by differences, cross the axis at K*."""
    element = replace(ELEMENT, c1=0.3, omega_d=math.inf)
    inertia = 0.4
    steady = SteadySliding.of(element, inertia, speed)
    least = steady.least_stiffness()
    assert 0.0 < least < math.inf
    g = float(element.sliding_torque(speed)) / C0

    def motion(state: Array, stiffness: float) -> Array:
        stretch, v, z = state
        z_dot = v * (1.0 - z * C0 / float(element.sliding_torque(v)))
        friction = C0 * z + element.c1 * z_dot + element.c2 * v
        return np.array([speed - v, (stiffness * stretch - friction) / inertia, z_dot])

    for factor, stable in ((0.97, False), (1.03, True)):
        stiffness = factor * least
        rest = np.array([float(element.steady_torque(speed)) / stiffness, speed, g])
        assert np.abs(motion(rest, stiffness)).max() < 1e-9
        growth = np.linalg.eigvals(_jacobian(lambda s, k=stiffness: motion(s, k), rest)).real.max()  # type: ignore[misc]
        assert bool(growth < 0.0) is stable
        # The host's spring at a tick of 0.1 ms is nearly ideal.
        assert (steady.sampled_growth(0.5 * least, 1e-4) > 1.0) is True
    assert SteadySliding.of(element, inertia, 0.3).least_stiffness() == 0.0
    assert SteadySliding.of(replace(element, c1=100.0), inertia, speed).least_stiffness() == math.inf


def test_sliding_friction_is_found_at_changing_speed() -> None:
    """Stribeck's curve and the inertia come back from noisy readings with acceleration, some of them wrong."""
    rng = np.random.default_rng(3)
    truth = SlidingFriction(2.0, 2.5, 0.1, 1.0, 0.4, 0.0, 0)
    speed, acceleration = rng.uniform(0.01, 0.35, 200), rng.normal(0.0, 1.0, 200)
    torque = truth.torque(speed) + 0.4 * acceleration + rng.normal(0.0, 0.005, 200)
    torque[::40] += 1.0
    found = fit_sliding_friction(SlidingReadings(speed, acceleration, torque))
    assert (found.tau_c, found.tau_s, found.omega_s, found.c2, found.inertia) == pytest.approx(
        (2.0, 2.5, 0.1, 1.0, 0.4), rel=0.1
    )


def test_flicker_of_a_count_is_no_motion() -> None:
    """Counts that jump between two neighbours stand still; a motion is followed to half a count."""
    assert np.ptp(settled(np.array([3.0, 4.0, 3.0, 4.0, 3.0]))[1:]) == 0.0
    assert settled(np.arange(0.0, 9.0))[1:] == pytest.approx(np.arange(0.5, 8.5))


def test_maxwell_law_has_shares_that_a_friction_file_accepts() -> None:
    """Any values of the fit give blocks whose stiffnesses and shares add up to 1."""
    sliding = SlidingFriction(2.0, 2.5, 0.1, 1.0, 0.4, 0.0, 0)
    for values in ([8.0, 0.0, 0.0, 0.0, 0.0, 0.0], [8.0, -30.0, 5.0, 40.0, 0.0, 3.0]):
        bristles = MAXWELL_SLIP.element(values, sliding).bristles
        assert isinstance(bristles, MaxwellSlip)
        assert sum(bristles.share) == pytest.approx(1.0)
    block = LoopBlock(np.linspace(0.0, 1e-4, 50), np.array([10, 49]), np.array([0.1, 0.4]), 0.02)
    assert MAXWELL_SLIP.predict([8.0, 0.0, 0.0, 0.0, 0.0, 0.0], sliding, block).shape == (2,)
