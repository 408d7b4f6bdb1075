"""What MoveIt is given of each shipped robot, held against its other files and, by Pinocchio, against its shapes."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml

from rx90_common.base.share import config_path
from rx90_common.description.robot_files import RobotFiles, shipped_robots
from rx90_emulator.identification.experiments.plan import Poses
from rx90_emulator.loop.setup import Setup
from tools import moveit_files

FOLDER = config_path("moveit")
POSES = 800


@pytest.fixture(scope="module", params=shipped_robots())
def setup(request: pytest.FixtureRequest) -> Setup:
    """Return each shipped robot."""
    return Setup.load(RobotFiles.named(request.param))


@pytest.fixture(scope="module")
def folder(setup: Setup) -> Path:
    """Return the robot's folder of files for MoveIt."""
    assert setup.files is not None
    return setup.files.urdf.parent / "moveit"


@pytest.fixture(scope="module")
def semantic(folder: Path) -> ET.Element:
    """Return the root of the SRDF."""
    return ET.parse(folder / "robot.srdf").getroot()


def disabled(semantic: ET.Element, reason: str) -> set[frozenset[str]]:
    """Return the pairs of links that are not checked, for a reason."""
    pairs = semantic.findall(f"disable_collisions[@reason='{reason}']")
    return {frozenset((pair.attrib["link1"], pair.attrib["link2"])) for pair in pairs}


class Shapes:
    """The collision geometry as Pinocchio has it; `srdf` leaves out the pairs that are not checked."""

    def __init__(self, setup: Setup, srdf: str | None = None) -> None:
        self.model = model = setup.robot.model
        self.shapes = pin.buildGeomFromUrdfString(model, setup.robot.urdf, pin.COLLISION)
        self.shapes.addAllCollisionPairs()
        if srdf is not None:
            pin.removeCollisionPairsFromXML(model, self.shapes, srdf)
        self.owners = [model.frames[shape.parentFrame].name for shape in self.shapes.geometryObjects]
        self.data, self.placed = model.createData(), self.shapes.createData()

    def touching(self, position: Any) -> set[frozenset[str]]:
        """Return the pairs of different links that touch in a pose, rad."""
        pin.computeCollisions(self.model, self.data, self.shapes, self.placed, np.asarray(position), False)
        found = zip(self.shapes.collisionPairs, self.placed.collisionResults, strict=True)
        pairs = {frozenset((self.owners[p.first], self.owners[p.second])) for p, r in found if r.isCollision()}
        return {pair for pair in pairs if len(pair) == 2}


def test_links_of_which_no_pair_is_checked_never_touch(setup: Setup, semantic: ET.Element) -> None:
    """In 800 random poses, many with joints at their limits, no pair that is "Never" touches, but others do."""
    shapes, robot = Shapes(setup), setup.robot
    rng = np.random.default_rng(20)
    middle, reach = (robot.lower + robot.upper) / 2.0, (robot.upper - robot.lower) / 2.0
    poses = np.clip(middle + 1.5 * reach * rng.uniform(-1.0, 1.0, (POSES, len(middle))), robot.lower, robot.upper)
    touched = set().union(*map(shapes.touching, poses))
    never = disabled(semantic, "Never")
    assert never != set()
    assert touched & never == set()
    assert touched - disabled(semantic, "Adjacent") != set()


def test_adjacent_links_are_joined(setup: Setup, semantic: ET.Element) -> None:
    """The pairs that are "Adjacent" are those of links that follow each other in Pinocchio's tree of moving joints."""
    model = setup.robot.model
    links = {name: model.frames[model.getFrameId(name, pin.BODY)] for name in set(Shapes(setup).owners)}
    joints = {
        name: int(frame.parentJoint if hasattr(frame, "parentJoint") else frame.parent) for name, frame in links.items()
    }
    joined = {
        frozenset((a, b))
        for a, b in itertools.combinations(joints, 2)
        if abs(joints[a] - joints[b]) <= 1 and "tool" not in (a, b)
    }
    if "tool" in joints:
        joined.add(frozenset(("tool", "link_6")))
    assert disabled(semantic, "Adjacent") == joined


def test_named_poses_are_those_of_the_poses_file_and_free_of_collisions(setup: Setup, folder: Path) -> None:
    """Read by Pinocchio, each named pose is that of poses.yaml, within the limits, and no checked pair touches."""
    assert setup.files is not None
    text = (folder / "robot.srdf").read_text(encoding="utf-8")
    model = setup.robot.model.copy()
    pin.loadReferenceConfigurationsFromXML(model, text, False)
    found = {pose.key(): pose.data() for pose in model.referenceConfigurations}
    poses = yaml.safe_load(setup.files.required("poses").read_text(encoding="utf-8"))
    expected = {"home": poses["home"]["position"]}
    for kind in ("sweep", "validation"):
        block = poses[f"{kind}s" if kind == "sweep" else kind]["positions"]
        expected |= {f"{kind}_{i}": position for i, position in enumerate(block, 1)}
    assert {name: list(position) for name, position in found.items()} == expected
    shapes = Shapes(setup, text)
    for name, position in found.items():
        assert (np.clip(position, setup.robot.lower, setup.robot.upper) == position).all(), name
        assert shapes.touching(position) == set(), name


def test_limits_leave_room_below_those_of_the_robot(setup: Setup, folder: Path) -> None:
    """Each joint of the URDF has 95 % of its velocity and half of the controller's acceleration, rounded down."""
    assert setup.files is not None
    limits = yaml.safe_load((folder / "joint_limits.yaml").read_text(encoding="utf-8"))["joint_limits"]
    urdf = ET.parse(setup.files.urdf).getroot()
    controller = yaml.safe_load(setup.files.controller.read_text(encoding="utf-8"))["trajectory"]
    joints = urdf.findall("joint[@type='revolute']")
    assert list(limits) == [joint.get("name") for joint in joints]
    for joint, most in zip(joints, controller["max_acceleration"], strict=True):
        given, limit = limits[joint.get("name")], joint.find("limit")
        assert limit is not None
        assert (given["has_velocity_limits"], given["has_acceleration_limits"]) == (True, True)
        assert 0.0 <= 0.95 * float(limit.attrib["velocity"]) - given["max_velocity"] < 1e-4
        assert given["max_acceleration"] == pytest.approx(0.5 * most, abs=1e-4)
    assert f"which is {controller['provenance']} there" in (folder / "joint_limits.yaml").read_text(encoding="utf-8")


def test_the_files_are_those_that_the_tool_writes(setup: Setup, folder: Path, semantic: ET.Element) -> None:
    """But for the search for pairs that touch, `python -m tools.moveit_files` would write the files as they are."""
    assert setup.files is not None
    all_pairs = {frozenset(pair) for pair in itertools.combinations(set(Shapes(setup).owners), 2)}
    touching = all_pairs - disabled(semantic, "Never")
    poses = Poses.load(setup.files.required("poses"))
    texts = moveit_files.moveit_texts(setup, poses, touching)
    assert texts == {name: (folder / name).read_text(encoding="utf-8") for name in texts}
    assert {path.name for path in folder.iterdir()} == set(texts)


def test_names_agree_in_all_files(setup: Setup, semantic: ET.Element) -> None:
    """Group, chain, tool, links, action and start tolerance are the same in all files and in the robot's own."""
    urdf = ET.fromstring(setup.robot.urdf)
    links = {link.get("name") for link in urdf.findall("link")}
    named = {e.get(key) for e in semantic.iter() for key in ("link1", "link2", "base_link", "tip_link", "parent_link")}
    named |= {link.get("name") for link in semantic.iter("link")}
    assert named - {None} <= links
    assert ("tool" in links) == (semantic.find("end_effector") is not None)
    assert semantic.get("name") == urdf.get("name")
    chain = semantic.find("group[@name='manipulator']/chain")
    assert chain is not None
    assert chain.attrib == {"base_link": "base_link", "tip_link": "tool0"}

    files = {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in FOLDER.iterdir()}
    assert list(files["kinematics"]) == ["manipulator"]
    assert set(files["ompl_planning"]["manipulator"]["planner_configs"]) == set(
        files["ompl_planning"]["planner_configs"]
    )
    (name,) = files["moveit_controllers"]["moveit_simple_controller_manager"]["controller_names"]
    controller = files["moveit_controllers"]["moveit_simple_controller_manager"][name]
    assert f"{name}/{controller['action_ns']}" == "rx90_controller/follow_joint_trajectory"
    execution = files["moveit_controllers"]["trajectory_execution"]
    assert execution["allowed_start_tolerance"] == setup.controller.start_tolerance
