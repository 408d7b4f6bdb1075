"""Quarter turns of the encoders' zeros, noticed in sweeps; excitation runs are those of test_signs.py."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from excitation_arms import rigid_arm

from benchmarks.excitation_runs import MISFIT, NOISE, Disturbances
from benchmarks.random_arms import random_arm
from benchmarks.wrong_zeros import sweeps
from rx90_emulator.identification.checks import suspicion


@pytest.mark.parametrize(("seed", "disturbances"), [(0, NOISE), (1, MISFIT), (3, MISFIT)])
def test_a_turned_joint_is_told_with_the_zero_to_try(seed: int, disturbances: Disturbances, tmp_path: Path) -> None:
    """A quarter turn of the second joint in sweeps comes out with the option that mends it; right zeros say nothing."""
    arm = random_arm(seed, 3)
    rigid, recorded = rigid_arm(arm, tmp_path), sweeps(seed, arm, disturbances)
    assert suspicion(rigid, recorded) == ({}, "")
    motion = recorded.motion.copy()
    motion[0, :, 1] += 0.5 * np.pi
    suspects, text = suspicion(rigid, replace(recorded, motion=motion))
    assert suspects == {1: "zero"}
    assert "accepted: --zero 0 1.5708 0, " in text
