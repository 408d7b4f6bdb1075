"""Rigid-body torques against the plant's own arm, and for arms of other robots."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from rx90_common.base.errors import ConfigError, IdentificationError
from rx90_common.friction.friction_file import JointTorques
from rx90_emulator.identification.arm import RigidArm

TWO_LINKS = """<robot name="two"><link name="base"/>
<link name="a"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
  <inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><origin xyz="0.5 0 0"/><mass value="1"/>
  <inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="finger"><inertial><mass value="0.1"/>
  <inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/></joint>
<joint name="elbow" type="revolute"><origin xyz="1 0 0"/><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
<joint name="grip" type="prismatic"><origin xyz="1 0 0"/><parent link="b"/><child link="finger"/><axis xyz="1 0 0"/>
  <limit lower="0" upper="1" velocity="1" effort="1"/></joint></robot>"""


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "two.urdf"
    path.write_text(TWO_LINKS, encoding="utf-8")
    return path


def test_the_regressor_is_the_derivative_by_the_inertial_parameters(arm: RigidArm) -> None:
    """The regressor times Pinocchio's own parameters is the rigid torque without rotors, spring and offsets."""
    rng = np.random.default_rng(1)
    q, v, a = (rng.uniform(-1, 1, (20, 6)) for _ in range(3))
    parameters = np.concatenate([body.toDynamicParameters() for body in list(arm.model.inertias)[1:]])
    rest = a @ arm.rotor.T + arm.spring * np.sin(q)
    assert np.abs(arm.regressor(q, v, a) @ parameters + rest - arm.torque(q, v, a)).max() < 1e-9
    shifted, offset = arm.with_joints({"joint_2": JointTorques(offset=3.0)}), np.array([0.0, 3.0, 0.0, 0.0, 0.0, 0.0])
    assert np.abs(shifted.torque(q, v, a) - offset - arm.torque(q, v, a)).max() < 1e-9


def test_any_arm_with_a_gripper_held(urdf: Path) -> None:
    """Two rods with point masses carry the torques of the textbook, a joint without limits among them."""
    two = RigidArm.from_urdf(urdf, ["shoulder", "elbow"], rotor_inertia=[0.5, 0.2])
    q = np.array([[math.pi / 3, -math.pi / 3]])
    zero = np.zeros((1, 2))
    elbow = 9.81 * (1.0 * 0.5 + 0.1 * 1.0) * math.cos(0.0)
    shoulder = elbow + 9.81 * (2.0 * 0.5 + 1.1 * 1.0) * math.cos(math.pi / 3)
    # The axes point along +y, about which a weight at +x turns forwards.
    assert two.torque(q, zero, zero)[0] == pytest.approx([-shoulder, -elbow], rel=1e-6)
    jerk = two.torque(q, zero, np.array([[0.0, 1.0]])) - two.torque(q, zero, zero)
    assert jerk[0, 1] == pytest.approx(0.2 + 1.0 * 0.25 + 0.1 * 1.0, rel=1e-6)


def test_a_coupling_makes_an_element_of_its_own(urdf: Path) -> None:
    """A motor that turns with both joints has a friction element and puts its rotor into all four entries."""
    two = RigidArm.from_urdf(urdf, ["shoulder", "elbow"], [[1, 0], [1, 1]], [0.5, 0.2])
    assert two.element_names == ("shoulder", "elbow", "shoulder+elbow")
    differential = RigidArm.from_urdf(urdf, ["shoulder", "elbow"], [[1, 1], [1, -0.5]])
    assert differential.element_names == ("shoulder", "elbow", "shoulder+elbow", "shoulder-0.5*elbow")
    assert np.array_equal(two.element_matrix, [[1, 0], [0, 1], [1, 1]])
    assert np.allclose(two.rotor, [[0.7, 0.2], [0.2, 0.2]])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"joints": ["wrist"]}, "no movable joint 'wrist'; there are shoulder, elbow, grip"),
        ({"joints": ["elbow", "shoulder"]}, "accepted: from base to tip, shoulder, elbow"),
        ({"coupling": np.zeros((2, 2))}, "accepted: an invertible matrix"),
    ],
)
def test_what_does_not_fit_is_refused(urdf: Path, arguments: dict[str, object], message: str) -> None:
    """An unknown joint, a wrong order or a wrong shape is refused with what is accepted."""
    with pytest.raises(IdentificationError, match=message):
        RigidArm.from_urdf(urdf, **({"joints": ["shoulder", "elbow"]} | arguments))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        # The parser below Pinocchio drops such a body, says so on stderr, and goes on without it.
        ('mass value="', 'mass value="nan', r"no URDF that Pinocchio can read \(Inertial: mass \[nan"),
        ('mass value="', 'mass value="-', "the mass of link '.*' is -[0-9.]+ kg; accepted: 0 to 100000 kg"),
    ],
)
def test_a_file_that_is_no_urdf_is_refused(
    urdf: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    """Text that is no URDF, or holds a body of no number, is refused in one line with the path, and nothing else."""
    path = tmp_path / "no.urdf"
    path.write_text(urdf.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ConfigError, match=rf"no\.urdf: {said}") as caught:
        RigidArm.from_urdf(path)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_kinematics_of_a_urdf_without_inertials(urdf: Path, tmp_path: Path) -> None:
    """Where only kinematics are wanted, links need no <inertial>, and the regressor is the same without it."""
    bare = tmp_path / "bare.urdf"
    text = urdf.read_text(encoding="utf-8").replace("<origin ", '<origin note="made by hand" ')
    bare.write_text(re.sub(r"<inertial>.*?</inertial>", "", text, flags=re.DOTALL))
    with pytest.raises(IdentificationError, match="accepted: links with <inertial>"):
        RigidArm.from_urdf(bare, ["shoulder", "elbow"])
    joints = ["shoulder", "elbow"]
    weightless, whole = RigidArm.from_urdf(bare, joints, massless=True), RigidArm.from_urdf(urdf, joints)
    motion = np.random.default_rng(3).uniform(-1.0, 1.0, (3, 4, len(whole.names)))
    np.testing.assert_allclose(weightless.regressor(*motion), whole.regressor(*motion), atol=1e-13)
