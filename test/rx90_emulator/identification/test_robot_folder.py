"""Identified robots as files: Pinocchio and the robot that the numbers came from are the oracles."""

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
import yaml
from foreign_arms import urdf_text
from grip_arm import JOINTS, write_urdf
from schema_faults import schema_faults

import rx90_emulator as rx
from rx90_common.base.arrays import Array
from rx90_common.description.assumed_files import assumed_files
from rx90_common.description.coupling import Coupling
from rx90_common.description.joint_model import joint_model, robot_of_urdf
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_emulator.cli.frame import run
from rx90_emulator.configuration.origins import robot_values
from rx90_emulator.identification.bodies import (
    BaseEstimate,
    ConsistentInertias,
    InertialPrior,
    consistent_inertias,
)
from rx90_emulator.identification.estimates import PARAMETERS, IdentifiedElement, ParameterEstimate
from rx90_emulator.identification.output.friction_file import friction_text
from rx90_emulator.identification.output.robot_files import FolderBase, folder_base, robot_texts
from rx90_emulator.identification.records import BagSource
from rx90_emulator.identification.rows.filtering import Bandwidths
from rx90_emulator.identification.rows.rigid import BaseGroups, StandardColumns

pytestmark = pytest.mark.slow

RNG = np.random.default_rng(5)
DATE = datetime(2026, 1, 1, tzinfo=timezone.utc)
SEEN = 12.0  # rad/s^2, of the second joint in the runs
FIXED = """<link name="tool"><inertial><origin xyz="0 0 0.1"/><mass value="1.5"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><mesh filename="package://arm/meshes/a>b.stl"/></geometry></visual>
</link><!-- kept --><link name="bare"/><link name="dust"><inertial><mass value="0.1"/><inertia ixx="0" iyy="0" izz="0"
 ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="t" type="fixed"><origin xyz="0.1 0 0.3" rpy="0.2 0 1"/><parent link="c_link"/><child link="tool"/></joint>
<joint name="d" type="fixed"><origin xyz="0.1 0 0"/><parent link="a_link"/><child link="dust"/></joint>
<joint name="u" type="fixed"><origin xyz="0 0.2 0.3"/><parent link="tool"/><child link="bare"/></joint></robot>"""


def element_of(element: rx.FrictionElement, source: BagSource) -> IdentifiedElement:
    estimates = {
        name: ParameterEstimate.unknown("too short")
        if name in ("omega_s", "c0", "c1")
        else ParameterEstimate(element.parameters[name], 0.01)
        for name in PARAMETERS
    }
    return IdentifiedElement(element, estimates, dict.fromkeys(PARAMETERS, (source,)))


def estimate_of(columns: StandardColumns, theta: Array) -> BaseEstimate:
    """Return the base parameters of standard ones, known to 1e-7 of the torque."""
    groups = BaseGroups.of(columns)
    known = np.eye(len(groups.names))
    return BaseEstimate(
        groups.combination, groups.combination @ theta, 1e7 * known, np.ones(len(known), dtype=np.bool_)
    )


def identified(
    arm: rx.RigidArm, inertias: ConsistentInertias, columns: StandardColumns, elements: tuple[IdentifiedElement, ...],
    source: BagSource, fallback: str | None = None,
) -> Any:  # fmt: skip
    done = np.zeros((2, len(arm.names)))
    done[1, 1] = -SEEN
    bands = Bandwidths(30.0, 10.0)
    runs = (SimpleNamespace(bandwidths=bands, acceleration=done),)
    problem = SimpleNamespace(arm=arm, columns=columns, runs=runs)
    robot = SimpleNamespace(fallback_name=fallback, setup=None)
    consistency, bags = inertias, (("excitation", source),)
    given = {"problem": problem, "robot": robot, "consistency": consistency, "elements": elements, "bags": bags,
             "compared": bands}  # fmt: skip
    ranges = ((0.05, 2.0),) * len(elements)
    fitted = SimpleNamespace(speeds=ranges)
    stated = {"unit": "Nm", "in_currents": (), "element_notes": {}, "notes": ()}
    return SimpleNamespace(**given, **stated, arm=arm, date=DATE, fitted=fitted)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> BagSource:
    bag = tmp_path_factory.mktemp("bags") / "run--1.mcap"
    bag.write_bytes(b"")
    return BagSource(bag, "0" * 64, 60.0, 0, 1_767_225_600.0)


class Case(NamedTuple):
    """The shipped robot, a wrong description of it, and the folder that was identified from exact base parameters."""

    true: rx.Setup
    before: rx.Setup
    columns: StandardColumns
    parameters: Array
    files: RobotFiles


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory, source: BagSource) -> Case:
    place, shipped = tmp_path_factory.mktemp("robot"), RobotFiles()
    text = shipped.urdf.read_text()
    wrong = re.sub(r'(mass value|ixx|iyy|izz)="([\d.]+)"', lambda m: f'{m[1]}="{float(m[2]) * 1.3:g}"', text)
    (place / "wrong.urdf").write_text(wrong)
    drives = yaml.safe_load(shipped.drives.read_text())
    drives["transmission"]["rotor_inertia"] = [2.0, 4.0, 0.8, 0.3, 0.1, 0.0]
    drives["spring"]["torque"] = [0.0, 90.0, 0.0, 0.0, 0.0, 0.0]
    (place / "drives.yaml").write_text(yaml.dump(drives))
    law = yaml.safe_load(shipped.controller.read_text())
    law["model"] = {"urdf": "wrong.urdf", "drives": "drives.yaml", "friction": str(shipped.friction)}
    (place / "base.yaml").write_text(yaml.dump(law))
    base = replace(shipped, urdf=place / "wrong.urdf", drives=place / "drives.yaml", controller=place / "base.yaml")
    true, before = rx.Setup.load(), rx.Setup.load(base)
    arm = rx.RigidArm.from_setup(before)
    columns = StandardColumns(arm)
    rotors = before.drives.rotor_inertia
    prior = InertialPrior.of_urdf(before.robot.urdf, arm.names, rotors, [90.0], known=["tool"])
    values = StandardColumns(rx.RigidArm.from_setup(true)).values()
    inertias = consistent_inertias(estimate_of(columns, values), prior)
    elements = tuple(element_of(one, source) for one in true.friction.elements)
    result = identified(arm, inertias, columns, elements, source, "other.yaml")
    for name, text in robot_texts(result, base.urdf, FolderBase.of(base)).items():
        (place / name).write_text(text)
    return Case(true, before, columns, inertias.parameters, RobotFiles.named(str(place)))


def test_folder_of_an_identified_robot_is_the_robot(case: Case) -> None:
    """The folder's torques by Pinocchio are the regressor's and the true robot's, and so is its closed loop."""
    found = rx.Setup.load(case.files)
    motion = RNG.uniform(-2.0, 2.0, (3, 20, 6))
    written = rx.RigidArm.from_setup(found).torque(*motion)
    np.testing.assert_allclose(written, case.columns.torque(*motion) @ case.parameters, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(written, rx.RigidArm.from_setup(case.true).torque(*motion), rtol=0.0, atol=1e-4)
    true, near, far = (run_of(setup) for setup in (case.true, found, case.before))
    np.testing.assert_allclose(near, true, rtol=0.0, atol=1e-8)
    assert np.abs(far - true).max() > 1e-6


def test_folder_says_where_its_values_come_from(case: Case) -> None:
    """What was identified names its bags; friction from elsewhere stays assumed; all else is as it was."""
    shipped, files = RobotFiles(), case.files
    drives, law, friction = (
        yaml.safe_load(file.read_text()) for file in (files.drives, files.controller, files.friction)
    )
    assert drives["transmission"]["provenance"] == {"gear": "assumed", "rotor_inertia": "identified"}
    rotors = drives["transmission"]["source"]["rotor_inertia"]
    assert "run--1.mcap (recorded 20" in rotors
    # What the spring and the weight of the upper arm give is one term in sin(q2).
    assert drives["spring"]["provenance"] == "identified"
    true = case.true.drives.spring_torque[1]
    assert abs(drives["spring"]["torque"][1] - true) < 0.5 * abs(90.0 - true)
    assert drives["brake"] == yaml.safe_load(shipped.drives.read_text())["brake"]
    assert law["feed_forward"]["provenance"]["coulomb_torque"] == "derived"
    assert law["feed_forward"]["provenance"]["coulomb_velocity"] == "assumed"
    assert law["servo"] == yaml.safe_load(shipped.controller.read_text())["servo"]
    assert "model" not in law, "the controller's model is the arm of the folder, not the base's"
    assert friction["provenance"] == "identified"
    bristle = friction["identification"]["parameters"]["joint_5_6"]["c0"]
    assert (bristle["provenance"], bristle["taken_from"]) == ("assumed", "other.yaml")
    assert yaml.safe_load(files.tool.read_text()) == yaml.safe_load(shipped.tool.read_text())


def test_folder_is_one_that_editors_and_rx90_config_accept(case: Case) -> None:
    """Each written file fits its schema and names none by a path that leads nowhere; what is assumed is shown so."""
    for role, name in FILES.items():
        path: Path | None = getattr(case.files, role)
        if role != "urdf" and path is not None:
            assert schema_faults(role, path) == [], name
            assert "yaml-language-server" not in path.read_text(encoding="utf-8")
    folder = str(case.files.urdf.parent)
    assert run("rx90 config", ["check", folder]) == 0
    shown = {one.name: one.provenance for one in robot_values(RobotFiles.named(folder))}
    assert shown["drives.transmission.rotor_inertia"] == "identified"
    assert shown["friction.elements.joint_5_6.c0"] == "assumed"


def run_of(setup: rx.Setup) -> Array:
    start, end = np.array([0.2, 0.4, 1.0, 0.3, 0.6, -0.2]), np.array([0.22, 0.38, 1.03, 0.25, 0.63, -0.15])
    names, rest = setup.robot.joint_names, np.zeros(6)
    points = rx.TrajectoryPoints.create(names, names, [0.0, 0.15], [start, end], [rest] * 2, [rest] * 2)
    return np.array(rx.simulate(setup, points).slow.joint_states[:, 0])


def test_urdf_of_any_arm_has_the_identified_torque(tmp_path: Path, source: BagSource) -> None:
    """Pinocchio's torque of the written URDF is the regressor's; the tool and nothing else of the URDF is changed."""
    urdf = urdf_text(["a", "b", "c"], ["0 0 1", "0 1 0", "0 1 0"], [4.0, 3.0, 2.0]).replace("</robot>", FIXED)
    file = tmp_path / "arm.urdf"
    file.write_text(urdf)
    arm = rx.RigidArm.from_urdf(file, ["a", "b", "c"])
    columns = StandardColumns(arm)
    theta = columns.values()
    theta[:30] *= np.repeat([1.2, 0.9, 1.4], 10)
    theta[30:33], theta[33:] = 0.1, [0.5, -0.2, 0.3]
    prior = InertialPrior.of_urdf(file, arm.names, [0.0, 0.0, 0.1])
    assert prior.dropped == ("dust",)
    inertias = consistent_inertias(estimate_of(columns, theta), prior)
    element = rx.FrictionElement(tau_c=1.0, tau_s=1.5, omega_s=0.05, delta=1.0, c0=1e4, c1=1.0, c2=0.5)
    result = identified(arm, inertias, columns, (element_of(element, source),) * 3, source)
    base, why = folder_base(arm, file)
    assert base is None
    assert why.startswith("URDF and friction file alone, no robot folder: ")
    texts = robot_texts(result, file, None)
    assert set(texts) == {"robot.urdf", "friction.yaml"}
    friction = yaml.safe_load(texts["friction.yaml"])
    assert list(friction["elements"]) == ["provenance", "a", "b", "c"]
    assert friction["elements"]["provenance"] == {"omega_d": "assumed"}
    assert [friction["joints"][name]["rotor_inertia"] for name in "abc"] == pytest.approx(inertias.rotors, rel=1e-5)
    assert [friction["joints"][name]["offset"] for name in "abc"] == pytest.approx(theta[33:], rel=1e-4)

    written = pin.buildModelFromXML(texts["robot.urdf"])
    data = written.createData()
    q, v, a = RNG.uniform(-2.0, 2.0, (3, 10, 3))
    links = np.array([pin.rnea(written, data, *row) for row in zip(q, v, a, strict=True)])
    expected = columns.torque(q, v, a) @ inertias.parameters
    np.testing.assert_allclose(links + a * inertias.rotors + inertias.parameters[33:], expected, rtol=0.0, atol=1e-11)
    assert np.abs(inertias.shift).max() < 1e-6
    assert rest_of(texts["robot.urdf"]) == rest_of(urdf)
    assert '<!-- kept --><link name="bare" />' in texts["robot.urdf"]
    assert "recorded 20" in texts["robot.urdf"].partition("<link")[0]


def test_a_joint_that_turns_without_end_changes_no_assumed_value(tmp_path: Path) -> None:
    """Drives and controller are those of the same arm whose joint turns by half a turn either way."""
    file = write_urdf(tmp_path, continuous=True)
    tree = ET.parse(file)
    endless = tree.find(f"joint[@name='{JOINTS[6]}']")
    limit = endless.find("limit")
    found = []
    for kind in ("continuous", "revolute"):
        endless.set("type", kind)
        tree.write(file)
        robot = robot_of_urdf(file, JOINTS)
        found.append(assumed_files(robot, joint_model(file, JOINTS), Coupling(np.eye(7)), np.full(7, 0.1), {}))
        limit.set("lower", str(-math.pi))
        limit.set("upper", str(math.pi))
    assert found[0] == found[1]


def rest_of(urdf: str) -> str:
    root = ET.fromstring(urdf)
    for link in root.findall("link"):
        for inertial in link.findall("inertial"):
            link.remove(inertial)
    return re.sub(r"\s+", "", ET.tostring(root, encoding="unicode")).replace("></link>", "/>")


def test_the_compensation_is_the_identified_friction(case: Case) -> None:
    """Motor 6 turns against two elements, whose sum it compensates."""
    written = yaml.safe_load(case.files.controller.read_text())["feed_forward"]
    assert written["viscous_friction"] == [14.0, 14.0, 7.0, 2.0, 1.5, 0.7]
    assert written["viscous_exponent"] == [1.0] * 6
    assert written["coulomb_torque"] == [25.0, 28.0, 18.0, 6.0, 4.0, 3.5]


@pytest.mark.parametrize(
    ("parameter", "value", "deviation"),
    [
        ("tau_s_positive", 1e48, 1.0),
        ("c2", 1.0, math.nan),
        ("c2", 1.0, 1e48),
    ],
)
def test_no_absurd_friction_is_written(source: BagSource, parameter: str, value: float, deviation: float) -> None:
    """A friction value that no arm has, or a deviation that is absurd or no number, is refused by name in one line."""
    good = element_of(rx.FrictionElement(tau_c=1.0, tau_s=1.5, omega_s=0.05, delta=1.0, c0=1e4, c1=1.0, c2=0.5), source)
    robot = SimpleNamespace(fallback_name=None)
    stated = {"unit": "Nm", "element_notes": {}, "arm": SimpleNamespace(element_names=["a"])}
    result: Any = SimpleNamespace(**stated, robot=robot, date=DATE, elements=[good])
    assert "tau_c: 1.0" in friction_text(result, ["a"], {})
    estimates = {**good.estimates, parameter: ParameterEstimate(value, deviation)}
    bad = replace(good, element=good.element.with_parameters({parameter: value}), estimates=estimates)
    said = rf"a\.{parameter}\.(value|deviation) is (1e\+48|nan)"
    result.elements = [bad]
    with pytest.raises(rx.Rx90Error, match=said):
        friction_text(result, ["a"], {})
