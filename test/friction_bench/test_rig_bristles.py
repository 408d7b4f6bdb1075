"""The emulated rig with bristles of other kinds than LuGre's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from friction_bench.rig.plant import RigPlant
from friction_bench.rig.rig_file import load_rig
from rx90_common.base.errors import ConfigError
from rx90_common.base.share import config_path
from rx90_common.friction import FrictionElement
from rx90_common.friction.parts.bristles import BristlesPart, ElastoPlastic, MaxwellSlip

JOINT = FrictionElement(0.9, 0.9, 0.9, 0.9, 0.08, 1.0, 2e3, 2.0, 0.11)
BLOCKS = MaxwellSlip((0.6, 0.4), (0.2, 0.8), 500.0)


def rig(bristles: BristlesPart | None) -> RigPlant:
    """Return a rig without noise and without friction but that of its joint."""
    shipped = load_rig(config_path("rig/gm8224_lugre.yaml"))
    quiet = replace(
        shipped.plant,
        gain_error=0.0,
        torque_noise=0.0,
        coulomb=0.0,
        viscous=1e-9,
        joint=replace(JOINT, bristles=bristles),
    )
    plant = RigPlant(replace(shipped, plant=quiet), 1)
    plant.load(True)
    return plant


def deflection(bristles: BristlesPart | None, load: float) -> float:
    """Return by how much the joint turns under a torque that grows slowly to `load`, Nm at the joint, rad."""
    plant = rig(bristles)
    gear = plant.rig.joint_scale
    for torque in np.append(np.linspace(0.0, load / gear, 3000), np.full(500, load / gear)):
        plant.advance(float(torque), 1e-3)
    assert abs(plant.speed) < 1e-6
    return plant.angle / plant.rig.gear_ratio


def test_each_kind_deflects_by_its_own_curve() -> None:
    """Below break-away the joint's angle is that of a spring, of LuGre's logarithm, or of springs with stops."""
    load, g = 0.6, 0.9 / 2e3
    assert deflection(ElastoPlastic(0.7), load) == pytest.approx(load / 2e3, rel=1e-6)
    # Where it is not elastic, the small oscillations of a load that grows in steps leave some more.
    assert deflection(None, load) == pytest.approx(-g * np.log(1.0 - load / 0.9), rel=0.02)
    # Block 1 slips from 0.2 * 0.9 Nm on; the other carries what is left.
    assert deflection(BLOCKS, load) == pytest.approx((load - 0.2 * 0.9) / (0.4 * 2e3), rel=0.005)


def test_the_rig_s_file_takes_bristles(tmp_path: Path) -> None:
    """The joint of a rig's file may have other bristles than LuGre's."""
    shipped = config_path("rig/gm8224_lugre.yaml").read_text(encoding="utf-8")
    file, block = tmp_path / "rig.yaml", "bristles: {kind: elasto_plastic, break_away: 0.7}"
    file.write_text(shipped.replace("omega_d: 1.0}", f"omega_d: 1.0, {block}}}"), encoding="utf-8")
    joint = load_rig(file).plant.joint
    assert isinstance(joint, FrictionElement)
    assert joint.bristles == ElastoPlastic(0.7)


def test_a_joint_put_on_again_begins_anew() -> None:
    """Taking the joint off and on forgets the deflections: the same torques give the same motion to the last bit."""
    plant, paths = rig(BLOCKS), []
    for _ in range(2):
        plant.load(True)
        plant.angle = 0.0
        paths.append([])
        for _ in range(50):
            plant.advance(0.02, 1e-3)
            paths[-1].append((plant.angle, plant.speed, plant.bristle))
    assert paths[0] == paths[1]
    assert paths[0][-1][2] > 0.0


def test_a_joint_that_warms_is_refused(tmp_path: Path) -> None:
    """The emulated rig's joint has no temperature: a rig file with that part is refused in one line."""
    warm = (
        "temperature: {reference: 30, lowest: 0, highest: 90, start: 25, ambient: 25, capacity: 100, resistance: 1, "
        "viscous_scale: 20}"
    )
    text = config_path("rig/gm8224_lugre.yaml").read_text(encoding="utf-8")
    file = tmp_path / "rig.yaml"
    file.write_text(text.replace("omega_d: 1.0}", f"omega_d: 1.0, {warm}}}"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"joint_friction\.lugre\.temperature: the emulated rig cannot hold this"):
        load_rig(file)
