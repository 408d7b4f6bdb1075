"""Wrong encoder zeros in excitation runs of a random arm of four joints, whose torques an independent model made."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from excitation_arms import plain_arm, rigid_arm, runs_of

from benchmarks.excitation_runs import NOISE
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation.checks import check_zeros
from rx90_emulator.identification.excitation.filtering import Bandwidths, FilteredRun
from rx90_emulator.identification.excitation.problem import ExcitationProblem

_SMALL = 0.08  # rad


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[RigidArm, tuple[FilteredRun, ...]]:
    """Return what is known of the arm, and a run with the angles of its URDF."""
    arm = plain_arm(3, 4, coupled=False)
    known = rigid_arm(arm, tmp_path_factory.mktemp("arm"))
    return known, runs_of(arm, 100.0, NOISE, Bandwidths(25.0, 8.0), (1,), periods=1)


@pytest.mark.parametrize(
    "encoder",
    [
        (0.0, 0.0, 0.0, 0.0),
        (0.0, 0.5 * math.pi, 0.0, 0.0),
        (0.0, 0.5 * math.pi, -0.5 * math.pi, 0.0),
        (0.0, 0.0, -_SMALL, 0.0),
    ],
)
def test_wrong_zeros_are_found(measured: tuple[RigidArm, tuple[FilteredRun, ...]], encoder: tuple[float, ...]) -> None:
    """Quarter turns are told exactly, small errors within four deviations, and right zeros are not blamed."""
    known, runs = measured
    recorded = tuple(replace(run, position=run.position + np.array(encoder)) for run in runs)
    given = np.array([0.0, 0.25, 0.0, 0.0])  # what --zero said: the better one is this and the error
    check = check_zeros(ExcitationProblem.of(known, recorded), given)
    small = np.abs(encoder) == _SMALL
    assert np.all(np.abs(check.error - encoder)[small] < 4.0 * check.deviation[small])
    turned = np.angle(np.exp(1j * (check.error - encoder)))
    assert np.allclose(turned[~small], 0.0, atol=1e-9)
    assert check.deviation[~small].max() == 0.0
    assert bool(check.text) == any(encoder)
    if any(encoder):
        assert check.after < check.before
        wanted = [float(word) for word in check.text.split("--zero ")[1].split(";")[0].split()]
        assert np.allclose(wanted, given + check.error, atol=1e-6)
