"""The simulators that friction is exported to, and their capabilities; `--help` reads this, so it imports nothing."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Target:
    """A simulator, or one of its formats for friction.

    Attributes:
        name: of the target, as on the command line.
        about: simulator and element of its language.
        file: name of the resulting file, as `files_of` fills it in.
        template: of that file; empty for the robot's own URDF.
        lugre: whether it has LuGre friction with a Stribeck exponent of 2 and a viscous torque a v + b v |v| + c v^3,
            and motors with cogging and the temperature of windings.
        breaks_away: whether its break-away torque may exceed its Coulomb torque.
        mjcf: whether elements may turn with two joints, motors have their inertias, and springs carry the arm.
        arm: whether it has the arm, not friction and rotor inertias of its joints alone.
    """

    name: str
    about: str
    file: str
    template: str = ""
    lugre: bool = False
    breaks_away: bool = False
    mjcf: bool = False
    arm: bool = True


_TARGETS = (
    Target(
        "mujoco",
        "MuJoCo 3.17 and later: <dcmotor lugre>, polynomial damping",
        "{name}.xml",
        "mjcf.xml",
        lugre=True,
        breaks_away=True,
        mjcf=True,
    ),
    Target(
        "mujoco-classic",
        "older MuJoCo, MJX, mujoco_warp: frictionloss, damping",
        "{name}.xml",
        "mjcf.xml",
        mjcf=True,
    ),
    Target("urdf", "URDF: <dynamics friction damping>", "{name}.urdf"),
    Target("sdf", "SDF, for Gazebo: <dynamics><friction>, <damping>", "{name}.sdf", "sdf.xml"),
    Target(
        "isaaclab",
        "Isaac Lab: ImplicitActuatorCfg",
        "actuators.py",
        "isaaclab.py.txt",
        breaks_away=True,
        arm=False,
    ),
)
TARGETS = {target.name: target for target in _TARGETS}
"""The targets by their names."""
