"""A good file of every kind: the shipped ones, and one for each kind of which none is shipped."""

from pathlib import Path

import numpy as np

from rx90_common.base.share import config_path
from rx90_common.description.robot_files import FILES, shipped_robots

OWN = {
    "trajectory": """\
header: {stamp: {sec: 0, nanosec: 0}, frame_id: base_link}
joint_names: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]
points:
- {positions: [0, 0, 0, 0, 0, 0], time_from_start: {sec: 0, nanosec: 0}}
- {positions: [0.1, 0, 0, 0, 0, 0], velocities: [], effort: [], time_from_start: {sec: 1}}
""",
    "log_mapping": """\
time: {column: 1, unit: ms}
names: [shoulder, elbow]
position: {columns: [2, 3], unit: turns, factor: [0.25, 0.125]}
velocity: {columns: [dq1, dq2], unit: rad/s}
effort: {columns: [i1, i2], unit: A, factor: -1.5}
delimiter: ;
decimal: ','
header: 2
""",
    "correction": """\
robot: rx90b
payload: {mass: 3.7, center_of_mass: [0, 0, 0.1]}
path: {identity: 0123456789abcdef, speed: 0.1, duration: 0.001, start: [0, 0, 0, 0, 0, 0]}
period: 0.001
method: "NormOptimal: effort 0.1"
seen: ["encoders, engine", "tip, record"]
worst: [1.0e-4, 1.0e-5]
offsets: {file: correction.npz}
""",
    "experiments": """\
sliding: [one]
presliding: [two]
excitation: []
validation: [three]
""",
}


def shipped() -> list[tuple[str, Path]]:
    robots = [config_path(f"robots/{name}") for name in shipped_robots()]
    found = [(role, folder / file) for folder in robots for role, file in FILES.items() if role != "urdf"]
    found += [("friction", path) for path in sorted(config_path("friction").rglob("*.yaml"))]
    found += [("rig", path) for path in sorted(config_path("rig").glob("*.yaml"))]
    found += [("path", path) for path in sorted(config_path("paths").glob("*.yaml"))]
    found += [("sweep_plan", path) for path in sorted(config_path("sweep").glob("*.yaml"))]
    return [(kind, path) for kind, path in found if path.is_file()]


def written(folder: Path) -> list[tuple[str, Path]]:
    for bag in ("one", "two", "three"):
        (folder / bag).mkdir()
    found = []
    np.savez(folder / "correction.npz", offsets=np.zeros((2, 6)), best=np.zeros((2, 6)))
    for name, text in OWN.items():
        path = folder / f"{name}.yaml"
        path.write_text(text, encoding="utf-8")
        found.append((name, path))
    return found
