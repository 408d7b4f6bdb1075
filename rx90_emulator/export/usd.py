"""The arm as OpenUSD: UsdPhysics bodies and joints, friction in the attributes of PhysX (Isaac Sim) and Newton."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics

from rx90_emulator.export.fit import FrictionFit
from rx90_emulator.export.targets import Target
from rx90_emulator.loop.setup import Arm


def write_usd(arm: Arm, target: Target, fits: Sequence[FrictionFit]) -> tuple[dict[str, str], list[str]]:  # noqa: ARG001
    """Return the stage as text. Angles of USD are degrees, and so are those in its damping."""
    robot, name = arm.robot, Tf.MakeValidIdentifier(str(arm.robot.model.name))
    model = robot.model
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(model.nq))
    rotors = arm.drives.rotor_inertia @ arm.drives.turning.turns**2
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, f"/{name}").GetPrim()
    stage.SetDefaultPrim(root)
    UsdPhysics.ArticulationRootAPI.Apply(root)
    base = UsdGeom.Xform.Define(stage, f"/{name}/base").GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(base)
    fixed = UsdPhysics.FixedJoint.Define(stage, f"/{name}/world_fixed")
    fixed.CreateBody1Rel().SetTargets([base.GetPath()])
    UsdGeom.Scope.Define(stage, f"/{name}/joints")
    before = base.GetPath()
    for k, (fit, joint_name) in enumerate(zip(fits, robot.joint_names, strict=True)):
        joint_id = model.getJointId(joint_name)
        link = UsdGeom.Xform.Define(stage, f"/{name}/link_{k + 1}")
        _place(link, data.oMi[joint_id])
        _add_body(link.GetPrim(), model.inertias[joint_id])
        # In a scope of their own, where no link has the name; numbered where USD takes two names for one.
        path = f"/{name}/joints/{Tf.MakeValidIdentifier(joint_name)}"
        joint = UsdPhysics.RevoluteJoint.Define(stage, f"{path}_{k + 1}" if stage.GetPrimAtPath(path) else path)
        joint.GetPrim().SetDisplayName(joint_name)
        joint.CreateBody0Rel().SetTargets([before])
        joint.CreateBody1Rel().SetTargets([link.GetPath()])
        axis = data.oMi[joint_id].rotation.T @ robot.chain.axis[k]
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis)
        at = model.jointPlacements[joint_id]
        joint.CreateAxisAttr("Z")
        joint.CreateLocalPos0Attr(Gf.Vec3f(*at.translation.tolist()))
        joint.CreateLocalRot0Attr(_quaternion(pin.Quaternion(at.rotation) * turn))
        joint.CreateLocalPos1Attr(Gf.Vec3f(0.0))
        joint.CreateLocalRot1Attr(_quaternion(turn))
        joint.CreateLowerLimitAttr(math.degrees(robot.lower[k]))
        joint.CreateUpperLimitAttr(math.degrees(robot.upper[k]))
        _add_friction(joint.GetPrim(), fit, float(rotors[k]))
        before = link.GetPath()
    return {f"{robot.model.name}.usda": stage.GetRootLayer().ExportToString()}, []


def _add_friction(prim: Usd.Prim, fit: FrictionFit, armature: float) -> None:
    """Set what PhysX and Newton read; their schemas are not in usd-core, so the attributes stand by their names."""
    law, viscous = fit.law, math.radians(fit.law.viscous[0])
    prim.AddAppliedSchema("PhysxJointAxisAPI:angular")
    prim.AddAppliedSchema("NewtonJointAPI")
    values = {
        "physxJointAxis:angular:staticFrictionEffort": law.tau_s,
        "physxJointAxis:angular:dynamicFrictionEffort": law.tau_c,
        "physxJointAxis:angular:viscousFrictionCoefficient": viscous,
        "physxJointAxis:angular:armature": armature,
        "newton:friction": law.tau_c,
        "newton:damping": viscous,
        "newton:armature": armature,
    }
    for name, value in values.items():
        prim.CreateAttribute(name, Sdf.ValueTypeNames.Float).Set(value)


def _place(link: UsdGeom.Xform, placement: pin.SE3) -> None:
    link.AddTranslateOp().Set(Gf.Vec3d(*placement.translation.tolist()))
    link.AddOrientOp().Set(_quaternion(pin.Quaternion(placement.rotation)))


def _add_body(prim: Usd.Prim, inertia: pin.Inertia) -> None:
    """Add mass, centre of mass and principal moments."""
    UsdPhysics.RigidBodyAPI.Apply(prim)
    moments, axes = np.linalg.eigh(inertia.inertia)
    axes[:, 2] *= np.linalg.det(axes)
    mass = UsdPhysics.MassAPI.Apply(prim)
    mass.CreateMassAttr(inertia.mass)
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*inertia.lever.tolist()))
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*moments.tolist()))
    mass.CreatePrincipalAxesAttr(_quaternion(pin.Quaternion(axes)))


def _quaternion(turn: pin.Quaternion) -> Gf.Quatf:
    x, y, z, w = turn.coeffs().tolist()
    return Gf.Quatf(w, x, y, z)
