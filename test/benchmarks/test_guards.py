"""The plain fit and the truth that the identification's guards are measured with."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.guard_logs import true_base
from benchmarks.guard_mutations import excitation_log, plain_arm
from benchmarks.independent_fit import PlainArm, fit


def test_the_plain_fit_finds_the_friction_of_an_arm_whose_masses_are_wrong(tmp_path: Path) -> None:
    """Coulomb and viscous torques of a random arm lie within four deviations and 10 %; a base parameter is a sum."""
    arm = plain_arm(3, 3)
    (tmp_path / "arm.urdf").write_text(arm.urdf(wrong=0.4), encoding="utf-8")
    plain = PlainArm.of(str(tmp_path / "arm.urdf"), arm.names, (10.0, 4.0))
    found = fit(plain, [excitation_log(arm, seed, period=24.0).plain for seed in (1, 2)])
    true = np.array([law.coulomb for law in arm.friction] + [law.c2 for law in arm.friction])
    errors = np.abs(found.value[:6] - true)
    assert np.all(errors < 4.0 * found.deviation[:6])
    assert np.all(errors < 0.1 * true)
    expected = arm.links[0].mass - 0.5 * arm.links[1].mass * arm.links[1].center[0] + arm.rotor[2]
    assert np.isclose(true_base("m_1 - 0.5 mx_2 + Ia_3", arm), expected)
