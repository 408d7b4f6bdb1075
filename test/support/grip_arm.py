"""A URDF as makers publish them: an arm of seven joints with a gripper, on a base with more joints, made up here."""

from pathlib import Path

JOINTS = tuple(f"arm_{k}" for k in range(1, 8))
POSTURE = (0.2, -0.6, 0.1, -2.1, 0.15, 1.7, 0.6)  # rad, far from singularities
_PLACES = ("0 0 0.34", "0 0 0", "0 -0.32 0", "0.08 0 0", "-0.08 0.38 0", "0 0 0", "0.09 0 0")
_TURNS = (0.0, -1.5708, 1.5708, 1.5708, -1.5708, 1.5708, 1.5708)
_RANGES = ((-2.9, 2.9), (-1.8, 1.8), (-2.9, 2.9), (-3.1, -0.07), (-2.9, 2.9), (-0.02, 3.75), (-2.9, 2.9))
_MASSES = (3.0, 3.0, 2.5, 2.5, 2.0, 1.5, 0.8)
_MAST = '<limit lower="0" upper="1" velocity="1" effort="9"/>'
_GRIP = '<limit lower="0" upper="0.04" velocity="0.2" effort="20"/>'
_BOX = '<collision><geometry><cylinder radius="0.05" length="0.1"/></geometry></collision>'
_MESH = '<collision><geometry><mesh filename="package://none/link.stl"/></geometry></collision>'


def write_urdf(folder: Path, joints: int = 7, *, continuous: bool = False) -> Path:
    """Write the description: `mast` and `wheel` at the base, a body that cannot be, a finger that mimics one."""
    parts = [
        '<robot name="grip_arm"><link name="world"/><link name="column"><inertial><mass value="9"/>',
        '<inertia ixx="1" iyy="1" izz="9" ixy="0" ixz="0" iyz="0"/></inertial></link>',
        _joint("mast", "prismatic", "world", "column", "0 0 0.1", 0.0, _MAST),
        f'<link name="tyre">{_inertial(1.0)}</link>',
        _joint("wheel", "continuous", "world", "tyre", "0 -0.3 0", 0.0, '<limit velocity="9" effort="9"/>'),
    ]
    parent = "column"
    for k in range(joints):
        name, (low, high) = JOINTS[k], _RANGES[k]
        kind = "continuous" if continuous and k == joints - 1 else "revolute"
        span = "" if kind == "continuous" else f'lower="{low}" upper="{high}" '
        limit = f'<limit {span}velocity="{2.2 + 0.1 * k:g}" effort="{90 - 11 * k}"/>'
        parts.append(f'<link name="link_{k + 1}">{_inertial(_MASSES[k])}{_MESH if k == 2 else _BOX}</link>')
        parts.append(_joint(name, kind, parent, f"link_{k + 1}", _PLACES[k], _TURNS[k], limit))
        parent = f"link_{k + 1}"
    parts += [
        '<link name="hand"/><link name="tip"/>',
        _joint("hand_fixed", "fixed", parent, "hand", "0 0 0.11", 0.0, '<mimic joint="finger_1"/>'),
        f'<link name="left">{_inertial(0.05)}</link><link name="right">{_inertial(0.05)}</link>',
        _joint("finger_1", "prismatic", "hand", "left", "0 0 0.05", 0.0, _GRIP),
        _joint("finger_2", "prismatic", "hand", "right", "0 0 0.05", 0.0, _GRIP + '<mimic joint="finger_1"/>'),
        _joint("tip_fixed", "fixed", "hand", "tip", "0 0 0.1", 0.3, ""),
        "</robot>",
    ]
    file = folder / f"grip_arm_{joints}.urdf"
    file.write_text("\n".join(parts), encoding="utf-8")
    return file


def _inertial(mass: float) -> str:
    moments = f'ixx="{0.02 * mass:g}" iyy="{0.02 * mass:g}" izz="{0.005 * mass:g}" ixy="0" ixz="0" iyz="0"'
    return f'<inertial><origin xyz="0.01 0.03 -0.05"/><mass value="{mass}"/><inertia {moments}/></inertial>'


def _joint(name: str, kind: str, parent: str, child: str, place: str, roll: float, limit: str) -> str:
    axis = "" if kind == "fixed" else '<axis xyz="0 0 1"/>'
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{place}" rpy="{roll} 0 0"/><parent link="{parent}"/>'
        f'<child link="{child}"/>{axis}{limit}</joint>'
    )
