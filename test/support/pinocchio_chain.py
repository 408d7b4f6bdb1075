"""The rigid chain of a robot as Pinocchio has it: the oracle of the project's own."""

from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.description.chain import RigidChain
from rx90_common.description.robot import RobotModel


def pinocchio_chain(model: Any, tcp_frame: str) -> RigidChain:
    """Re-express a Pinocchio model of revolute joints in link frames parallel to the base at q = 0."""
    data = model.createData()
    joints = model.njoints - 1
    zero = np.zeros(joints)
    pin.framesForwardKinematics(model, data, zero)
    pin.computeJointJacobians(model, data, zero)
    # At q = 0 the angular part of column i, in base axes, is the axis of joint i.
    axis = np.array(data.J[3:, :].T)
    position = np.array([data.oMi[i + 1].translation for i in range(joints)])
    rotation = np.array([data.oMi[i + 1].rotation for i in range(joints)])
    bodies = [model.inertias[i + 1] for i in range(joints)]
    tensors = [r @ body.inertia @ r.T for r, body in zip(rotation, bodies, strict=True)]
    tcp = data.oMf[model.getFrameId(tcp_frame)]
    return RigidChain(
        origin=np.diff(position, axis=0, prepend=np.zeros((1, 3))),
        axis=np.ascontiguousarray(axis / np.linalg.norm(axis, axis=1, keepdims=True)),
        mass=np.array([body.mass for body in bodies]),
        com=np.array([r @ body.lever for r, body in zip(rotation, bodies, strict=True)]),
        inertia=np.array([[t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]] for t in tensors]),
        gravity=np.array(model.gravity.linear),
        tcp_position=np.array(tcp.translation - position[-1]),
        tcp_rotation=np.ascontiguousarray(tcp.rotation),
    )


@lru_cache
def _model(urdf: str) -> tuple[Any, Any]:
    model = pin.buildModelFromXML(urdf)
    return model, model.createData()


def tip_pose(robot: RobotModel, position: Any) -> Array:
    """Return the pose (4, 4) of the tool centre point for joint positions, rad, from the URDF's text."""
    model, data = _model(robot.urdf)
    pin.framesForwardKinematics(model, data, np.asarray(position, dtype=float))
    return np.array(data.oMf[model.getFrameId(robot.tcp_frame)].homogeneous)


def tip_place(robot: RobotModel, position: Any) -> Array:
    """Return where the tool centre point is for joint positions, rad: m, shape (3,)."""
    return tip_pose(robot, position)[:3, 3]
