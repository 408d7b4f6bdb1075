"""Bristles of several kinds in one plant, each against its own papers' equations."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bristle_oracles import ElastoPlasticOracle, MaxwellSlipOracle, swing

from rx90_common.friction import FrictionElement
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_sim.plant import Plant

ELEMENT = FrictionElement(25.0, 31.0, 28.0, 36.0, 0.05, 1.0, 1e5, 100.0, 14.0, 1.0)
STIFF, SOFT = ElastoPlastic(0.8), ElastoPlastic(0.2)
BLOCKS = MaxwellSlip((0.5, 0.3, 0.2), (0.2, 0.3, 0.5), 2000.0)


def force(t: float) -> float:
    """Return a force that makes a mass reverse, stick and slip, Nm."""
    return 45.0 * math.sin(60.0 * t) + 6.0 * math.sin(171.0 * t)


def test_mixed_kinds_in_one_plant(masses: Callable[..., Plant]) -> None:
    """Four joints with four kinds follow solvers with located events; a reset plant does it again to the last bit."""
    elements = [replace(ELEMENT, bristles=kind) for kind in (STIFF, BLOCKS, None, SOFT)]
    plant, end = masses(elements, 1.5, 16_000), 0.1
    seen = []
    for _ in range(2):
        for k in range(round(end * 16_000)):
            plant.step(np.full(6, force((k + 0.5) / 16_000)) * [1, 1, 1, 1, 0, 0])
        seen.append(np.concatenate([*plant.joint_states()[:2], *plant.friction_states()]))
        plant.reset(np.zeros(6))
    assert seen[0].tolist() == seen[1].tolist()
    position, velocity, z, _, torque = np.split(seen[0], [6, 12, 19, 26])
    for joint, kind in ((0, STIFF), (1, BLOCKS), (3, SOFT)):
        if isinstance(kind, ElastoPlastic):
            oracle: ElastoPlasticOracle | MaxwellSlipOracle = ElastoPlasticOracle(ELEMENT, kind.break_away)
        else:
            oracle = MaxwellSlipOracle(ELEMENT, np.array(kind.stiffness), np.array(kind.share), kind.attraction)
        x, v, turns = swing(oracle, 1.5, force, end, 0.0, 1.0)
        assert turns >= 1
        assert position[joint] == pytest.approx(x, abs=2e-6)
        assert velocity[joint] == pytest.approx(v, abs=1e-4)
        if isinstance(oracle, ElastoPlasticOracle):
            assert torque[joint] == pytest.approx(oracle.torque(z[joint], v), abs=0.1)
    assert len({round(float(x), 6) for x in position[:4]}) == 4  # no two kinds move alike


def test_a_kind_and_another_part_go_together(masses: Callable[..., Plant]) -> None:
    """With a walk too slow to be seen an elasto-plastic joint moves as it does without."""
    alone = replace(ELEMENT, bristles=STIFF)
    both = replace(alone, scatter=ScatterPart(1e-9, 100.0))
    plant = masses([alone, both], 1.5)
    for k in range(400):
        plant.step(np.full(6, force((k + 0.5) / 4000)) * [1, 1, 0, 0, 0, 0])
    position = plant.joint_states()[0]
    assert position[0] == pytest.approx(position[1], rel=1e-6)
    assert position[0] != position[1]
