"""Friction alone: Isaac Lab's actuators in Python, BAM's JSON, and Modelica's tables."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from rx90_emulator.export.fit import FrictionFit, SimulatorLaw
from rx90_emulator.export.targets import Target
from rx90_emulator.loop.setup import Arm

Files = tuple[dict[str, str], list[str]]

BAM_ACTUATOR = "erob80_100"
"""The motor in BAM's files, which must be one that BAM knows; friction does not depend on it."""

_ISAACLAB = '''"""Friction of {name} for Isaac Lab, written by rx90_export. SI units, joint side.

Isaac Sim 5.0 or later: friction is the break-away torque, dynamic_friction the torque while sliding, both in Nm.
"""

from isaaclab.actuators import ImplicitActuatorCfg

{constant} = ImplicitActuatorCfg(
    joint_names_expr={joints},
    effort_limit_sim={effort},
    velocity_limit_sim={velocity},
    stiffness=0.0,
    damping=0.0,
    armature={armature},
    friction={friction},
    dynamic_friction={dynamic},
    viscous_friction={viscous},
)
"""Torque control; set stiffness and damping for position control."""
'''


def write_isaaclab(arm: Arm, target: Target, fits: Sequence[FrictionFit]) -> Files:  # noqa: ARG001 - as of every target
    """Return a module with the configuration of one actuator model for all joints."""
    robot, drives = arm.robot, arm.drives
    rotors = drives.rotor_inertia @ arm.drives.turning.turns**2
    efforts = abs(arm.drives.turning.turns).T @ abs(drives.gear * drives.peak_torque)

    patterns = [json.dumps(re.escape(name)) for name in robot.joint_names]

    def by_joint(values: ArrayLike) -> str:
        numbers = zip(patterns, np.array(values).tolist(), strict=True)
        return "{\n" + "".join(f"        {name}: {value!r},\n" for name, value in numbers) + "    }"

    name = str(robot.model.name)
    text = _ISAACLAB.format(
        name=name, constant=_word(name).upper() + "_ACTUATORS",
        joints=f"[{', '.join(patterns)}]", effort=by_joint(efforts), velocity=by_joint(robot.max_velocity),
        armature=by_joint(rotors), friction=by_joint([fit.law.tau_s for fit in fits]),
        dynamic=by_joint([fit.law.tau_c for fit in fits]), viscous=by_joint([fit.law.viscous[0] for fit in fits]),
    )  # fmt: skip
    return {"actuators.py": text}, []


def write_bam(arm: Arm, target: Target, fits: Sequence[FrictionFit]) -> Files:  # noqa: ARG001
    """Return a file for each element, as BAM's `load_model` reads it."""
    rotors = dict.fromkeys(arm.friction.names, 0.0)
    rows = {
        tuple(row): name
        for row, name in zip(arm.drives.turning.element_matrix.tolist(), arm.friction.names, strict=True)
    }
    for row, rotor in zip(arm.drives.turning.turns.tolist(), arm.drives.rotor_inertia, strict=True):
        rotors[rows[tuple(row)]] = float(rotor)
    files = {fit.name: bam_parameters(fit.law, rotors[fit.name]) for fit in fits}
    remark = f"motor: BAM wants one that it knows, {BAM_ACTUATOR} stands there; its kt and R are not this robot's"
    return {f"{name}.json": json.dumps(content, indent=1) + "\n" for name, content in files.items()}, [remark]


def bam_parameters(law: SimulatorLaw, armature: float) -> dict[str, float | str]:
    """Return BAM's parameters of a law: model m1, m2 with a Stribeck part, m5 with one of the load.

    BAM's load is |K_m tau_m - K_e tau_e| of motor and external torque. With K_m = 0 that is the load here, in both
    directions of the power flow.
    """
    rise, (sliding, rest) = law.tau_s - law.tau_c, law.load
    loaded = sliding > 0.0 or rest > 0.0
    content: dict[str, float | str] = {"model": "m5" if loaded else "m2" if rise else "m1", "actuator": BAM_ACTUATOR}
    content |= {"armature": armature, "friction_base": law.tau_c, "friction_viscous": law.viscous[0]}
    if rise or loaded:
        content |= {"friction_stribeck": rise, "dtheta_stribeck": law.omega_s, "alpha": law.delta}
    if loaded:
        shares = {"motor": 0.0, "external": sliding, "motor_stribeck": 0.0, "external_stribeck": rest}
        content |= {f"load_friction_{name}": value for name, value in shares.items()}
    return content


def write_modelica(arm: Arm, target: Target, fits: Sequence[FrictionFit]) -> Files:  # noqa: ARG001
    """Return a package with tau_pos and peak of each element; the first row is the break-away torque, so peak is 1."""
    name = _word(str(arm.robot.model.name)) + "_friction"
    lines = [f'package {name} "Friction for Rotational.Components.BearingFriction, joint side, rad/s and Nm"']
    for fit in fits:
        assert fit.law.table is not None
        curve, peak = (_identifier(f"{fit.name}_{what}") for what in ("tau_pos", "peak"))
        rows = ";\n    ".join(f"{speed!r}, {torque!r}" for speed, torque in fit.law.table.tolist())
        lines.append(f"  constant Real {curve}[:, 2] = [\n    {rows}];")
        lines.append(f"  constant Real {peak} = 1.0;")
    return {f"{name}.mo": "\n".join([*lines, f"end {name};", ""])}, []


def _identifier(name: str) -> str:
    """Return a name for Modelica, which takes any character between quotes, with a backslash for quotes and itself."""
    return name if _word(name) == name else "'" + re.sub(r"([\\'])", r"\\\1", name) + "'"


def _word(name: str) -> str:
    """Return a name as an identifier of letters without accents, digits and underscores."""
    word = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"_{word}" if word[:1].isdigit() else word
