"""c0 and c1: known in, known out, and what is not identifiable is reported as such."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from foreign_arms import some_rows

import rx90_emulator as rx
from benchmarks.synthetic_sweeps import Noise, outcomes, random_bristles, recorded, run_presliding
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.share import config_path
from rx90_emulator.identification.experiments.plan import PlanOptions
from rx90_emulator.identification.presliding import PreslidingFit, identify_presliding
from rx90_emulator.identification.records import JointRecord

pytestmark = pytest.mark.slow


WRIST = ["joint_5", "joint_6", "joints_5_6_against"]
FOURTH = 3  # joint 4: its index, and its element's


def oscillated(setup: rx.Setup, groups: Sequence[str]) -> list[Any]:
    heavy = not set(groups) <= set(WRIST)
    options = PlanOptions(
        groups=tuple(groups),
        burst=3.0,  # the plan's is 8
        presliding_cycles=(2e-3,) * 3,
        tone_amplitudes=(2.4e-4, 1.2e-4, 5e-5) if heavy else (5e-5, 1.6e-5, 6e-6),
    )
    return run_presliding(setup, options)


def measured(setup: rx.Setup, runs: Sequence[Any], noise: float, seed: int = 0) -> list[JointRecord]:
    """Return the records of runs with encoders and torque noise, in parts of the rig's."""
    level = Noise(noise * Noise.torque)
    return [recorded(setup, run, np.random.default_rng((seed, 1)), level) for run in runs]


def random_set(setup: rx.Setup, seed: int) -> rx.Setup:
    return replace(setup, friction=random_bristles(setup.friction, np.random.default_rng(seed)))


def fitted(setup: rx.Setup, records: Sequence[JointRecord]) -> PreslidingFit:
    return identify_presliding(records, rx.RigidArm.from_setup(setup), setup.friction.elements)


@pytest.mark.parametrize(("noise", "seed"), [(0.0, 1), (0.5, 3)])
def test_known_bristles_come_out(shipped: rx.Setup, noise: float, seed: int) -> None:
    """From quantised encoders and noisy torques c0 comes back within 5 % and c1 within 15 %, joints 2 to 4."""
    setup = random_set(shipped, seed)
    fit = fitted(setup, measured(setup, oscillated(setup, ["joint_2", "joint_3", "joint_4"]), noise, seed))
    for outcome in outcomes(fit.estimates[1:4], setup.friction.elements[1:4]):
        assert abs(outcome.error) < {"c0": 0.05, "c1": 0.15}[outcome.parameter], outcome


def test_bristles_of_the_wrist_separate(shipped: rx.Setup) -> None:
    """The elements of joints 5, 6 and 5+6 come back apart, also where 6 and 5+6 are so weak that they break away."""
    seed = 5
    setup = random_set(shipped, seed)
    runs = oscillated(setup, WRIST)
    quiet, loud = (
        outcomes(fitted(setup, measured(setup, runs, noise, seed)).estimates[4:], setup.friction.elements[4:])
        for noise in (0.25, 20.0)
    )
    for outcome in quiet:
        assert abs(outcome.error) < {"c0": 0.05, "c1": 0.15}[outcome.parameter], outcome
        assert abs(outcome.score) < 4.0, outcome
    assert any(not outcome.identifiable for outcome in loud)
    assert all(abs(outcome.score) < 4.0 for outcome in loud if outcome.identifiable), loud


@pytest.fixture(scope="module")
def fourth(shipped: rx.Setup) -> tuple[rx.Setup, list[Any]]:
    setup = random_set(shipped, 3)
    return setup, oscillated(setup, ["joint_4"])


def test_intervals_hold_the_truth(fourth: tuple[rx.Setup, list[Any]]) -> None:
    """Of 12 intervals from six draws of the rig's noise, 10 or more hold the truth, and errors share no sign."""
    setup, runs = fourth
    found = []
    for seed in range(6):
        fit = fitted(setup, measured(setup, runs, 1.0, seed))
        found += outcomes(fit.estimates[3:4], setup.friction.elements[3:4])
    scores = np.array([outcome.score for outcome in found])
    assert np.sum(np.abs(scores) < 1.96) >= 10, scores
    for name in ("c0", "c1"):
        own = [outcome.score for outcome in found if outcome.parameter == name]
        assert abs(np.mean(own)) < 1.2, own
        assert np.std(own) > 0.3, own  # deviations are not too large either


def with_gaps(record: JointRecord) -> JointRecord:
    return some_rows(record, (record.time + 0.7) % 3.0 >= 0.2)


def with_spikes(record: JointRecord) -> JointRecord:
    rng = np.random.default_rng(2)
    torque, position = record.torque.copy(), record.position.copy()
    for values, size in ((torque, 100.0), (position, 2e-3)):
        rows = rng.integers(0, len(values), int(record.time[-1]))
        values[rows, FOURTH] += size * rng.choice([-1.0, 1.0], len(rows))
    return replace(record, torque=torque, position=position)


@pytest.mark.parametrize("corrupt", [with_gaps, with_spikes])
def test_corrupted_records_give_the_same_bristles(
    fourth: tuple[rx.Setup, list[Any]], corrupt: Callable[[JointRecord], JointRecord]
) -> None:
    """Gaps and spikes leave c0 within 5 % and c1 within 15 %; joints at rest have no number, and the reason."""
    setup, runs = fourth
    fit = fitted(setup, [corrupt(record) for record in measured(setup, runs, 0.5, 3)])
    for outcome in outcomes(fit.estimates[FOURTH:][:1], setup.friction.elements[FOURTH:][:1]):
        assert abs(outcome.error) < {"c0": 0.05, "c1": 0.15}[outcome.parameter], outcome
    first = fit.estimates[0]["c0"]
    assert np.isnan(first.value)
    assert not first.identifiable
    assert "micro-oscillation" in first.reason


def heavier(arm: rx.RigidArm) -> rx.RigidArm:
    model = arm.model.copy()
    for body in list(model.inertias)[1:]:
        body.mass, body.inertia = 2.0 * body.mass, 2.0 * body.inertia
    return replace(arm, model=model, rotor=2.0 * arm.rotor)


def shifted(time: Array, torque: Array, delay: float) -> Array:
    return np.column_stack([np.interp(time - delay, time, column) for column in torque.T])


@pytest.mark.parametrize(
    ("change", "delay", "reason"),
    [
        (heavier, 0.0, "the inertia at joint_4 would be"),
        (lambda arm: arm, 5e-3, "delay"),
        (lambda arm: arm, -5e-3, "delay"),
    ],
)
def test_a_wrong_inertia_or_delay_gives_a_reason(
    fourth: tuple[rx.Setup, list[Any]], change: Callable[[rx.RigidArm], rx.RigidArm], delay: float, reason: str
) -> None:
    """Inertias wrong by a factor of 2, and a torque stamped 5 ms early or late, give no number, and the reason."""
    setup, runs = fourth
    arm, records = change(rx.RigidArm.from_setup(setup)), measured(setup, runs, 0.5, 3)
    late = [replace(record, torque=shifted(record.time, record.torque, delay)) for record in records]
    fit = identify_presliding(late, arm, setup.friction.elements)
    for estimate in fit.estimates[FOURTH].values():
        assert not estimate.identifiable
        assert reason in estimate.reason


def test_a_joint_that_slides_gives_a_reason(shipped: rx.Setup) -> None:
    """Oscillations that break the bristles away throughout give no number but say so."""
    options = PlanOptions(
        groups=("joint_6",), burst=4.0, presliding_cycles=(2e-3,) * 2, tone_amplitudes=(2.4e-3, 1.5e-3)
    )
    runs = run_presliding(shipped, options)
    rng = np.random.default_rng(0)
    fit = fitted(shipped, [recorded(shipped, run, rng, Noise(0.0)) for run in runs])
    for estimate in fit.estimates[5].values():
        assert "slide in every micro-oscillation" in estimate.reason


def test_an_unknown_payload_gives_no_wrong_bristles(shipped: rx.Setup, tmp_path: Path) -> None:
    """With 1 kg on the flange that the description lacks, the wrist's c0 and c1 are right or not identifiable."""
    file = tmp_path / "tool.yaml"
    tool = yaml.safe_load(config_path("robots/rx90b/tool.yaml").read_text(encoding="utf-8"))
    # The tool with a point mass of 1 kg at (0.03, -0.02, 0.15) m.
    tool["inertial"]["mass"] = 4.5
    tool["inertial"]["center_of_mass"] = [0.00667, -0.00444, 0.11111]
    tool["inertial"]["inertia"] = [0.01226, 0.01264, 0.00601, 0.00047, -0.00117, 0.00078]
    file.write_text(yaml.safe_dump(tool), encoding="utf-8")
    loaded = rx.Setup.load(rx.RobotFiles(tool=file))
    fit = fitted(shipped, measured(loaded, oscillated(loaded, WRIST), 0.5))
    found = outcomes(fit.estimates[4:], shipped.friction.elements[4:])
    assert not all(outcome.identifiable for outcome in found)
    for outcome in found:
        if outcome.identifiable:
            assert abs(outcome.error) < {"c0": 0.05, "c1": 0.15}[outcome.parameter], outcome


def test_a_record_that_tells_nothing_is_refused(shipped: rx.Setup) -> None:
    """A record without small reversals is refused with its name; one that is too slow by the command's test."""
    still = np.zeros((4000, 6))
    record = JointRecord(shipped.robot.joint_names, np.arange(4000) / 1e3, still, still, still, Path("bag"), "0")
    with pytest.raises(IdentificationError, match="bag: no velocity reversals small enough"):
        identify_presliding([record], rx.RigidArm.from_setup(shipped), shipped.friction.elements)
