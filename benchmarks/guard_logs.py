"""Logs, commands and written files of `identification_guards`: what a user has in hands, and nothing behind it."""

from __future__ import annotations

import importlib.metadata
import math
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import yaml

from benchmarks.excitation_runs import ExcitationRun
from benchmarks.independent_fit import Log, PlainArm
from benchmarks.random_arms import SyntheticArm
from rx90_common.base.arrays import Array
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.process.children import executable

LIMIT = 500.0
"""s that a command may take."""


@dataclass(frozen=True)
class Said:
    """What a command did: exit code, both of its outputs, elapsed and processor time, s."""

    code: int
    text: str
    elapsed: float
    processor: float

    @property
    def broken(self) -> str:
        """Return what no log of a user may ever bring to the terminal, or nothing; a refusal may quote 'nan'."""
        found = re.search(
            r"Traceback|LinAlgError|IndexError|(?<!')\bnan\b", self.text, re.IGNORECASE
        )
        if found:
            return found.group()
        return "" if self.code in {0, 1, 2} else f"exit code {self.code}"


def run(command: Sequence[str | Path]) -> Said:
    """Run a command in a process of its own."""
    began, before = time.perf_counter(), _children_seconds()
    words = executable(str(command[0]), *map(str, command[1:]))
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT, check=False)
        code, text = done.returncode, done.stdout + done.stderr
    except subprocess.TimeoutExpired:
        code, text = 124, f"took more than {LIMIT:g} s"
    return Said(code, text, time.perf_counter() - began, _children_seconds() - before)


def _children_seconds() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


_WARM: set[str] = set()


def run_warm(command: Sequence[str | Path]) -> Said:
    """Run a command in a fork of this process, which has imported already what the command needs.

    The first run of a command in a process is thrown away; the others are the same, two seconds faster.
    """
    name, *words = map(str, command)
    if name not in _WARM:
        _WARM.add(name)
        _forked(name, words, fork=False)
        for word in words:
            if word.startswith(tempfile.gettempdir()) and Path(word).is_dir():
                shutil.rmtree(word)
    began, before = time.perf_counter(), _children_seconds()
    code, text = _forked(name, words, fork=True)
    return Said(code, text, time.perf_counter() - began, _children_seconds() - before)


def _forked(name: str, words: Sequence[str], *, fork: bool) -> tuple[int, str]:
    """Call a command, in a fork or here, and return its exit code and what it wrote."""
    with tempfile.TemporaryFile("w+", encoding="utf-8") as output:
        child = os.fork() if fork else 0
        if child:
            _, status = os.waitpid(child, 0)
            code = os.waitstatus_to_exitcode(status)
        else:
            signal.alarm(int(LIMIT) if fork else 0)
            sys.stdout.flush()
            sys.stderr.flush()
            terminal = os.dup(1), os.dup(2)
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
            code = _call(name, words)
            sys.stdout.flush()
            sys.stderr.flush()
            if fork:
                os._exit(code)
            os.dup2(terminal[0], 1)
            os.dup2(terminal[1], 2)
        output.seek(0)
        return code, output.read()


def _call(name: str, words: Sequence[str]) -> int:
    program, *verb = name.split()
    (entry,) = importlib.metadata.entry_points(group="console_scripts", name=program)
    sys.argv = [program, *verb, *words]
    try:
        return int(entry.load()() or 0)
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
        return 1


@dataclass(frozen=True, eq=False)
class JointLog:
    """A log of n joints as a user has it: stamps, s, (m,); rad, rad/s, Nm, (m, n) each."""

    names: tuple[str, ...]
    time: Array
    position: Array
    velocity: Array
    torque: Array

    @classmethod
    def of(cls, run: ExcitationRun, arm: SyntheticArm) -> JointLog:
        """Return what was recorded of a run."""
        return cls(arm.names, run.time + 1.0, run.position, run.velocity, run.torque)

    def part(self, rows: Any) -> JointLog:
        """Return some rows."""
        values = {
            name: getattr(self, name)[rows] for name in ("time", "position", "velocity", "torque")
        }
        return replace(self, **values)

    @property
    def plain(self) -> Log:
        """Return it for the independent fit."""
        return Log(self.time, self.position, self.torque)

    def write(self, file: Path) -> Path:
        """Write a CSV table; `signal_map` describes it."""
        count = len(self.names)
        header = ",".join(["t", *(f"{kind}{k}" for kind in "qvf" for k in range(1, count + 1))])
        table = np.column_stack([self.time, self.position, self.velocity, self.torque])
        np.savetxt(file, table, delimiter=",", header=header, comments="", fmt="%.9g")
        return file


def signal_map(names: Sequence[str], *, velocity: bool = True) -> str:
    """Return the map of such a table, with or without its velocities."""
    numbers = range(1, len(names) + 1)
    units = {"position": ("q", "rad"), "velocity": ("v", "rad/s"), "effort": ("f", "Nm")}
    if not velocity:
        del units["velocity"]
    columns = {
        key: {"columns": [f"{kind}{k}" for k in numbers], "unit": unit}
        for key, (kind, unit) in units.items()
    }
    return yaml.safe_dump({"time": {"column": "t", "unit": "s"}, "names": [*names], **columns})


@dataclass(frozen=True)
class Value:
    """A parameter as the friction file states it."""

    value: float
    deviation: float

    def score(self, true: float) -> float:
        """Return the error in deviations."""
        return float(abs(self.value - true) / self.deviation) if self.deviation > 0.0 else math.inf


@dataclass(frozen=True)
class Written:
    """The files of a result: a friction file, and beside it, from excitation runs, robot and parameters."""

    friction: Path

    @cached_property
    def content(self) -> dict[str, Any]:
        """Return the friction file."""
        return dict(yaml.safe_load(self.friction.read_text(encoding="utf-8")))

    @property
    def elements(self) -> list[str]:
        """Return the names of the elements, the joints' before those of motors that turn with several."""
        return [
            name
            for name, values in self.content["elements"].items()
            if isinstance(values, Mapping) and "tau_c" in values
        ]

    def identified(self, element: str) -> dict[str, Value]:
        """Return what the bags identify of an element."""
        stated = self.content["identification"]["parameters"][element]
        return {
            name: Value(float(one["value"]), float(one["deviation"]))
            for name, one in stated.items()
            if one.get("provenance") == "identified" and one.get("deviation") is not None
        }

    @cached_property
    def parameters(self) -> dict[str, Any]:
        """Return parameters.yaml."""
        return dict(
            yaml.safe_load((self.friction.parent / "parameters.yaml").read_text(encoding="utf-8"))
        )

    def unseen(self) -> tuple[float, float]:
        """Return the torque errors of all joints that the command found, by base parameters and by files."""
        one = next(iter(self.parameters["validation"].values()))
        return float(one["relative"]), float(one["by_files"]["relative"])

    def heaviest(self, joints: Sequence[str]) -> float:
        """Return the mass of the heaviest link that hangs directly on one of the joints, kg."""
        robot = ElementTree.parse(self.friction.parent / "robot.urdf").getroot()
        links = {link.get("name"): link for link in robot.iter("link")}
        masses = [0.0]
        for joint in robot.iter("joint"):
            child = joint.find("child")
            if joint.get("name") in joints and child is not None:
                mass = links[child.get("link")].find("inertial/mass")
                masses.append(0.0 if mass is None else float(mass.get("value", "0")))
        return max(masses)

    def _model(self, joints: Sequence[str]) -> Any:
        whole = pin.buildModelFromUrdf(str(self.friction.parent / "robot.urdf"))
        held = [number for number, name in enumerate(whole.names) if number and name not in joints]
        return pin.buildReducedModel(whole, held, pin.neutral(whole))

    def error(
        self, arm: PlainArm, log: Log, joints: Sequence[str], rotors: Array | None = None
    ) -> float:
        """Return the torque error of a log by the files alone, bristles left out, over all joints.

        Args:
            arm: band and couplings.
            log: of the joints.
            joints: their names in the URDF.
            rotors: where the robot's own drives file holds them, kg m^2, shape (n,); else those of the friction file.
        """
        model = self._model(joints)
        laws = FrictionFile.read(self.friction).select(self.elements)
        beside = self.content.get("joints") or {}
        stated = {
            key: np.array([float((beside.get(name) or {}).get(key, 0.0)) for name in joints])
            for key in ("offset", "rotor_inertia", "spring")
        }
        turning = stated["rotor_inertia"] if rotors is None else rotors
        inertia = arm.coupling.T @ np.diag(turning) @ arm.coupling

        def torque(motion: Array) -> Array:
            data = model.createData()
            bare = np.array(
                [pin.rnea(model, data, *row).copy() for row in motion.transpose(1, 0, 2)]
            )
            inputs = motion[1] @ arm.element_matrix.T
            friction = np.column_stack(
                [law.steady_torque(inputs[:, k]) for k, law in enumerate(laws)]
            )
            spring = stated["spring"] * np.sin(motion[0])
            return np.asarray(
                bare
                + motion[2] @ inertia
                + spring
                + stated["offset"]
                + friction @ arm.element_matrix
            )

        return arm.rows(log, torque).error(np.ones(1))


_TERM = re.compile(r"([+-]?)\s*([\d.]+(?:e[+-]?\d+)?\s+)?([A-Za-z]+)_(\d+)")
_PINOCCHIO = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


def true_base(group: str, arm: SyntheticArm) -> float:
    """Return the true value of a combination such as "Izz_1 + 0.05 m_2 + Ia_1" of an arm's parameters."""
    total = 0.0
    for sign, factor, name, number in _TERM.findall(group):
        k = int(number) - 1
        single = {"Ia": arm.rotor, "offset": arm.offset, "k": arm.spring}
        value = (
            single[name][k] if name in single else arm.links[k].parameters[_PINOCCHIO.index(name)]
        )
        total += (-1.0 if sign == "-" else 1.0) * float(factor or 1.0) * float(value)
    return total
