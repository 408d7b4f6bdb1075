"""The kind of a joint's bristles from micro-motions whose truth is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.friction_mass import led
from rx90_common.base.errors import IdentificationError
from rx90_common.friction import FrictionElement
from rx90_common.friction.parts.bristles import BristlesPart, ElastoPlastic, MaxwellSlip
from rx90_emulator.identification.presliding.kind_model import KindFamily
from rx90_emulator.identification.presliding.kinds import KindChoice, choose_kind
from rx90_emulator.identification.presliding.micro_motion import MicroMotion
from rx90_emulator.identification.records.record import JointRecord

ELEMENT = FrictionElement(25.0, 25.0, 28.0, 28.0, 0.05, 1.0, 1e5, 100.0, 14.0, 1.0)
STEP, COUNT, INERTIA = 1e-3, 1600, 4.0
FAMILIES = (KindFamily(), KindFamily(elastic=True), KindFamily(blocks=2))


def micro_motions(bristles: BristlesPart | None, sizes: tuple[float, ...], noise: float) -> list[MicroMotion]:
    """Return motions of three tones with amplitudes in parts of tau_c / c0, torques with noise, Nm."""
    rng, found = np.random.default_rng(3), []
    time = np.arange(COUNT) * STEP
    for size in sizes:
        waves = [(hz, rng.uniform(0.0, 2.0 * np.pi)) for hz in (3.0, 9.0, 19.0)]
        position = size * 2.5e-4 / 3.0 * sum(np.sin(2.0 * np.pi * hz * time + phase) for hz, phase in waves)
        velocity = np.diff(position, prepend=position[0]) / STEP
        acceleration = np.gradient(velocity, STEP)
        torque = led(replace(ELEMENT, bristles=bristles), velocity, STEP)[0]
        drive = torque + INERTIA * acceleration + noise * rng.standard_normal(COUNT)
        record = JointRecord(("joint_1",), time, *np.zeros((3, COUNT, 1)), Path("bag"), "digest")
        found.append(
            MicroMotion(
                joints=(0,),
                step=STEP,
                position=position[:, None],
                velocity=velocity[:, None],
                acceleration=acceleration[:, None],
                drive=drive[:, None],
                mass=np.array([[INERTIA]]),
                inertia=np.array([INERTIA]),
                record=record,
                interval=(0.0, COUNT * STEP),
            )
        )
    return found


def chosen(bristles: BristlesPart | None, sizes: tuple[float, ...] = (1.1, 0.8, 0.5), noise: float = 0.2) -> KindChoice:
    """Return what is found with these bristles."""
    return choose_kind(micro_motions(bristles, sizes, noise), ELEMENT, 0.9e5, FAMILIES)


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
    choice = chosen(bristles)
    assert choice.kind == kind, choice.table()
    (best,) = choice.possible
    assert best.c0 == pytest.approx(1e5, rel=0.05)
    assert best.c1 == pytest.approx(100.0, rel=0.2)
    if isinstance(bristles, ElastoPlastic):
        assert isinstance(best.bristles, ElastoPlastic)
        assert best.bristles.break_away == pytest.approx(0.45, abs=0.1)
    if isinstance(bristles, MaxwellSlip):
        assert isinstance(best.bristles, MaxwellSlip)
        assert best.bristles.stiffness == pytest.approx(bristles.stiffness, abs=0.05)


def test_motions_far_below_break_away_tell_nothing() -> None:
    """Where every kind is a spring the data cannot tell, and it is said."""
    choice = chosen(None, (0.06, 0.05, 0.04), 0.5)
    assert choice.kind is None
    assert len(choice.possible) > 1
    assert all(len(row) == 5 for row in choice.table())


def test_too_few_motions_are_refused() -> None:
    """Two motions leave nothing to predict."""
    with pytest.raises(IdentificationError, match="2 micro-motions of a joint; accepted: 3 or more"):
        chosen(None, (0.5, 0.4))
