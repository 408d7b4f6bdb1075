"""What elements transmit along recorded motions, the columns of their load parts, and what is said of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sine_motions import motion_of

import rx90_emulator as rx
from benchmarks.load_parts import coefficients_of, payload_of, torque_of, transmitted_of
from rx90_common.base.arrays import Array
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.estimates import ElementEstimate, ParameterEstimate
from rx90_emulator.identification.excitation.choice import Scored
from rx90_emulator.identification.excitation.filtering import Bandwidths, filter_record
from rx90_emulator.identification.excitation.known_payload import (
    LoadParts,
    beyond_chance,
    load_columns,
    transmitted_torques,
    trimmed,
)
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.excitation.result import simulated_elements
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.loop.setup import Setup

RATE = 50.0
BODY = payload_of(6.0)
COEFFICIENTS = coefficients_of(2)


@pytest.fixture(scope="module")
def rx90b() -> Setup:
    """Return the arm with a spring, rotors and a coupled wrist."""
    return rx.load_setup()


def problem_of(setup: Setup, coefficients: Array, lead: float = 0.0) -> ExcitationProblem:
    """Return the equations of a bare and a loaded run, whose torques acted `lead` seconds before their stamps."""
    records = []
    for number, body in enumerate((None, BODY)):
        motion, late = (motion_of(number, 8.0, RATE, after) for after in (0.0, -lead))
        torque, time = torque_of(setup, late, body, coefficients), np.arange(len(motion[0])) / RATE
        name = f"run_{number}"
        records.append(JointRecord(setup.robot.joint_names, time, motion[0], motion[1], torque, Path(name), name))
    runs = [run for record in records for run in filter_record(record, Bandwidths(12.0, 4.0), torque_lead=lead)]
    return ExcitationProblem.of(RigidArm.from_setup(setup), runs, payloads=(None, BODY))


@pytest.fixture(scope="module")
def problem(rx90b: Setup) -> ExcitationProblem:
    """Return the equations of an arm with load parts."""
    return problem_of(rx90b, COEFFICIENTS)


def base_of(problem: ExcitationProblem, **more: float) -> Array:
    """Return the described base parameters, standard parameters being larger by some; by name."""
    values = problem.columns.values().copy()
    for name, value in more.items():
        values[problem.columns.names.index(name)] += value
    return np.asarray(problem.base.combination @ values)


def test_elements_transmit_what_links_springs_and_payload_take(problem: ExcitationProblem, rx90b: Setup) -> None:
    """All of it, without rotors and offsets: motor 6 carries joint 6, and that of joint 5 the rest of joint 5.

    A rotor that the runs tell from its link may be any; those of joints 1 and 2, which act as one with the links, are
    taken off as described. Oracle: Pinocchio's torques of the arm, with and without the payload, less the rotors'.
    """
    rotors, offsets = ([name for name in problem.columns.names if name.startswith(kind)] for kind in ("Ia", "offset"))
    found = transmitted_torques(problem, base_of(problem, **dict.fromkeys([*rotors[2:], *offsets], 0.4)))
    for run, body, load in zip(problem.runs, problem.payloads, found, strict=True):
        expected = transmitted_of(rx90b, (run.position, run.velocity, run.acceleration), body)[1]
        assert load == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("lead", [0.0, 0.45 / RATE])
def test_columns_give_the_torque_of_the_load_parts(lead: float, rx90b: Setup) -> None:
    """Also of torques that were recorded between the samples, whose reversals are where these are.

    Oracle: recorded torques of an arm with load parts less those of one without, through the same filter.
    """
    parted = problem_of(rx90b, COEFFICIENTS, lead)
    expected = parted.torque - problem_of(rx90b, np.zeros((7, 2)), lead).torque
    columns = load_columns(parted, transmitted_torques(parted, base_of(parted)))
    error = columns @ COEFFICIENTS.ravel() - expected
    for joint in range(6):
        rows = parted.joint == joint
        assert np.std(error[rows]) < 0.02 * np.std(expected[rows])


def test_what_is_taken_off_is_uncertain_as_the_coefficients_are(problem: ExcitationProblem) -> None:
    """The rows lose the parts' torque; what is unknown of that has the covariance of the coefficients, carried over."""
    base, spread = base_of(problem), np.random.default_rng(3).normal(size=(4, 4)) * 1e-3
    value = np.zeros((7, 2))
    value[[1, 4]] = COEFFICIENTS[[1, 4]]
    parts = LoadParts(value, (1, 4), spread @ spread.T, base, np.ones(7), ("",) * 7)
    columns = load_columns(problem, transmitted_torques(problem, base))
    without = parts.applied(problem)
    assert problem.torque - without.torque == pytest.approx(columns @ value.ravel(), abs=1e-9)
    some = np.arange(0, len(problem), 97)
    uncertain, own = without.uncertain[some], columns[some][:, [2, 3, 8, 9]]
    assert uncertain @ uncertain.T == pytest.approx(own @ (spread @ spread.T) @ own.T, abs=1e-12)


@pytest.mark.parametrize(
    ("value", "deviation", "reason"),
    [
        ([0.05, 0.08], (0.01, 0.01), None),
        ([0.05, 0.001], (0.01, 0.06), "the runs do not tell it: driving 5 +- 1 % and driven 0.1 +- 6 % of the load"),
        ([0.08, -0.031], (0.01, 0.01), "no load part has these coefficients: driving 8 +- 1 % and driven -3.1 +- 1 %"),
        ([0.96, 0.08], (0.01, 0.01), "no load part has these coefficients: driving 96 +- 1 %"),
        ([0.08, -0.029], (0.01, 0.01), None),
        # chi^2 of 2 degrees of freedom: 1 % of elements without a part are beyond 9.21.
        ([0.03, 0.0], (0.01, 0.01), "no more than chance: driving 3 +- 1 %"),
        ([0.031, 0.0], (0.01, 0.01), None),
    ],
)
def test_a_load_part_is_told_possible_and_beyond_chance(
    value: list[float], deviation: tuple[float, float], reason: str | None
) -> None:
    """Both deviations below 0.05, no share that falls by three deviations or exceeds 0.95, and chi^2 beyond chance."""
    found = beyond_chance([3], np.array(value), np.diag(deviation) ** 2)
    assert list(found) == ([] if reason is None else [3])
    assert reason is None or found[3].startswith(reason)


def test_chance_is_shared_among_the_elements() -> None:
    """Of seven elements each has a seventh of the 1 %: what is beyond chance for one alone is not for seven."""
    alone, seven = np.array([0.033, 0.0]), np.array([0.033, 0.0] * 7)
    assert not beyond_chance([0], alone, np.eye(2) * 1e-4)
    assert len(beyond_chance(range(7), seven, np.eye(14) * 1e-4)) == 7


def test_the_least_useful_part_goes_first() -> None:
    """Of two elements of which either predicts as well without its part, one keeps it, if both together need one."""
    errors = {(2, 4): 1.0, (4,): 0.998, (2,): 0.999, (): 1.5}  # weighted RMS, by the elements that have a part
    fit: Any = None

    def scored(kept: Sequence[int]) -> Scored:
        squares = np.full(20, errors[tuple(kept)] ** 2)
        return Scored(fit, np.zeros(20), {"blocks": (squares, 0.0)}, np.ones(20))

    kept, reasons, gain = trimmed((2, 4), scored)
    assert kept == (4,)
    assert list(reasons) == [2]
    assert reasons[2].startswith("with a load part, by blocks the error rises by 0.20 %")
    assert gain.startswith("by blocks the error falls by 33.47 %")


def test_each_element_gets_its_own_part(problem: ExcitationProblem) -> None:
    """Driving and driven with their deviations; who has none says why."""
    names, value = problem.arm.element_names, np.zeros((7, 2))
    value[[1, 4]] = [[0.031234567, 0.05], [0.0, 0.12]]
    reasons = ("", "", "why not", "", "", "", "")
    found = LoadParts(value, (1, 4), np.diag([1e-6, 4e-6, 9e-6, 1.6e-5]), base_of(problem), np.ones(7), reasons)
    assert found.deviation[[1, 4]] == pytest.approx(np.array([[1e-3, 2e-3], [3e-3, 4e-3]]))
    known = {name: ParameterEstimate(1.0, 0.1) for name in ("tau_c_positive", "tau_c_negative", "c2")}
    elements = simulated_elements([ElementEstimate(name, known, np.eye(3), ()) for name in names], None, found)
    parts = {e: one.element.load for e, one in enumerate(elements) if one.element.load is not None}
    assert {e: (part.driving, part.driven) for e, part in parts.items()} == {1: (0.0312346, 0.05), 4: (0.0, 0.12)}
    told = elements[1].estimates
    assert (told["load.driving"].deviation, told["load.driven"].value) == (pytest.approx(1e-3), 0.05)
    assert elements[2].estimates["load.driven"].reason == "why not"
