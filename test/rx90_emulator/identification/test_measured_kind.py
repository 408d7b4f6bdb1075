"""Recordings of the kind that real arms make: accelerating, slow at 67 Hz, of another curve, warming up."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from foreign_arms import write_urdf
from numpy.typing import NDArray
from rx90_emulator.identification.sliding.plateaus import find_blocks
from rx90_emulator.identification.sliding.quality import FALSE_ALARMS, Residuals, drifts_of
from scipy.signal import lfilter
from scipy.stats import binom

from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.records import BagSource, JointRecord
from rx90_emulator.identification.sliding import SlidingFit, identify_sliding

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
Friction = Callable[[Array], Array]
SPEEDS = np.geomspace(0.004, 1.2, 12)
SERIES = 500  # of plateaus without a drift


@pytest.fixture(scope="module")
def hinge(tmp_path_factory: pytest.TempPathFactory) -> RigidArm:
    """Return an arm of one joint with a vertical axis: no weight, all torque is friction and inertia."""
    return RigidArm.from_urdf(write_urdf(tmp_path_factory.mktemp("arm"), ["hinge"], ["0 0 1"], [4.0], "continuous"))


def straight(velocity: Array) -> Array:
    """Return Coulomb and viscous friction, Nm."""
    return np.asarray(5.0 * np.tanh(velocity / 1e-4) + 2.0 * velocity)


def record(time: Array, velocity: Array, torque: Array, name: str = "bag") -> JointRecord:
    """Return the record of one joint; positions are the integral of the velocity that was."""
    position = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time))])
    columns = (values[:, None] for values in (position, velocity, torque))
    return JointRecord(("hinge",), time, *columns, Path(name), name)


def sweep(speed: float, rng: np.random.Generator, begin: float, friction: Friction, ripple: float) -> JointRecord:
    """Return rest, a stretch at a speed that ripples where it is slow, and rest again, at 67 Hz, with noise."""
    lasting = 1.5 + max(1.5, 0.06 / abs(speed))
    time = np.arange(0.0, lasting, 1.0 / 67.0)
    moving = np.clip((time - 0.3) / 0.2, 0.0, 1.0) * np.clip((lasting - 0.3 - time) / 0.1, 0.0, 1.0)
    wave = np.sin(2.0 * np.pi * 3.0 * time + rng.uniform(0.0, 6.0))
    velocity = speed * moving * (1.0 + ripple * min(1.0, 0.01 / abs(speed)) * wave)
    torque = friction(velocity) + 0.05 * rng.normal(size=len(time))
    clean = record(begin + time, velocity, torque, f"{speed:+.4f}")
    noisy = clean.velocity + 0.003 * ripple * rng.normal(size=clean.velocity.shape)
    return JointRecord(clean.names, clean.time, clean.position, noisy, clean.torque, clean.source, clean.sha256)


def series(
    rng: np.random.Generator, friction: Friction = straight, drift: float = 0.0, ripple: float = 0.0
) -> list[JointRecord]:
    """Return sweeps in both directions; the friction changes by the share `drift` from the first to the last."""
    speeds = [sign * speed for speed in rng.permutation(SPEEDS).tolist() for sign in (1.0, -1.0)]
    found = []
    for k, speed in enumerate(speeds):
        share = 1.0 + drift * k / len(speeds)
        found.append(sweep(speed, rng, 20.0 * k, lambda v, share=share: share * friction(v), ripple))  # type: ignore[misc]
    return found


@pytest.mark.parametrize(("noise", "hertz"), [(0.0, 0.1), (0.001, 0.1), (0.004, 0.1), (0.01, 0.1), (0.004, 0.05)])
def test_the_crests_of_a_slow_sine_are_no_plateaus(noise: float, hertz: float) -> None:
    """A sine of 0.9 rad/s, whose crest keeps within 2 % for 0.6 s, is left out, and pieces that noise cuts it in."""
    time = np.arange(0.0, 4.0 / hertz, 0.004)
    velocity = 0.9 * np.sin(2.0 * np.pi * hertz * time)
    sine = record(time, velocity, straight(velocity))
    measured = sine.velocity + noise * np.random.default_rng(2).normal(size=sine.velocity.shape)
    with pytest.raises(IdentificationError, match=r"acceleration or a crest.*no stretch of constant velocity"):
        find_blocks([JointRecord(sine.names, time, sine.position, measured, sine.torque, Path("sine"), "")], np.eye(1))


def test_slow_sweeps_at_67_hz_are_used(hinge: RigidArm) -> None:
    """Sweeps from 4 mrad/s on, of which the slow ones ripple by 30 %, are all used, and friction is found from them."""
    records = series(np.random.default_rng(3), ripple=0.3)
    fit = identify_sliding(records, hinge)
    for one, use in zip(records, fit.usage, strict=True):
        speed = abs(float(str(one.source)))
        assert use.stretches >= 1, (one.source, use.text(("hinge",)))
        assert use.speeds[0, 0] == pytest.approx(speed, rel=0.25)
    found = fit.estimates[0].parameters
    for name, truth in (("tau_c_positive", 5.0), ("tau_c_negative", 5.0), ("c2", 2.0)):
        assert abs(found[name].value - truth) < max(0.03 * truth, 3.0 * found[name].deviation), name


def humped(velocity: Array) -> Array:
    """Return friction with a hump near 50 mrad/s, as of a lubricant, which is no curve of the model, Nm."""
    speed = np.abs(velocity) + 1e-9
    return np.asarray(straight(velocity) + 3.0 * np.sign(velocity) * np.exp(-(np.log(speed / 0.05) ** 2)))


def quality(fit: SlidingFit) -> tuple[float, bool, float]:
    """Return chi2, whether the curve fits, and the deviation of c2."""
    (one,) = fit.quality
    assert one is not None
    return one.chi2, not one.misfit, one.widening


def test_a_misfit_is_told_and_widens_deviations(hinge: RigidArm) -> None:
    """A curve of the model's form has chi2 near 1 and no misfit; one of another form has one, and wider deviations."""
    fits = {f: identify_sliding(series(np.random.default_rng(5), f), hinge) for f in (straight, humped)}
    chi2, good, widening = quality(fits[straight])
    assert (good, widening) == (True, 1.0)
    assert 0.3 < chi2 < 3.0
    chi2, good, widening = quality(fits[humped])
    assert not good
    assert chi2 > 10.0
    assert widening > 2.0
    line = fits[humped].quality[0].lines("hinge")[0]  # type: ignore[union-attr]
    assert "the curve does NOT FIT" in line


def test_a_drift_of_coulomb_friction_is_found(hinge: RigidArm) -> None:
    """Friction that falls by 12 % over a series is told with its size; in one that stays, none is claimed."""
    fits = [identify_sliding(series(np.random.default_rng(6), drift=drift), hinge) for drift in (0.0, -0.12)]
    steady, falling = (fit.quality[0] for fit in fits)
    assert steady is not None
    assert falling is not None
    assert not steady.drift.significant
    assert falling.drift.significant
    # Of Coulomb friction and the mean of the viscous part.
    assert falling.drift.size == pytest.approx(-0.12 * 5.5, rel=0.3)
    assert "drift of hinge" in falling.lines("hinge")[1]


def residuals(seed: int, elements: int, count: int, keep: float) -> Residuals:
    """Return what a fit of one level for each element leaves of noise, `keep` of which each plateau hands on."""
    rng = np.random.default_rng(seed)
    plateaus, owner = elements * count, np.repeat(np.arange(elements), count)
    noise = lfilter([1.0], [1.0, -keep], rng.normal(size=(elements, count + 50)), axis=1)[:, 50:]
    gain = np.eye(elements)[owner]
    left = (noise - noise.mean(axis=1, keepdims=True)).ravel()
    time = np.tile(np.arange(float(count)), elements)
    return Residuals(left, gain, gain, np.arange(plateaus), gain, gain * left[:, None], time)


@pytest.mark.parametrize(("elements", "count", "keep"), [(7, 100, 0.0), (1, 40, 0.6)])
def test_drift_is_claimed_as_rarely_as_it_says(elements: int, count: int, keep: float) -> None:
    """Of all elements together, and with errors that a plateau hands on to the next, no more than by the level."""
    free = np.ones((elements, 1), dtype=np.bool_)
    found = [
        any(drift.significant for drift in drifts_of(residuals(seed, elements, count, keep), free))
        for seed in range(SERIES)
    ]
    assert sum(found) <= binom.ppf(0.95, SERIES, FALSE_ALARMS)


def test_a_bag_was_recorded_when_its_stamps_say() -> None:
    """Stamps of the wall clock are a date, whenever the file was written; those of a simulation are none."""
    assert BagSource(Path("bag"), "", 60.0, 0, 0, 1_577_836_800.4).recorded == "2020-01-01T00:00:00+00:00"
    assert BagSource(Path("bag"), "", 60.0, 0, 0, 2.0).recorded == "no date; stamps from 2 to 62 s"
