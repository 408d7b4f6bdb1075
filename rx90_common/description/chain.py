"""The arm of a URDF as a chain of rigid bodies, the constants that compiled code and kinematics use.

Pinocchio gives the same numbers to rounding, but the last bits differ between its builds.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.rotations import (
    dot,
    length,
    outer,
    product,
    rotated,
    rpy_rotation,
    symmetric,
    transposed,
)
from rx90_common.description.urdf import LinkBody, bodies, placements

_GRAVITY = (0.0, 0.0, -9.81)


class RigidChain(NamedTuple):
    """The arm in link frames that are all parallel to the base at q = 0.

    Link i rotates about `axis[i]` through `origin[i]`, both constant in the frame of link i-1 (the base for
    the first), so that no fixed rotation is left: R_i = R_(i-1)·Rot(axis_i, q_i) and
    p_i = p_(i-1) + R_(i-1)·origin_i.
    A NamedTuple, because numba takes one as an argument. The arrays are left writable, because numba
    compiles a kernel a second time for read-only ones; nothing writes to them.

    Attributes:
        origin: (n, 3) joint centre in the frame before it, m; the first from the base.
        axis: (n, 3) unit vectors.
        mass: (n,) kg, with everything fixed to the link, the tool on the last one.
        com: (n, 3) centre of mass in the link frame, m.
        inertia: (n, 6) Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass, kg m².
        gravity: (3,) acceleration in the base frame, m/s².
        tcp_position: (3,) tool centre point in the last link frame, m.
        tcp_rotation: (3, 3) its axes in the last link frame, hence in the base at q = 0.
    """

    origin: Array
    axis: Array
    mass: Array
    com: Array
    inertia: Array
    gravity: Array
    tcp_position: Array
    tcp_rotation: Array


class _Frame(NamedTuple):
    """Of a link, in the base at q = 0: origin in m, axes, and how many moving joints lie before it."""

    position: Array
    rotation: Array
    joints: int


class _Body(NamedTuple):
    """Of a link, in base axes at q = 0: mass, its centre in the base in m, inertia about that centre, moving joints."""

    mass: float
    center: Array
    inertia: Array
    joints: int


def rigid_chain(root: ET.Element, names: Sequence[str], tcp_link: str) -> RigidChain:
    """Return the chain of a URDF's moving joints; its tool centre point is the frame of the link `tcp_link`."""
    places = placements(root)
    frames = {places[0].parent: _Frame(np.zeros(3), np.eye(3), 0)}
    position = np.zeros((len(names), 3))
    axis = np.zeros((len(names), 3))
    for joint in places:
        before = frames[joint.parent]
        place = before.position + rotated(before.rotation, np.array(joint.xyz))
        turn = product(before.rotation, rpy_rotation(joint.rpy))
        index = before.joints
        if joint.name in names:
            direction = rotated(turn, np.array(joint.axis))
            position[index] = place
            axis[index] = direction / length(direction)
            index += 1
        frames[joint.child] = _Frame(place, turn, index)
    solids = [_body(frames[body.link], body) for body in bodies(root)]
    links = [
        _together([body for body in solids if body.joints == number])
        for number in range(1, len(names) + 1)
    ]
    tcp = frames[tcp_link]
    return RigidChain(
        origin=np.diff(position, axis=0, prepend=np.zeros((1, 3))),
        axis=axis,
        mass=np.array([body.mass for body in links]),
        com=np.array([body.center for body in links]) - position,
        inertia=np.array([body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]] for body in links]),
        gravity=np.array(_GRAVITY),
        tcp_position=tcp.position - position[-1],
        tcp_rotation=np.ascontiguousarray(tcp.rotation),
    )


def _body(frame: _Frame, body: LinkBody) -> _Body:
    turn = product(frame.rotation, rpy_rotation(body.rpy))
    return _Body(
        body.mass,
        frame.position + rotated(frame.rotation, np.array(body.xyz)),
        product(product(turn, symmetric(body.inertia)), transposed(turn)),
        frame.joints,
    )


def _together(bodies: list[_Body]) -> _Body:
    """Return bodies fixed to each other as one (parallel axes: Huygens and Steiner)."""
    mass = 0.0
    moment = np.zeros(3)
    for body in bodies:
        mass += body.mass
        moment = moment + body.mass * body.center
    center = moment / mass
    inertia = np.zeros((3, 3))
    if len(bodies) == 1:
        center = bodies[0].center
    for body in bodies:
        arm = body.center - center
        inertia = inertia + body.inertia + body.mass * (dot(arm, arm) * np.eye(3) - outer(arm, arm))
    return _Body(mass, center, inertia, bodies[0].joints)
