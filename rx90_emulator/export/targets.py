"""The simulators that friction is exported to, and what each of them can hold: one table."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Target:
    """A simulator, or a way to state friction in it.

    Attributes:
        name: of the target, as the command has it.
        about: simulator and element of its language.
        stribeck: whether its sliding torque falls with speed.
        delta: its Stribeck exponent; None where that is a parameter.
        breaks_away: whether its break-away torque may be more than its Coulomb torque.
        polynomial: whether its viscous torque is a v + b v |v| + c v^3 instead of a v.
        bristles: whether it has c0 and c1.
        coupled: whether an element may turn with two joints.
        loaded: whether its friction grows with the load torque, as much where the motor moves the link as elsewhere.
        sampled: whether it holds any curve, as a table.
        everything: whether it holds the element's law itself.
    """

    name: str
    about: str
    stribeck: bool = False
    delta: float | None = 2.0
    breaks_away: bool = False
    polynomial: bool = False
    bristles: bool = False
    coupled: bool = False
    loaded: bool = False
    sampled: bool = False
    everything: bool = False


TARGETS = {
    one.name: one
    for one in (
        Target("mujoco", "MuJoCo 3.17 and later: <dcmotor lugre>, polynomial damping",
               stribeck=True, breaks_away=True, polynomial=True, bristles=True, coupled=True),
        Target("mujoco-classic", "older MuJoCo, MJX, mujoco_warp: frictionloss, damping", coupled=True),
        Target("urdf", "URDF: <dynamics friction damping>"),
        Target("sdf", "SDF, for Gazebo: <dynamics><friction>, <damping>"),
        Target("usd", "OpenUSD: physxJointAxis (Isaac Sim), newton (Newton)", breaks_away=True),
        Target("isaaclab", "Isaac Lab: ImplicitActuatorCfg", breaks_away=True),
        Target("drake", "Drake: a URDF, and a LeafSystem with the LuGre law itself",
               stribeck=True, breaks_away=True, polynomial=True, bristles=True, coupled=True, everything=True),
        Target("bam", "BAM (Rhoban): parameters of its models m1, m2 and m5, a file for each element",
               stribeck=True, delta=None, breaks_away=True, coupled=True, loaded=True),
        Target("modelica", "Modelica: tau_pos of Rotational.Components.BearingFriction",
               stribeck=True, breaks_away=True, coupled=True, sampled=True),
    )
}  # fmt: skip
"""The targets by their names."""
