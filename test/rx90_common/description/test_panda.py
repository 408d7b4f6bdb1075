"""The Panda's files against what others published of this arm, written here once more."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import rx90_emulator as rx
from rx90_common.base.errors import ConfigError
from rx90_common.base.share import config_path
from rx90_common.description.kinematics import forward
from rx90_common.description.robot_files import RobotFiles
from rx90_common.friction.friction_file import FrictionFile
from rx90_emulator.loop.setup import Setup

# Franka Control Interface: modified Denavit-Hartenberg parameters a, d, alpha.
HALF = math.pi / 2
DH = (
    (0.0, 0.333, 0.0), (0.0, 0.0, -HALF), (0.0, 0.316, HALF), (0.0825, 0.0, HALF), (-0.0825, 0.384, -HALF),
    (0.0, 0.0, HALF), (0.088, 0.0, HALF),
)  # fmt: skip
FLANGE = 0.107
# Gaz and others (2019), by franka_ros: mass, centre of mass, inertia Ixx, Ixy, Ixz, Iyy, Iyz, Izz about that.
LINKS = (
    (4.970684, (0.003875, 0.002081, -0.04762), (0.70337, -0.000139, 0.006772, 0.70661, 0.019169, 0.009117)),
    (0.646926, (-0.003141, -0.02872, 0.003495), (0.007962, -0.003925, 0.010254, 0.02811, 0.000704, 0.025995)),
    (3.228604, (0.027518, 0.039252, -0.066502), (0.037242, -0.004761, -0.011396, 0.036155, -0.012805, 0.01083)),
    (3.587895, (-0.05317, 0.104419, 0.027454), (0.025853, 0.007796, -0.001332, 0.019552, 0.008641, 0.028323)),
    (1.225946, (-0.011953, 0.041065, -0.038437), (0.035549, -0.002117, -0.004037, 0.029474, 0.000229, 0.008627)),
    (1.666555, (0.060149, -0.014117, -0.010517), (0.001964, 0.000109, -0.001158, 0.004354, 0.000341, 0.005433)),
    (0.735522, (0.010517, -0.004252, 0.061597), (0.012516, -0.000428, -0.001196, 0.010027, -0.000741, 0.004815)),
)
READY = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])


@pytest.fixture(scope="module")
def panda() -> Setup:
    """Return the shipped Panda."""
    return Setup.load(RobotFiles.named("panda"))


@pytest.fixture(scope="module")
def published() -> pin.Model:
    """Return the published arm: its frames by Denavit and Hartenberg, its bodies by Gaz."""
    model = pin.Model()
    for k, ((a, d, alpha), (mass, center, inertia)) in enumerate(zip(DH, LINKS, strict=True)):
        c, s = math.cos(alpha), math.sin(alpha)
        rotation = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        place = pin.SE3(rotation, np.array([a, -s * d, c * d]))
        joint = model.addJoint(k, pin.JointModelRZ(), place, f"joint_{k + 1}")
        xx, xy, xz, yy, yz, zz = inertia
        about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.array(center), about), pin.SE3.Identity())
    return model


def test_the_flange_is_where_the_published_frames_put_it(panda: Setup, published: pin.Model) -> None:
    """In random poses the tool centre point is that of the Denavit-Hartenberg parameters, to rounding."""
    data = published.createData()
    for q in np.random.default_rng(1).uniform(panda.robot.lower, panda.robot.upper, (20, 7)):
        pin.forwardKinematics(published, data, q)
        flange = data.oMi[7].act(np.array([0.0, 0.0, FLANGE]))
        np.testing.assert_allclose(forward(panda.robot.chain, q)[0], flange, rtol=0.0, atol=1e-12)


def test_the_torques_are_those_of_the_published_model(panda: Setup, published: pin.Model) -> None:
    """Along motions like those identified from, the bodies' torques are within 4 % of those by Gaz, over all joints."""
    rng, robot = np.random.default_rng(2), panda.robot
    middle, reach = (robot.lower + robot.upper) / 2.0, (robot.upper - robot.lower) / 2.0
    q = middle + 0.6 * reach * rng.uniform(-1.0, 1.0, (300, 7))
    v, a = (0.5 * rng.uniform(-1.0, 1.0, (300, 7)) * scale for scale in (robot.max_velocity, 4.0))
    models = [(model, model.createData()) for model in (robot.model, published)]
    got, want = (np.array([pin.rnea(*one, *row) for row in zip(q, v, a, strict=True)]) for one in models)
    assert np.linalg.norm(got - want) < 0.04 * np.linalg.norm(want)
    assert (np.linalg.norm(got - want, axis=0) > 0.0).all(), "the published model itself, not an identified one"


def test_limits_and_friction_are_those_of_their_sources(panda: Setup) -> None:
    """Joint space limits are the manufacturer's; the friction is the library's, and says how well it is known."""
    robot = panda.robot
    assert robot.lower.tolist() == [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]
    assert robot.upper.tolist() == [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]
    assert robot.max_velocity.tolist() == [2.175] * 4 + [2.61] * 3
    assert robot.max_effort.tolist() == [87.0] * 4 + [12.0] * 3
    assert panda.cs7b().trajectory.limits.acceleration.tolist() == [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0]
    own, library = (
        FrictionFile.read(config_path(name))
        for name in ("robots/panda/friction.yaml", "friction/library/panda_gaz.yaml")
    )
    assert own.elements == library.elements
    assert own.identification["parameters"].keys() == own.elements.keys()


def test_a_controller_of_ones_own_holds_seven_joints(panda: Setup) -> None:
    """Gravity by Pinocchio and weak springs in a function hold the arm; six efforts are refused."""
    model, data = panda.robot.model, panda.robot.model.createData()
    stiffness = np.array([200.0] * 4 + [20.0] * 2 + [4.0])

    def law(position: np.ndarray, velocity: np.ndarray, _: float) -> np.ndarray:
        gravity = pin.computeGeneralizedGravity(model, data, position)
        return np.asarray(gravity + stiffness * (READY - position) - 0.05 * stiffness * velocity)

    run = rx.run_controller(panda, law, 0.2, initial_position=READY)
    assert run.joint_states.shape == run.friction_states.shape == (200, 3, 7)
    assert np.abs(run.joint_states[:, 0] - READY).max() < 1e-4
    assert run.series["joint_states"].names == panda.robot.joint_names
    with pytest.raises(ConfigError, match="accepted: 7 finite efforts, Nm, or None"):
        rx.run_controller(panda, lambda *_: np.zeros(6), 0.01, initial_position=READY)
