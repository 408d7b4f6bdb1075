"""Write the files for MoveIt that follow from a robot folder's others: moveit/robot.srdf and moveit/joint_limits.yaml.

    python -m tools.moveit_files              # of all shipped robots
    python -m tools.moveit_files ~/my_robot   # of a robot folder

Needed again after a change of shapes, joints, limits, tool, poses or max_acceleration;
test/rx90_common/description/test_shapes.py fails until then.
"""

from __future__ import annotations

import argparse
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import yaml

from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.description.poses import Poses
from rx90_common.description.robot import RobotModel
from rx90_common.description.robot_files import RobotFiles, shipped_robots
from rx90_emulator.loop.setup import Setup

GROUP, TIP, TOOL = "manipulator", "tool0", "tool"
POSES = 50_000
_MARGIN = 0.005  # m: what comes as near as that in a sample may touch between the samples
# MoveIt sends points 0.1 s apart. The controller's quintic between two of them exceeds the acceleration of a profile
# that switches there by up to 81 %, and its velocity by up to 0.068 of acceleration times 0.1 s.
ACCELERATION_SHARE = 0.5
VELOCITY_SHARE = 0.95

_HEAD = (
    "Written by `python -m tools.moveit_files` from the other files of this folder: do not edit."
)


def shape_links(robot: RobotModel) -> list[str]:
    """Return the links that have collision geometry, as the URDF lists them."""
    links = ET.fromstring(robot.urdf).findall("link")
    return [link.get("name", "") for link in links if link.find("collision") is not None]


def adjacent_pairs(robot: RobotModel) -> list[tuple[str, str]]:
    """Return the pairs of links with collision geometry that joints connect; links without any are passed over."""
    joints = ET.fromstring(robot.urdf).findall("joint")
    above = {_link(joint, "child"): _link(joint, "parent") for joint in joints}
    shaped, pairs = shape_links(robot), []
    for link in shaped:
        before = above.get(link)
        while before is not None and before not in shaped:
            before = above.get(before)
        if before is not None:
            pairs.append((before, link))
    return pairs


def _link(joint: ET.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def touching_pairs(
    robot: RobotModel, count: int = POSES, margin: float = _MARGIN
) -> set[frozenset[str]]:
    """Return the pairs of links that come nearer to each other than `margin`, m, in one of `count` random poses.

    In these each joint is at a limit as often as not: some pairs come near each other there alone.
    """
    model = robot.model
    try:
        shapes = pin.buildGeomFromUrdfString(model, robot.urdf, pin.COLLISION)
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(
            f"the collision geometry: {reason}; accepted: shapes, and meshes that are there"
        ) from error
    owners = [model.frames[shape.parentFrame].name for shape in shapes.geometryObjects]
    shapes.addAllCollisionPairs()
    for pair in list(shapes.collisionPairs):
        if owners[pair.first] == owners[pair.second]:
            shapes.removeCollisionPair(pair)
    data, placed = model.createData(), shapes.createData()
    for request in placed.collisionRequests:
        request.security_margin = margin
    pairs = [frozenset((owners[pair.first], owners[pair.second])) for pair in shapes.collisionPairs]
    touching: set[frozenset[str]] = set()
    rng = np.random.default_rng(0)
    beyond = robot.upper - robot.lower
    positions = rng.uniform(
        robot.lower - beyond / 2.0, robot.upper + beyond / 2.0, (count, len(beyond))
    )
    for position in np.clip(positions, robot.lower, robot.upper):
        pin.computeCollisions(model, data, shapes, placed, position, False)
        touching.update(
            pair
            for pair, found in zip(pairs, placed.collisionResults, strict=True)
            if found.isCollision()
        )
    return touching


def semantic_text(setup: Setup, poses: Poses | None, touching: set[frozenset[str]]) -> str:
    """Return the SRDF: the groups, the named poses, and the pairs of links that need no check."""
    robot = setup.robot
    root = ET.Element("robot", name=robot.model.name)
    root.append(ET.Comment(f" {_HEAD} "))
    group = ET.SubElement(root, "group", name=GROUP)
    with_tool = setup.files.tool is not None
    ET.SubElement(
        group, "chain", base_link=_base(robot), tip_link=TIP if with_tool else robot.tcp_frame
    )
    if with_tool:
        held = ET.SubElement(root, "group", name=TOOL)
        for name in (TOOL, robot.tcp_frame):
            ET.SubElement(held, "link", name=name)
        ET.SubElement(
            root, "end_effector", name=TOOL, parent_link=TIP, group=TOOL, parent_group=GROUP
        )
    if poses is not None:
        root.append(ET.Comment(" From poses.yaml, rad. "))
    for name, position in _named(poses):
        state = ET.SubElement(root, "group_state", name=name, group=GROUP)
        for joint, angle in zip(robot.joint_names, position, strict=True):
            ET.SubElement(state, "joint", name=joint, value=repr(float(angle)))
    never = f"nearer than {_MARGIN * 1e3:g} mm in none of {POSES:,} random poses, many of them at joint limits"
    root.append(ET.Comment(f" Adjacent: a joint connects them. Never: {never}. "))
    for first, second, reason in disabled_pairs(robot, touching):
        ET.SubElement(root, "disable_collisions", link1=first, link2=second, reason=reason)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def disabled_pairs(robot: RobotModel, touching: set[frozenset[str]]) -> list[tuple[str, str, str]]:
    """Return the pairs of links that need no check, each with the reason, from base to tool."""
    order = shape_links(robot)
    adjacent = {frozenset(pair) for pair in adjacent_pairs(robot)}
    found = []
    for i, first in enumerate(order):
        for second in order[i + 1 :]:
            pair = frozenset((first, second))
            if pair in adjacent:
                found.append((first, second, "Adjacent"))
            elif pair not in touching:
                found.append((first, second, "Never"))
    return found


def _base(robot: RobotModel) -> str:
    root = ET.fromstring(robot.urdf)
    children = {_link(joint, "child") for joint in root.findall("joint")}
    return next(
        name for link in root.findall("link") if (name := link.get("name", "")) not in children
    )


def _named(poses: Poses | None) -> list[tuple[str, tuple[float, ...]]]:
    if poses is None:
        return []
    sweeps = [(f"sweep_{i}", position) for i, position in enumerate(poses.sweeps.positions, 1)]
    others = [
        (f"validation_{i}", position) for i, position in enumerate(poses.validation.positions, 1)
    ]
    return [("home", poses.home.position), *sweeps, *others]


def limits_text(setup: Setup, said: str) -> str:
    """Return joint_limits.yaml; `said` is the provenance of the controller's accelerations."""
    lines = [
        f"# {_HEAD}",
        f"# Velocities: {VELOCITY_SHARE:g} of those in robot.urdf; what these are: there.",
        f"# Accelerations: {ACCELERATION_SHARE:g} of max_acceleration in controller.yaml, which is {said} there.",
        "# The rest is for what the controller's splines add between MoveIt's points: docs/howto/moveit.md.",
        "joint_limits:",
    ]
    robot, most = setup.robot, setup.controller.max_acceleration
    for joint, velocity, acceleration in zip(
        robot.joint_names, robot.max_velocity, most, strict=True
    ):
        lines += [
            f"  {joint}:",
            "    has_velocity_limits: true",
            f"    max_velocity: {_down(VELOCITY_SHARE * velocity)}  # rad/s",
            "    has_acceleration_limits: true",
            f"    max_acceleration: {_down(ACCELERATION_SHARE * acceleration)}  # rad/s^2",
        ]
    return "\n".join(lines) + "\n"


def _down(value: float) -> float:
    """Return a limit with four decimals, none higher."""
    return float(np.floor(value * 1e4) / 1e4)


def moveit_texts(
    setup: Setup, poses: Poses | None, touching: set[frozenset[str]]
) -> dict[str, str]:
    """Return the text of each file by its name; `touching` are the pairs of links that are to be checked."""
    controller = yaml.safe_load(setup.files.controller.read_text(encoding="utf-8"))
    return {
        "robot.srdf": semantic_text(setup, poses, touching),
        "joint_limits.yaml": limits_text(setup, controller["trajectory"]["provenance"]),
    }


def main() -> None:
    """Write the files."""
    parser = argparse.ArgumentParser(
        description="Write robot.srdf and joint_limits.yaml for MoveIt."
    )
    parser.add_argument(
        "robots", nargs="*", default=shipped_robots(), help="shipped robots or robot folders"
    )
    try:
        for name in parser.parse_args().robots:
            write(RobotFiles.named(name))
    except Rx90Error as error:
        parser.exit(error.exit_code, f"moveit_files: {error}\n")


def write(files: RobotFiles) -> None:
    """Write the files of one robot into its folder.

    Raises:
        ConfigError: for a file that cannot be used.
    """
    setup = Setup.load(files)
    poses = None if files.poses is None else Poses.load(files.poses)
    texts = moveit_texts(setup, poses, touching_pairs(setup.robot))
    folder = files.urdf.parent / "moveit"
    folder.mkdir(exist_ok=True)
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="utf-8")
        print(folder / file)


if __name__ == "__main__":
    main()
