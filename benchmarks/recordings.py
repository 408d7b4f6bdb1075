"""Public recordings of real arms as the tables, signal maps and descriptions that `identification_guards` reads.

    python -m benchmarks.recordings CLONES --output RECORDINGS

CLONES holds clones of thanhndv212/figaroh-examples, marcocognetti/FrankaEmikaPandaDynModel,
Gepetto/example-robot-data (the Panda's kinematics) and shamilmamedov/dynamic_calibration; an arm whose clone is missing
is left out. Each arm is a folder of RECORDINGS: fit.csv to identify from, unseen.csv to predict, signals.yaml, and
arm.urdf where the arm is not one of this project's. Nothing of the recordings belongs to this repository.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml

from benchmarks.report import arguments
from rx90_common.base.arrays import Array

_FIGAROH = "figaroh-examples/examples"
_PANDA_LOG = (
    "FrankaEmikaPandaDynModel/matlab/data/Exciting_Traj/Trajectory_1/rbt_log/exciting_traj_"
)
_UR10E = "dynamic_calibration/dataset_ur10e"
_UR_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)


def _columns(kind: str, count: int) -> list[str]:
    return [f"{kind}{number}" for number in range(1, count + 1)]


def _write(file: Path, table: Array, kinds: str) -> None:
    """Write time and one block of columns for each letter of `kinds`."""
    joints = (table.shape[1] - 1) // len(kinds)
    header = ",".join(["t", *(name for kind in kinds for name in _columns(kind, joints))])
    np.savetxt(file, table, delimiter=",", header=header, comments="", fmt="%.9g")


def _write_thirds(folder: Path, table: Array, kinds: str) -> None:
    """Write the first two thirds to identify from, and the last one to predict."""
    cut = len(table) * 2 // 3
    _write(folder / "fit.csv", table[:cut], kinds)
    _write(folder / "unseen.csv", table[cut:], kinds)


def _signals(
    names: tuple[str, ...], effort: dict[str, object], first: int = 1, **more: object
) -> dict[str, object]:
    """Return the map of a table with columns t, q, v and f, whose names begin to count at `first`."""
    numbers = range(first, first + len(names))
    return {
        "time": {"column": "t", "unit": "s"},
        "names": [*names],
        "position": {"columns": [f"q{number}" for number in numbers], "unit": "rad"},
        "velocity": {"columns": [f"v{number}" for number in numbers], "unit": "rad/s"},
        "effort": {"columns": [f"f{number}" for number in numbers], **effort},
        **more,
    }


def _write_map(folder: Path, signals: dict[str, object]) -> None:
    text = yaml.safe_dump(signals, sort_keys=False, default_flow_style=None, width=200)
    (folder / "signals.yaml").write_text(text, encoding="utf-8")


def tx40(clones: Path, folder: Path) -> None:
    """Write 9 s at 5 kHz, motor side; the robot is this project's tx40."""
    data = clones / _FIGAROH / "staubli_TX40" / "data"
    position, torque = (
        np.loadtxt(data / name, delimiter=",", skiprows=1)
        for name in ("pos_read_data.csv", "curr_data.csv")
    )
    rows = min(len(position), len(torque))
    time = np.arange(rows) / 5000.0
    _write_thirds(folder, np.column_stack([time, position[:rows], torque[:rows]]), "qf")
    motors: dict[str, object] = {
        "names": _columns("motor_", 6),
        "position": {"columns": _columns("q", 6), "unit": "rad"},
        "effort": {"columns": _columns("f", 6), "unit": "Nm"},
    }
    _write_map(folder, {"time": {"column": "t", "unit": "s"}, "topic": "motor_states", **motors})


def panda(clones: Path, folder: Path) -> None:
    """Write 24 s at 1 kHz, joint side, torques of sensors behind the gears."""
    fields = [
        np.loadtxt(clones / f"{_PANDA_LOG}{name}.txt")
        for name in ("time", "positions", "velocity", "torques")
    ]
    table = np.column_stack([fields[0], *(values.reshape(-1, 7) for values in fields[1:])])
    _write_thirds(folder, table, "qvf")
    _write_map(folder, _signals(tuple(_columns("panda_joint", 7)), {"unit": "Nm"}))
    shutil.copyfile(
        clones / "example-robot-data/robots/panda_description/urdf/panda.urdf", folder / "arm.urdf"
    )


def _tiago(clones: Path, folder: Path, joints: int) -> None:
    log = str(clones / _FIGAROH / "tiago/data/identification/dynamic/tiago_")
    position, velocity, effort = (
        np.loadtxt(f"{log}{name}.csv", delimiter=",", skiprows=1)
        for name in ("position", "velocity", "effort")
    )
    # The first column of each is the torso's.
    table = np.column_stack([position[:, 0], position[:, 2:], velocity[:, 2:], effort[:, 2:]])
    _write_thirds(folder, table, "qvf")
    constants = [13.6, 13.6, -8.7, -8.7, -20.6, -20.6, -20.6][:joints]
    names = tuple(f"arm_{number}_joint" for number in range(1, joints + 1))
    _write_map(folder, _signals(names, {"unit": "A"}, torque_constant=constants))
    shutil.copyfile(clones / _FIGAROH / "tiago/urdf/tiago_hey5.urdf", folder / "arm.urdf")


def tiago_4(clones: Path, folder: Path) -> None:
    """Write 80 s at 100 Hz of the first four joints, motor currents with the source's constants times the gears."""
    _tiago(clones, folder, 4)


def tiago_7(clones: Path, folder: Path) -> None:
    """Write the same of all seven joints."""
    _tiago(clones, folder, 7)


def ur10e(clones: Path, folder: Path) -> None:
    """Write a Fourier run of 28 s and a point-to-point run, about 94 Hz, currents with the source's drive gains."""
    runs = {
        "fit": "identification_data/ur-20_02_10-30sec_12harm.csv",
        "unseen": "validation_data/ur-20_01_17-ptp_10_points.csv",
    }
    for name, file in runs.items():
        table = np.loadtxt(clones / _UR10E / file, delimiter=",")[:, :19]
        _write(folder / f"{name}.csv", table, "qvf")
    gains = [10.0, 10.6956, 8.4566, 9.0029, 9.48, 10.1232]
    _write_map(folder, _signals(_UR_JOINTS, {"unit": "A"}, torque_constant=gains))
    shutil.copyfile(clones / "dynamic_calibration/URe/urdf/ur10e.urdf", folder / "arm.urdf")


ARMS: dict[str, Callable[[Path, Path], None]] = {
    "tx40": tx40,
    "panda": panda,
    "tiago_4": tiago_4,
    "tiago_7": tiago_7,
    "ur10e": ur10e,
}


def main() -> int:
    """Write the arms whose recordings are there; return 1 if one is left out."""
    options = arguments(
        __doc__,
        ("clones", Path(), "folder of clones"),
        ("--output", Path("recordings"), "to write"),
    )
    missing = 0
    for name, write in ARMS.items():
        folder = options.output / name
        folder.mkdir(parents=True, exist_ok=True)
        try:
            write(options.clones, folder)
        except FileNotFoundError as error:
            missing += 1
            print(f"{name} left out: {error.filename or error} is not there", file=sys.stderr)
        else:
            print(f"{folder}")
    return int(missing > 0)


if __name__ == "__main__":
    sys.exit(main())
