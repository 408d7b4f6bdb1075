"""Recordings of the kind that real arms make: accelerating, slow at 67 Hz, of another curve."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from foreign_arms import write_urdf
from numpy.typing import NDArray

from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.output.summary import fit_text
from rx90_emulator.identification.records import BagSource, JointRecord
from rx90_emulator.identification.rows.sweeps import find_blocks
from rx90_emulator.identification.sliding import identify_sliding

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
Friction = Callable[[Array], Array]
SPEEDS = np.geomspace(0.004, 1.2, 12)


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


def series(rng: np.random.Generator, friction: Friction = straight, ripple: float = 0.0) -> list[JointRecord]:
    """Return sweeps in both directions."""
    speeds = [sign * speed for speed in rng.permutation(SPEEDS).tolist() for sign in (1.0, -1.0)]
    return [sweep(speed, rng, 20.0 * k, friction, ripple) for k, speed in enumerate(speeds)]


@pytest.mark.parametrize(("noise", "hertz"), [(0.0, 0.1), (0.001, 0.1), (0.004, 0.1), (0.01, 0.1), (0.004, 0.05)])
def test_the_crests_of_a_slow_sine_are_no_plateaus(noise: float, hertz: float) -> None:
    """A sine of 0.9 rad/s, whose crest keeps within 2 % for 0.6 s, is left out, and pieces that noise cuts it in."""
    time = np.arange(0.0, 4.0 / hertz, 0.004)
    velocity = 0.9 * np.sin(2.0 * np.pi * hertz * time)
    sine = record(time, velocity, straight(velocity))
    measured = sine.velocity + noise * np.random.default_rng(2).normal(size=sine.velocity.shape)
    with pytest.raises(IdentificationError, match="no stretch of constant velocity"):
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


def test_a_misfit_shows(hinge: RigidArm) -> None:
    """A curve of the model's form leaves the samples' noise; one of another form leaves more."""
    straight_fit, humped_fit = (
        identify_sliding(series(np.random.default_rng(5), friction), hinge).curves[0] for friction in (straight, humped)
    )
    assert straight_fit is not None
    assert humped_fit is not None
    assert 0.3 < straight_fit.chi2 < 3.0
    assert humped_fit.chi2 > 10.0
    assert humped_fit.share > 3.0 * straight_fit.share
    assert f"chi2 {humped_fit.chi2:.3g}" in fit_text(humped_fit)


def test_a_bag_was_recorded_when_its_stamps_say() -> None:
    """Stamps of the wall clock are a date, whenever the file was written; those of a simulation are none."""
    assert BagSource(Path("bag"), "", 60.0, 0, 1_577_836_800.4).recorded == "2020-01-01T00:00:00+00:00"
    assert BagSource(Path("bag"), "", 60.0, 0, 2.0).recorded == "no date; stamps from 2 to 62 s"
