"""The collision geometry of arm and tool, by the checker that comes with Pinocchio."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from rx90_emulator.loop.setup import Setup

# Pinocchio 2 has coal under its old name, with other names in it.
coal = pytest.importorskip("coal" if pin.__version__ >= "3" else "hppfcl")
Transform = coal.Transform3s if pin.__version__ >= "3" else coal.Transform3f

POSES = {
    "straight up": [0.0] * 6,
    "start of the reference task": [-0.464, 0.75, 1.449, 0.0, 0.943, -0.464],
    "elbow down": [0.5, 1.2, 1.2, 0.7, -0.6, 1.0],
    "wrist bent as far as it goes": [0.0, 0.3, 0.9, 0.0, 2.0943, 0.0],
    "wrist bent the other way": [0.0, 0.3, 0.9, 0.0, -1.8325, 0.0],
}
TX40_POSES = {
    "straight up": [0.0] * 6,
    "start of the reference task": [-0.493, 0.87, 1.157, 0.0, 1.114, -0.493],
    "wrist bent as far as it goes": [0.0, 0.3, 0.9, 0.0, 2.33, 0.0],
    "wrist bent the other way": [0.5, 1.2, 1.2, 0.7, -2.094, 1.0],
}


def link_of(model: Any, geometry: Any) -> int:
    """Return the moving link of a geometry, 0 for the base; what is fixed to a link is that link."""
    frame = model.frames[geometry.parentFrame]
    return int(frame.parentJoint if pin.__version__ >= "3" else frame.parent)


def overlaps(setup: Setup, kind: Any, position: list[float]) -> set[tuple[int, int]]:
    """Return the pairs of links that overlap and are no neighbours."""
    model = setup.robot.model
    shapes = pin.buildGeomFromUrdfString(model, setup.robot.urdf, kind)
    data, placed = model.createData(), shapes.createData()
    pin.updateGeometryPlacements(model, data, shapes, placed, np.array(position))
    found = set()
    for a, b in itertools.combinations(range(shapes.ngeoms), 2):
        links = tuple(sorted(link_of(model, shapes.geometryObjects[i]) for i in (a, b)))
        if links[1] - links[0] < 2:
            continue
        transforms = [Transform(placed.oMg[i].rotation, placed.oMg[i].translation) for i in (a, b)]
        geometries = [shapes.geometryObjects[i].geometry for i in (a, b)]
        result = coal.CollisionResult()
        pairs = zip(geometries, transforms, strict=True)
        if coal.collide(*itertools.chain.from_iterable(pairs), coal.CollisionRequest(), result):
            found.add(links)
    return found


@pytest.mark.parametrize("pose", POSES)
def test_links_that_are_no_neighbours_do_not_overlap(shipped: Setup, pose: str) -> None:
    """Neither shapes nor collision geometry of two links that no joint connects touch, the tool's included."""
    assert overlaps(shipped, pin.COLLISION, POSES[pose]) == set()
    assert overlaps(shipped, pin.VISUAL, POSES[pose]) == set()


@pytest.mark.parametrize("pose", TX40_POSES)
def test_neither_do_those_of_the_tx40(tx40: Setup, pose: str) -> None:
    """The same holds for the TX40, whose wrist bends further."""
    assert overlaps(tx40, pin.COLLISION, TX40_POSES[pose]) == set()
    assert overlaps(tx40, pin.VISUAL, TX40_POSES[pose]) == set()


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
    """Return points on the edges of a box or cylinder, or on a sphere, in the frame of its link."""
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


def test_the_tool_can_be_hit(shipped: Setup) -> None:
    """The tool has collision geometry: with the wrist bent back and the elbow folded it meets the arm."""
    shapes = pin.buildGeomFromUrdfString(shipped.robot.model, shipped.robot.urdf, pin.COLLISION)
    of_tool = [s for s in shapes.geometryObjects if s.name.startswith("tool_")]
    assert [2.0 * s.geometry.halfLength for s in of_tool] == pytest.approx([0.13, 0.04])
    assert [s.geometry.radius for s in of_tool] == [0.04, 0.016]
    assert overlaps(shipped, pin.COLLISION, [0.0, 0.0, 2.4, 0.0, 1.7, 0.0])
