"""The closed loop of other arms: any number of joints and coupling, elastic gears, motors that turn the other way."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from elastic_arms import POSE, WRIST, elastic, floating, link_mass
from full_drives import DRIVE_BLOCKS
from full_friction import PARTS
from scipy.linalg import expm
from unchecked import unchecked

import rx90_emulator as rx
from benchmarks.any_arm import write_arm
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, SupervisionError
from rx90_common.description.coupling import ArmSize, Coupling
from rx90_common.description.drives import LINK, MOTOR
from rx90_common.friction import FrictionSet
from rx90_controller.law.model import ModelFiles
from rx90_emulator.loop.recorded_run import read_run, replay


def everything(setup: rx.Setup, side: str) -> rx.Setup:
    """Return the setup with all that is off in the shipped files, and encoders so fine that no count is in doubt."""
    drives = setup.drives.replaced(encoder={"counts_per_revolution": 2**30}, **DRIVE_BLOCKS)
    drives = drives.replaced(elasticity={"friction": side}, current_sensor={"resolution": np.zeros(6)})
    elements = tuple(element.replaced(**PARTS) for element in setup.friction.elements)
    switches = {"inverse_dynamics": True, "friction_model": True}
    files = setup.files
    model = ModelFiles(urdf=files.urdf, tool=files.tool, drives=files.drives, friction=files.friction)
    controller = setup.controller.replaced(feed_forward=switches, model=model)
    friction = FrictionSet(setup.friction.names, elements)
    return dataclasses.replace(setup, drives=drives, friction=friction, controller=controller)


@pytest.mark.parametrize("side", [MOTOR, LINK])
def test_matrices_give_what_the_wrists_fixed_order_gives(
    shipped: rx.Setup, side: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The shipped arm with everything on is the same, to rounding, by the code for any coupling and by its own."""
    setup = everything(shipped, side)
    rest, pose = np.zeros((2, 6)), np.array([0.0, 0.5, 0.8, 0.0, 0.5, 0.0])
    points = rx.TrajectoryPoints(np.array([0.0, 0.3]), np.stack([pose, pose + 0.05]), rest, rest)
    fixed = rx.simulate(setup, points, duration=0.35)
    monkeypatch.setattr(Coupling, "size", property(lambda _: ArmSize(6, 7, wrist=False)))
    by_matrices = rx.simulate(dataclasses.replace(setup, drives=setup.drives.replaced()), points, duration=0.35)
    assert by_matrices.slow.joint_states.tobytes() != fixed.slow.joint_states.tobytes(), "the same code ran twice"
    for name, got, want in zip(fixed.slow._fields, by_matrices.slow, fixed.slow, strict=True):
        scale = np.abs(want).max(axis=0, initial=0.0)
        assert (np.abs(got - want) <= 1e-7 * scale + 1e-10).all(), name


@pytest.mark.parametrize(
    ("file", "three", "said"),
    [
        ("drives.yaml", "torque_constant: [0.3, 0.3, 0.3]", "3 numbers, as many as"),
        ("controller.yaml", "kp: [50.0, 50.0, 50.0]", "kp is [50.0, 50.0]"),
    ],
)
def test_lists_of_another_length_are_refused(tmp_path: Path, file: str, three: str, said: str) -> None:
    """A list with another number of values than joints is one line with file, key and what is accepted."""
    folder = write_arm(tmp_path / "arm", 3)
    text = (folder / file).read_text()
    assert three in text
    (folder / file).write_text(text.replace(three, f"{three.rpartition(',')[0]}]"))
    with pytest.raises(ConfigError) as refused:
        rx.load_setup(robot=folder)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("turns", "said"),
    [
        ([[1, 0], [1, 0]], "1 in column 1 for a motor that turns with one joint"),
        ([[1, 1], [1, 1]], "an invertible matrix"),
        ([[1, 1, 0], [0, 1, 1]], "square, of 1 to 7 rows"),
        ((np.eye(7) + np.eye(7, k=-1)).tolist(), "up to 1, for 8 friction elements in all"),
    ],
)
def test_couplings_that_no_arm_has_are_refused(turns: Any, said: str) -> None:
    """Each refusal names the row or the matrix, and what is accepted."""
    with pytest.raises(ConfigError) as refused:
        Coupling(np.array(turns, np.float64))
    assert said in str(refused.value)


KP, KV, KI, INERTIA, BANDWIDTH, OBSERVER = 40.0, 80.0, 5e3, 8.0, 800.0, 400.0
STIFFNESS, DAMPING, ROTOR = 4e4, 8.0, 3.0


def soft_joint(shipped: rx.Setup) -> rx.Setup:
    """Return a setup in which joint 1 alone moves, on a soft gear without friction, under slow gains."""
    stiffness, damping, rotor = np.full(6, np.inf), np.zeros(6), np.full(6, 1e12)
    stiffness[0], damping[0], rotor[0] = STIFFNESS, DAMPING, ROTOR
    setup = elastic(floating(shipped), stiffness, damping)
    fine = {"counts_per_revolution": 2**40, "velocity_bandwidth": OBSERVER}
    drives = unchecked(setup.drives, transmission={"rotor_inertia": rotor}, encoder=fine)
    six = np.ones(6)
    controller = unchecked(
        setup.controller,
        servo={"kp": KP * six, "kv": KV * six, "ki": KI * six, "inertia": INERTIA * six},
        current_loop={"bandwidth": BANDWIDTH},
        supervision={"following_error": 1e3 * six, "over_speed": 1e3},
    )
    return dataclasses.replace(setup, drives=drives, controller=controller)


def loop_matrix(link: float, period: float, ratio: int) -> Array:
    """Return the change of (q, v, twist, rate, observer's angle and speed, torque, PI, integral) in a position tick.

    Written from the description of the law: PI at the position rate, D and a current loop of first order at the base
    rate, the velocity from a critically damped tracking loop; spring, damper and both masses by the matrix exponential.
    """
    s, d = STIFFNESS, DAMPING
    plant = np.array(
        [
            [0, 1, 0, 0, 0],
            [0, 0, s / link, d / link, 0],
            [0, 0, 0, 1, 0],
            [0, 0, -s / ROTOR - s / link, -d / ROTOR - d / link, 1 / ROTOR],
            [0, 0, 0, 0, 0],
        ]
    )
    held = expm(plant * period)
    pole, lag = math.exp(-2 * math.pi * OBSERVER * period), math.exp(-2 * math.pi * BANDWIDTH * period)

    def advance(x: Array) -> Array:
        x = x.copy()
        error = -(x[0] + x[2])
        x[8] += error * ratio * period
        x[7] = INERTIA * (KV * KP * error + KI * x[8])
        for _ in range(ratio):
            asked = x[7] - INERTIA * KV * x[5]
            x[6] = lag * x[6] + (1 - lag) * asked
            x[:4] = (held @ [*x[:4], x[6]])[:4]
            ahead = x[4] + period * x[5]
            innovation = x[0] + x[2] - ahead
            x[4] = ahead + (1 - pole**2) * innovation
            x[5] += (1 - pole) ** 2 / period * innovation
        return x

    return np.array([advance(unit) for unit in np.eye(9)]).T


def test_the_velocity_loop_sees_the_resonance(shipped: rx.Setup) -> None:
    """After a push the link rings on its gear, and both follow the linear loop: frequency, decay, phase."""
    setup = soft_joint(shipped)
    link, rates = link_mass(setup, POSE)[0, 0], setup.rates
    matrix = loop_matrix(link, rates.period, rates.ratio)
    plant, law = setup.plant(), setup.cs7b()
    plant.reset(POSE)
    law.reset(plant.motor_states()[0])
    state, want, found, expected = plant.state[0], np.zeros(9), [], []
    want[1], want[3] = 0.02, -0.02  # the link is pushed, its motor rests
    for k in range(2400):
        if k == rates.ratio:
            state["v"][0], state["transmission"]["rate"][0] = want[1], want[3]
        elif k % rates.ratio == 0 and k > 0:
            want = matrix @ want
            found.append([state["q"][0] - POSE[0], state["transmission"]["twist"][0]])
            expected.append(want[[0, 2]])
        position, velocity, _ = plant.motor_states()
        plant.step(law.step(position, velocity))
    got, answer = np.array(found), np.array(expected)
    assert np.abs(got - answer).max() < 2e-4 * np.abs(answer).max()
    poles = np.linalg.eigvals(matrix)
    ringing = max(poles, key=lambda pole: abs(pole) * (pole.imag > 0))
    twist = got[:300, 1]
    crossings = np.flatnonzero(np.signbit(twist[1:]) != np.signbit(twist[:-1]))
    instants = crossings + twist[crossings] / (twist[crossings] - twist[crossings + 1])
    assert np.pi / np.diff(instants) == pytest.approx(abs(np.angle(ringing)), rel=3e-3)
    # The integral and the lag of the motor put it below the resonance of a link on a motor that is held.
    assert abs(np.angle(ringing)) < rates.position_period * math.sqrt(STIFFNESS / link)


def test_joint_states_are_the_links_and_motor_states_the_motors(shipped: rx.Setup, tmp_path: Path) -> None:
    """A recorded run tells link from motor by the load over the stiffness, and done again it has the same bits."""
    stiffness = np.array([4e4, 4e4, 2e4, 5e3, 3e3, 1e3])
    setup = elastic(shipped, stiffness, 5e-4 * stiffness)
    rest = rx.TrajectoryPoints.create(
        setup.robot.joint_names, setup.robot.joint_names, [0.0, 0.2], [POSE] * 2, [np.zeros(6)] * 2, [[]] * 2
    )
    run = rx.simulate(setup, rest, record_fast=True)
    rx.write_bag(run, tmp_path / "bag")
    links = rx.read_joint_states(tmp_path / "bag", "joint_states")
    motors = rx.read_joint_states(tmp_path / "bag", "motor_states")
    twist = motors.position[0] / setup.drives.gear - WRIST @ links.position[0]
    plant = setup.plant()
    plant.reset(POSE)
    load = np.linalg.solve(WRIST.T, plant.state["bias"][0])
    assert np.abs(load[1:3] / stiffness[1:3]).max() > 1e-4
    assert twist == pytest.approx(load / stiffness, abs=2e-6)  # a count of motor 6 is 4 urad at the joint
    again = replay(setup, read_run(tmp_path / "bag", setup))
    assert again.slow.joint_states.tobytes() == run.slow.joint_states.tobytes()


TURNED = {"motor 4": [1, 1, 1, -1, 1, 1], "all but motor 5": [-1, -1, -1, -1, 1, -1], "motor 5": [1, 1, 1, 1, -1, 1]}


def with_motors(setup: rx.Setup, signs: list[int]) -> rx.Setup:
    return dataclasses.replace(setup, drives=setup.drives.replaced(transmission={"gear": setup.drives.gear * signs}))


@pytest.mark.parametrize("which", TURNED)
def test_a_motor_turned_round_changes_its_own_signs_and_nothing_else(
    shipped: rx.Setup, task: rx.LineTask, which: str
) -> None:
    """Motor positions, velocities, torques and currents change their signs; what joints do keeps its bits."""
    signs = TURNED[which]
    setup = with_motors(shipped, signs)
    usual, turned = (rx.run_line(s, task, record_fast=True).series for s in (shipped, setup))
    for topic, series in usual.items():
        for quantity in ("position", "velocity", "effort"):
            want, got = getattr(series, quantity), getattr(turned[topic], quantity)
            if want is not None:
                factor = signs if series.names[0].startswith("motor") else 1
                np.testing.assert_array_equal(got, want * factor, err_msg=f"{topic} {quantity}")


def test_the_supervision_takes_it_too(shipped: rx.Setup, task: rx.LineTask) -> None:
    """The power is cut at the same tick with the same words, where the error of a run without a limit goes beyond."""
    strict = shipped.controller.replaced(supervision={"following_error": np.full(6, 2e-5)})
    weak = dataclasses.replace(shipped, controller=strict)
    said = []
    for setup in (weak, with_motors(weak, [-1] * 6)):
        with pytest.raises(SupervisionError, match="following error") as caught:
            rx.run_line(setup, task)
        said.append(str(caught.value))
    assert said[0] == said[1]
    error = rx.run_line(shipped, task).slow.tracking_error[:, 0]
    tick, joint = np.argwhere(np.abs(error) > 2e-5)[0]
    assert said[0].startswith(f"joint_{joint + 1}: following error {error[tick, joint]:.4g} rad at {tick / 1000:.6g} s")


def test_the_tx40_stays_on_its_line(tx40: rx.Setup) -> None:
    """Its flange stays within 0.09 mm, as its controller file says, with no drive at its limit."""
    run = rx.run_line(tx40, rx.load_task(robot="tx40"))
    assert run.path_accuracy.worst < 9e-5
    assert not run.saturated.any()
