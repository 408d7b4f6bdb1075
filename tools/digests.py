"""Compute the numbers that are the same to the last bit everywhere, and compare their digests with the committed ones.

    python -m tools.digests            # exit code 1 if one differs
    python -m tools.digests --write    # after a change that is meant to alter numbers

Each line of test/reference/digests.txt is the SHA-256 of the bytes of some arrays: the constants of plant and
controller, planned lines, set-points, and all series of the closed loop. They depend neither on the processor nor on
the versions of Python, NumPy, SciPy, numba and Pinocchio.
"""

from __future__ import annotations

import argparse
import hashlib
import platform
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import rx90_emulator as rx
from rx90_common.description.branch import Branch
from rx90_common.description.inverse import SphericalWristArm
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_controller.lines.plan import LinePlan, plan_line
from rx90_controller.trajectory.spline import interpolate
from rx90_emulator.loop.result import RunResult

FILE = Path(__file__).resolve().parent.parent / "test" / "reference" / "digests.txt"


def digests() -> dict[str, str]:
    """Return the digests by what they are of."""
    setup, task = rx.load_setup(), rx.load_task()
    plan = plan_line(setup.robot, task)
    turning = replace(
        task,
        end_rpy=(0.3, 2.9, -0.4),
        branch=Branch("front", "positive", "negative"),
        end=(0.6, -0.1, 0.3),
    )
    times = np.arange(0.0, plan.duration, 1e-3)
    start = plan.position[:2]
    exponents = {
        "friction.*.delta": 1.3,
        "friction.joint_2.delta": 0.7,
        "friction.joint_3.delta": 2.0,
    }
    other = rx.with_parameters(setup, exponents)
    short = replace(task, end=(0.6, -0.29, 0.2), rest_before=0.1, rest_after=0.1)
    viscous = {
        "friction.*.alpha": 0.7,
        "friction.joint_1.alpha": 1.0,
        "controller.viscous_exponent[*]": 0.6,
    }
    return {
        "rigid chain": _digest(setup.robot.chain),
        "plant constants": _digest(_constants(setup.plant().constants)),
        "controller constants": _digest(_constants(setup.cs7b().law)),
        "reference line": _plan_digest(plan),
        "line with a turning tool": _plan_digest(plan_line(setup.robot, turning)),
        "line of an arm without a closed form": _plan_digest(
            plan_line(_aside(), replace(task, end=(0.6, -0.28, 0.2)))
        ),
        "set-points of the reference line": _digest([plan.setpoints(times)]),
        "set-points of a cubic": _digest(
            [interpolate(times[:2] + 0.1, start, plan.velocity[:2], None).coefficients]
        ),
        "closed loop on the reference line": _run_digest(
            rx.run_line(setup, task, record_fast=True)
        ),
        "closed loop with other Stribeck exponents": _run_digest(rx.run_line(other, short)),
        "closed loop with viscous exponents": _run_digest(
            rx.run_line(rx.with_parameters(setup, viscous), short)
        ),
    }


def _aside() -> RobotModel:
    """Return the arm with axis 6 moved aside, so that its wrist is not spherical."""
    files = RobotFiles()
    text = files.urdf.read_text(encoding="utf-8")
    old = '<origin xyz="0 0 0.085"/>\n    <parent link="link_5"/>'
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "aside.urdf"
        file.write_text(
            text.replace(old, old.replace("0 0 0.085", "0.03 0.01 0.085")), encoding="utf-8"
        )
        robot = load_robot(file, files.tool)
    if SphericalWristArm.from_chain(robot.chain) is not None:
        raise ValueError(f"{files.urdf}: the origin of joint 6 is not where it is looked for")
    return robot


def _constants(record: np.ndarray[Any, Any]) -> Iterator[np.ndarray[Any, Any]]:
    """Yield the fields of a record one after the other; what is off, by default, leaves no bytes."""
    switches = {"parts": "used", "transmission": "flexible", "model": "parts"}
    switches |= {"cogging": "terms", "winding": "used", "sensor": "used"}
    for name in record.dtype.names or ():
        field = record[name]
        if name in switches and not field[switches[name]].any():
            continue
        if field.dtype.names is not None:
            yield from _constants(field)
        elif name not in ("alpha", "viscous_exponent") or np.any(field != 1.0):
            yield field


def _plan_digest(plan: LinePlan) -> str:
    return _digest([plan.times, plan.position, plan.velocity, plan.acceleration])


def _run_digest(run: RunResult) -> str:
    fast = [] if run.fast is None else list(run.fast)
    return _digest([*run.slow, *fast])


def _digest(arrays: Iterable[np.ndarray[Any, Any]]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def committed() -> dict[str, str]:
    """Return the digests in the repository."""
    lines = FILE.read_text(encoding="utf-8").splitlines()
    return {name: digest for digest, name in (line.split(maxsplit=1) for line in lines)}


def main() -> int:
    """Print the digests, and which of them differ."""
    parser = argparse.ArgumentParser(
        description="Compare the digests of the numbers that are the same everywhere."
    )
    parser.add_argument("--write", action="store_true", help="replace the committed digests")
    options = parser.parse_args()
    found = digests()
    if options.write:
        FILE.write_text(
            "".join(f"{digest}  {name}\n" for name, digest in found.items()), encoding="utf-8"
        )
    expected = committed()
    for name, digest in found.items():
        print(f"{digest[:16]}  {'same   ' if expected.get(name) == digest else 'DIFFERS'}  {name}")
    packages = ", ".join(
        f"{name} {version(name)}" for name in ("numpy", "scipy", "numba", "llvmlite", "pin")
    )
    print(f"Python {platform.python_version()}, {packages}")
    return int(found != expected)


if __name__ == "__main__":
    sys.exit(main())
