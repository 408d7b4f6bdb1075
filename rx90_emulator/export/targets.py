"""The simulators that friction is exported to, and their capabilities; `--help` reads this, so it imports nothing."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Target:
    """A simulator, or one of its formats for friction.

    Attributes:
        name: of the target, as on the command line.
        about: simulator and element of its language.
        files: its templates by the names of the resulting files, as `files_of` renders them.
        stribeck: whether its sliding torque falls with speed.
        delta: its Stribeck exponent; None if that is a parameter.
        breaks_away: whether its break-away torque may exceed its Coulomb torque.
        polynomial: whether its viscous torque is a v + b v |v| + c v^3 instead of a v.
        bristles: whether it has c0 and c1.
        coupled: whether an element may turn with two joints.
        loaded: whether its friction grows with the load torque, equally for driving and driven joints.
        sampled: whether it accepts any curve, as a table.
        everything: whether it has the element's law itself.
        arm: whether it has the arm, not the friction alone.
        rotors: how it has the motors' inertias: "exact", "by joint" if each joint has its own, "alone" or "" for not at
            all.
        motors: whether it has cogging and the temperature of windings.
        springs: whether it has the gravity-compensation springs.
        remark: further losses.
    """

    name: str
    about: str
    files: dict[str, str]
    stribeck: bool = False
    delta: float | None = 2.0
    breaks_away: bool = False
    polynomial: bool = False
    bristles: bool = False
    coupled: bool = False
    loaded: bool = False
    sampled: bool = False
    everything: bool = False
    arm: bool = True
    rotors: str = ""
    motors: bool = False
    springs: bool = False
    remark: str = ""


BAM_ACTUATOR = "erob80_100"
"""The motor in BAM's files, which must be one in BAM's list; friction does not depend on it."""

TARGETS = {
    one.name: one
    for one in (
        Target("mujoco", "MuJoCo 3.17 and later: <dcmotor lugre>, polynomial damping", {"{name}.xml": "mjcf.xml"},
               stribeck=True, breaks_away=True, polynomial=True, bristles=True, coupled=True,
               rotors="exact", motors=True, springs=True),
        Target("mujoco-classic", "older MuJoCo, MJX, mujoco_warp: frictionloss, damping", {"{name}.xml": "mjcf.xml"},
               coupled=True, rotors="exact", springs=True),
        Target("urdf", "URDF: <dynamics friction damping>", {"{name}.urdf": ""}),
        Target("sdf", "SDF, for Gazebo: <dynamics><friction>, <damping>", {"{name}.sdf": "sdf.xml"}),
        Target("usd", "OpenUSD: physxJointAxis (Isaac Sim), newton (Newton)", {"{name}.usda": "usd.usda"},
               breaks_away=True, rotors="by joint"),
        Target("isaaclab", "Isaac Lab: ImplicitActuatorCfg", {"actuators.py": "isaaclab.py.txt"},
               breaks_away=True, arm=False, rotors="by joint"),
        Target("drake", "Drake: a URDF, and a LeafSystem with the LuGre law itself",
               {"{name}.urdf": "", "friction.py": "drake.py.txt"},
               stribeck=True, breaks_away=True, polynomial=True, bristles=True, coupled=True, everything=True,
               rotors="by joint"),
        Target("bam", "BAM (Rhoban): parameters of its models m1, m2 and m5, a file for each element",
               {"{element}.json": "bam.json"},
               stribeck=True, delta=None, breaks_away=True, coupled=True, loaded=True, arm=False, rotors="exact",
               remark=f"motor: BAM wants one that it knows, {BAM_ACTUATOR} stands there; its kt and R are not this "
               "robot's"),
        Target("modelica", "Modelica: tau_pos of Rotational.Components.BearingFriction",
               {"{word}_friction.mo": "modelica.mo"},
               stribeck=True, breaks_away=True, coupled=True, sampled=True, arm=False),
    )
}  # fmt: skip
"""The targets by their names."""
