"""Shapes and collision geometry of the shipped robots by Pinocchio's checker, and what MoveIt is given of them."""

import itertools
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml

from rx90_common.base.share import config_path
from rx90_common.description.poses import Poses
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import RobotFiles, shipped_robots
from rx90_common.description.shapes import drawn_shapes
from rx90_emulator.loop.setup import Setup
from tools import moveit_files

FOLDER = config_path("moveit")
POSES = 800


@pytest.fixture(scope="module", params=shipped_robots())
def setup(request: pytest.FixtureRequest) -> Setup:
    return Setup.load(RobotFiles.named(request.param))


@pytest.fixture(scope="module")
def folder(setup: Setup) -> Path:
    return setup.files.urdf.parent / "moveit"


@pytest.fixture(scope="module")
def semantic(folder: Path) -> ET.Element:
    return ET.parse(folder / "robot.srdf").getroot()


def disabled(semantic: ET.Element, reason: str) -> set[frozenset[str]]:
    pairs = semantic.findall(f"disable_collisions[@reason='{reason}']")
    return {frozenset((pair.attrib["link1"], pair.attrib["link2"])) for pair in pairs}


class Shapes:
    """The collision geometry as Pinocchio has it; `srdf` leaves out pairs that are not checked."""

    def __init__(self, setup: Setup, srdf: str | None = None) -> None:
        self.model = model = setup.robot.model
        self.shapes = pin.buildGeomFromUrdfString(model, setup.robot.urdf, pin.COLLISION)
        self.shapes.addAllCollisionPairs()
        if srdf is not None:
            pin.removeCollisionPairsFromXML(model, self.shapes, srdf)
        frames = [model.frames[shape.parentFrame] for shape in self.shapes.geometryObjects]
        self.owners = [frame.name for frame in frames]
        # The number of the moving joint that carries each link, 0 for the base; Pinocchio 2 calls it `parent`.
        self.joints = {f.name: int(f.parentJoint if hasattr(f, "parentJoint") else f.parent) for f in frames}
        self.data, self.placed = model.createData(), self.shapes.createData()

    def touching(self, position: Any) -> set[frozenset[str]]:
        pin.computeCollisions(self.model, self.data, self.shapes, self.placed, np.asarray(position), False)
        found = zip(self.shapes.collisionPairs, self.placed.collisionResults, strict=True)
        pairs = {frozenset((self.owners[p.first], self.owners[p.second])) for p, r in found if r.isCollision()}
        return {pair for pair in pairs if len(pair) == 2}

    def overlapping(self, position: Any) -> set[frozenset[str]]:
        return {pair for pair in self.touching(position) if np.ptp([self.joints[link] for link in pair]) > 1}


@pytest.mark.parametrize("robot", ["shipped", "tx40"])
def test_what_is_seen_is_what_collides(robot: str, request: pytest.FixtureRequest) -> None:
    """Of each link every visual shape lies within 13 mm of the collision geometry, and that within 13 mm of those."""
    setup: Setup = request.getfixturevalue(robot)
    model = setup.robot.model
    kinds = [pin.buildGeomFromUrdfString(model, setup.robot.urdf, kind) for kind in (pin.VISUAL, pin.COLLISION)]
    seen, hit = ([shape for shape in shapes.geometryObjects if "tool" not in shape.name] for shapes in kinds)
    assert {shape.parentFrame for shape in seen} == {shape.parentFrame for shape in hit}
    for shapes, others in ((seen, hit), (hit, seen)):
        for shape in shapes:
            near = [other for other in others if other.parentFrame == shape.parentFrame]
            points = surface(shape)
            gap = np.min([outside(other, points) for other in near], axis=0)
            assert gap.max() < 0.013, shape.name


def surface(shape: Any) -> np.ndarray:
    geometry, place = shape.geometry, shape.placement
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(24)])
    if type(geometry).__name__ == "Box":
        points = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3))) * geometry.halfSide
    elif type(geometry).__name__ == "Cylinder":
        points = np.vstack([ring * geometry.radius + [0.0, 0.0, z * geometry.halfLength] for z in (-1.0, 0.0, 1.0)])
    else:
        points = np.vstack([ring, ring[:, [0, 2, 1]], ring[:, [2, 0, 1]]]) * geometry.radius
    return points @ place.rotation.T + place.translation


def outside(shape: Any, points: np.ndarray) -> np.ndarray:
    """Return how far points lie outside a shape of the same link, m."""
    geometry, place = shape.geometry, shape.placement
    x, y, z = ((points - place.translation) @ place.rotation).T
    if type(geometry).__name__ == "Box":
        beyond = np.maximum(np.abs([x, y, z]) - geometry.halfSide[:, None], 0.0)
    elif type(geometry).__name__ == "Cylinder":
        beyond = np.maximum([np.hypot(x, y) - geometry.radius, np.abs(z) - geometry.halfLength], 0.0)
    else:
        beyond = np.maximum([np.sqrt(x**2 + y**2 + z**2) - geometry.radius], 0.0)
    return np.asarray(np.sqrt((beyond**2).sum(axis=0)))


def test_the_tool_can_be_hit(shipped: Setup, tx40: Setup) -> None:
    """With the wrist bent back and the elbow folded it meets the arm; with a wrist as far bent alone nothing does."""
    shapes = Shapes(shipped)
    of_tool = [s for s in shapes.shapes.geometryObjects if s.name.startswith("tool_")]
    assert [2.0 * s.geometry.halfLength for s in of_tool] == pytest.approx([0.13, 0.04])
    assert [s.geometry.radius for s in of_tool] == [0.04, 0.016]
    assert shapes.overlapping([0.0, 0.0, 2.4, 0.0, 1.7, 0.0])
    for arm, wrist in ((shapes, 2.0943), (shapes, -1.8325), (Shapes(tx40), 2.33), (Shapes(tx40), -2.094)):
        assert arm.overlapping([0.0, 0.3, 0.9, 0.0, wrist, 0.0]) == set()


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
    joints = Shapes(setup).joints
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


def test_the_files_are_those_that_the_tool_writes(setup: Setup, folder: Path, semantic: ET.Element) -> None:
    """But for the search for pairs that touch, `python -m tools.moveit_files` would write the files as they are."""
    all_pairs = {frozenset(pair) for pair in itertools.combinations(set(Shapes(setup).owners), 2)}
    touching = all_pairs - disabled(semantic, "Never")
    poses = Poses.load(setup.files.required("poses"))
    texts = moveit_files.moveit_texts(setup, poses, touching)
    assert texts == {name: (folder / name).read_text(encoding="utf-8") for name in texts}
    assert {path.name for path in folder.iterdir()} == set(texts)


def test_names_agree_in_all_files(setup: Setup) -> None:
    """Group, action and start tolerance are the same in all files and in the robot's own."""
    files = {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in FOLDER.iterdir()}
    assert list(files["kinematics"]) == ["manipulator"]
    planning = files["ompl_planning"]
    assert set(planning["manipulator"]["planner_configs"]) == set(planning["planner_configs"])
    (name,) = files["moveit_controllers"]["moveit_simple_controller_manager"]["controller_names"]
    controller = files["moveit_controllers"]["moveit_simple_controller_manager"][name]
    assert f"{name}/{controller['action_ns']}" == "rx90_controller/follow_joint_trajectory"
    execution = files["moveit_controllers"]["trajectory_execution"]
    assert execution["allowed_start_tolerance"] == setup.controller.trajectory.start_tolerance


MESH = '<visual><geometry><mesh filename="package://nowhere/link.stl"/></geometry></visual>'


@pytest.mark.parametrize("visual", ["", MESH])
def test_rods_lead_from_joint_to_joint(tmp_path: Path, visual: str) -> None:
    """Without shapes, or with meshes that are not there, rods in any pose reach from each joint to the next."""
    text = re.sub(r"<visual.*?</visual>", "", RobotFiles().urdf.read_text(encoding="utf-8"), flags=re.DOTALL)
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(text.replace("</inertial>", f"</inertial>{visual}", 3), encoding="utf-8")
    robot = load_robot(urdf)
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, np.linspace(-0.5, 1.0, 6))
    stops = [np.zeros(3), *(data.oMi[k + 1].translation for k in range(6))]
    stops.append(data.oMf[model.getFrameId(robot.tcp_frame)].translation)
    ways = [(a, b) for a, b in itertools.pairwise(stops) if np.linalg.norm(b - a) > 0.06]
    rods = [shape for shape in drawn_shapes(robot) if shape.kind == "Cylinder"]
    assert len(rods) == len(ways) > 2
    for rod, way in zip(rods, ways, strict=True):
        place = data.oMi[rod.joint + 1]
        half = place.rotation @ rod.rotation[:, 2] * rod.half[2]
        center = place.act(rod.position)
        np.testing.assert_allclose([center - half, center + half], way, atol=1e-9)
