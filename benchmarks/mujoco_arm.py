"""The same arm in MuJoCo: URDF, rotors with the wrist coupling, spring, motors and seven LuGre elements.

What MuJoCo cannot express stays different: its LuGre friction has one torque for both signs of the velocity, a
Stribeck exponent of 2 and a damping c1 that does not fade.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from rx90_common.description.drives import DriveParameters
from rx90_common.friction import FrictionElement
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]
_WRIST = "wrist"
_NO_MOTOR = (1e-9, 1e-9)  # motor constants of an actuator that is there for its friction alone
_SPRING_ARM, _SPRING_ANCHOR = 0.1, 0.3  # m; any two lengths give the same torque


def mujoco_arm(setup: Setup) -> Any:
    """Return the MuJoCo model; its controls are the motor torques, Nm, shape (6,)."""
    robot, drives = setup.robot, setup.drives
    spec = mujoco.MjSpec.from_string(robot.urdf)
    spec.option.timestep = setup.rates.period
    for geometry in list(spec.geoms):  # for display only; inertias are the URDF's
        spec.delete(geometry)
    joints = [spec.joint(name) for name in robot.joint_names]
    for joint in joints:
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    for joint, rotor in zip(joints[:5], drives.rotor_inertia, strict=False):
        joint.armature = rotor
    # Motor 6 and friction element 7 turn with the sum of joints 5 and 6.
    wrist = spec.add_tendon(name=_WRIST, armature=drives.rotor_inertia[5])
    for joint in joints[4:]:
        wrist.wrap_joint(joint.name, 1.0)
    for joint, torque in zip(joints, drives.spring_torque, strict=True):
        if torque > 0.0:
            _add_spring(spec, joint, torque)
    _add_motors(spec, joints, drives)
    transmissions = [(joint.name, mujoco.mjtTrn.mjTRN_JOINT) for joint in joints]
    transmissions.append((_WRIST, mujoco.mjtTrn.mjTRN_TENDON))
    for (target, kind), element in zip(transmissions, setup.friction.elements, strict=True):
        _add_friction(spec.add_actuator(name=f"friction_{target}", target=target, trntype=kind), element)
    return spec.compile()


def _add_spring(spec: Any, joint: Any, torque: float) -> None:
    """Add -torque sin(q): a spring of no free length between a point of the link and one above the joint."""
    link = joint.parent
    side = np.cross(joint.axis, np.eye(3)[np.argmin(np.abs(joint.axis))])
    side /= np.linalg.norm(side)
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, side, link.quat)
    centre = np.empty(3)
    mujoco.mju_rotVecQuat(centre, joint.pos, link.quat)
    link.add_site(name="spring_arm", pos=joint.pos + _SPRING_ARM * side)
    link.parent.add_site(name="spring_anchor", pos=link.pos + centre + _SPRING_ANCHOR * turned)
    stiffness = torque / (_SPRING_ARM * _SPRING_ANCHOR)
    spring = spec.add_tendon(name="spring", springlength=[0.0, 0.0])
    spring.stiffness[0] = stiffness
    spring.wrap_site("spring_arm")
    spring.wrap_site("spring_anchor")


def _add_motors(spec: Any, joints: Any, drives: DriveParameters) -> None:
    for i, (joint, gear, peak) in enumerate(zip(joints, drives.gear, drives.peak_torque, strict=True)):
        motor = spec.add_actuator(name=f"motor_{i + 1}", ctrllimited=True, ctrlrange=[-peak, peak])
        motor.set_to_motor()
        motor.trntype = mujoco.mjtTrn.mjTRN_TENDON if i == 5 else mujoco.mjtTrn.mjTRN_JOINT
        motor.target = _WRIST if i == 5 else joint.name
        motor.gear[0] = gear


def _add_friction(actuator: Any, element: FrictionElement) -> None:
    lugre = [element.c0, element.c1, element.tau_c_positive, element.tau_s_positive, element.omega_s]
    actuator.set_to_dcmotor(
        motorconst=_NO_MOTOR, resistance=1.0, lugre=lugre, ctrlspec=mujoco.mjtCtrlInput.mjINPUT_NONE
    )
    actuator.damping[0] = element.c2


def mass_and_bias(model: Any, data: Any, q: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
    """Return M, shape (6, 6), and h with gravity and spring, shape (6,), as MuJoCo computes them."""
    data.qpos[:], data.qvel[:], data.act[:], data.ctrl[:] = q, v, 0.0, 0.0
    mujoco.mj_forward(model, data)
    mass = np.empty((6, 6))
    mujoco.mj_fullM(model, data, mass)
    return mass, data.qfrc_bias - data.qfrc_spring
