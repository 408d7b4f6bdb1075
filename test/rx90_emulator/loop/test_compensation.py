"""What feed-forward by the controller's model does for the arm: on the reference task, at rest, over joins."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import full_friction
import numpy as np
import pytest
from own_model import by_model, scaled, with_friction

import rx90_emulator as rx
from rx90_common.description.coupling import RX_WRIST
from rx90_common.friction.compiled_elements import prescribed_torque
from rx90_common.friction.parts.bristles import BristlesPart, ElastoPlastic, MaxwellSlip
from rx90_common.rigid_torque import rigid_torque
from rx90_emulator.loop.closed_loop import simulate_commands
from rx90_emulator.loop.line import LineRun, run_line
from rx90_emulator.loop.result import MotionCommand

HOME = np.array([0.1, 0.5, 1.2, 0.2, 0.9, 0.3])
PARTS = {name: part for name, part in full_friction.PARTS.items() if name != "scatter"}
BRISTLES: dict[str, Callable[[rx.FrictionElement], BristlesPart]] = {
    "elasto_plastic": lambda _: ElastoPlastic(break_away=0.7),
    "maxwell_slip": lambda element: MaxwellSlip(
        stiffness=(0.5, 0.3, 0.2), share=(0.2, 0.3, 0.5), attraction=20.0 * element.tau_c.positive
    ),
}


@pytest.fixture(scope="module")
def own(shipped: rx.Setup) -> LineRun:
    return run_line(shipped, rx.load_task())


def test_with_the_right_model_the_path_error_is_below_30_micrometres(shipped: rx.Setup, own: LineRun) -> None:
    """The reference task: 0.085 mm with the CS7B's own feed-forward, at most 0.03 mm with both parts of the model."""
    assert own.path_accuracy.worst == pytest.approx(0.0847e-3, rel=0.01)
    both = run_line(by_model(shipped), rx.load_task()).path_accuracy
    assert both.worst < 0.03e-3
    assert both.rms < 0.05 * own.path_accuracy.rms


@pytest.mark.parametrize("kind", list(BRISTLES))
def test_with_parts_in_plant_and_model_the_path_error_is_as_small(shipped: rx.Setup, tmp_path: Path, kind: str) -> None:
    """Load, cold joints, ripple and other bristles: still below 0.03 mm, where a model without them is above."""
    elements = tuple(e.replaced(**PARTS, bristles=BRISTLES[kind](e)) for e in shipped.friction.elements)
    parted = dataclasses.replace(shipped, friction=dataclasses.replace(shipped.friction, elements=elements))
    parted = with_friction(parted, elements, tmp_path / "friction.yaml")
    right = run_line(by_model(parted), rx.load_task()).path_accuracy
    plain = dataclasses.replace(parted, controller=shipped.controller)
    assert right.worst < 2e-6
    assert run_line(by_model(plain), rx.load_task()).path_accuracy.worst > 0.03e-3


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_a_friction_model_30_percent_off_is_better_than_none(
    shipped: rx.Setup, own: LineRun, tmp_path: Path, factor: float
) -> None:
    """Off by 30 %, the model leaves less than the CS7B's own compensation with the right values, and does not hunt."""
    setup = with_friction(by_model(shipped), scaled(shipped.friction, factor), tmp_path / "friction.yaml")
    task = dataclasses.replace(rx.load_task(), rest_after=2.5)
    run = run_line(setup, task)
    assert run.path_accuracy.worst < 0.6 * own.path_accuracy.worst
    swing = [np.ptp(each.slow.joint_states[-1000:, 0], axis=0) for each in (run_line(shipped, task), run)]
    assert np.all(swing[1] <= swing[0] + 1e-6), swing
    assert np.ptp(run.slow.reference[-1000:, 2], axis=0).max() == 0.0


def test_joins_leave_the_model_as_it_is(shipped: rx.Setup) -> None:
    """Over pre-emption and stop, what is fed forward follows from the set-points alone, as in one motion."""
    rest = np.zeros((1, 6))
    motions = [rx.TrajectoryPoints(np.array([0.6]), HOME[None] + offset, rest, rest) for offset in (0.08, -0.02)]
    commands = (MotionCommand(20, motions[0]), MotionCommand(270, motions[1]), MotionCommand(500, None))
    run = simulate_commands(by_model(shipped), commands, HOME, 1.0)
    position, velocity = run.slow.reference[:, 0], run.slow.reference[:, 1]
    acceleration = run.slow.details[:, 0]
    late = by_model(shipped).cs7b().law[0]["model"]["lead"]
    at = velocity + late * acceleration
    steps = np.full(len(at), shipped.rates.position_period)
    inputs = RX_WRIST.element_matrix
    friction = prescribed_torque(shipped.friction.elements, at @ inputs.T, steps) @ inputs
    drives, there = shipped.drives, position + late * (velocity + 0.5 * late * acceleration)
    rigid = rigid_torque(shipped.robot.model, drives.rotor_matrix, drives.spring_torque, there, at, acceleration)
    assert np.abs(velocity[270:]).max() > 0.1
    assert np.abs(run.slow.reference[:, 2] - friction - rigid).max() < 1e-9
    # And it does not jump where velocities and accelerations do not.
    assert np.abs(np.diff(friction, axis=0)).max() < 6.0


def test_a_sweep_switches_the_parts(shipped: rx.Setup) -> None:
    """By its path each part is switched on alone, and the plant's parameters leave the controller's model as it is."""
    law = rx.with_parameters(shipped, {"controller.feed_forward.friction_model": True}).cs7b().law[0]
    changed = {"friction.*.tau_c": 1.2, "arm.link_6.mass": 9.0, "controller.feed_forward.inverse_dynamics": True}
    both = rx.with_parameters(rx.with_parameters(shipped, {"controller.feed_forward.friction_model": True}), changed)
    other = both.cs7b().law[0]
    assert (law["model"]["parts"], other["model"]["parts"]) == (2, 3)
    assert np.array_equal(law["model"]["friction"], other["model"]["friction"])
    assert np.array_equal(law["model"]["arm"], other["model"]["arm"])
