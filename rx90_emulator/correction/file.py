"""Correction files: a YAML head with arm, path and method, and the offsets in a NumPy file beside it."""

from __future__ import annotations

import io
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.bags.limits import DamagedError, load_arrays
from rx90_common.base.arrays import Array
from rx90_common.base.config import load_yaml, yaml_text
from rx90_common.base.entries import PER_JOINT, ListOf, Number, Numbers, Text
from rx90_common.base.errors import ConfigError, TrajectoryError, warn_caller
from rx90_common.base.groups import Group
from rx90_common.base.quoting import plain
from rx90_common.process.files import write_all
from rx90_controller.trajectory.correction import Correction, LearnedMotion
from rx90_emulator.correction.learning import MEASUREMENTS, LearnedCorrection
from rx90_emulator.correction.path import CorrectablePath
from rx90_emulator.loop.learned_motion import check_correction, learned_motion
from rx90_emulator.loop.setup import Setup

_MASS = 1e-6  # kg: files are rounded to this
_LEVER = 1e-6  # m

CORRECTION = Group(
    "A correction of one path on one arm, as rx90_correct learns it.",
    keys={
        "robot": Text("The robot's name in its URDF."),
        "payload": Group(
            "The last link with flange and tool.",
            keys={
                "mass": Number("Mass.", "kg", low=0.0),
                "center_of_mass": Numbers("In the frame of the last joint.", "m", count=3),
            },
        ),
        "path": Group(
            "The trajectory.",
            keys={
                "identity": Text("Digest of its points."),
                "speed": Number("Largest speed of the tip.", "m/s", low=0.0, above=True),
                "duration": Number("From first to last point.", "s", low=0.0, above=True),
                "start": Numbers("Where it begins.", "rad", count=PER_JOINT),
            },
        ),
        "period": Number("From one offset to the next.", "s", low=0.0, above=True),
        "method": Text("How it was learned, with the options."),
        "seen": ListOf(
            "By what each trial was measured, and where.",
            item=Text("", choices=MEASUREMENTS),
            accepted="a list of them",
        ),
        "worst": ListOf(
            "Largest distance from the path, trial by trial.",
            "m",
            item=Number("", low=0.0),
            accepted="a list of one number >= 0 or more",
            least=1,
        ),
        "offsets": Group(
            "`offsets` on the set-points, and those of the `best` trial, rad, (n, j).",
            keys={"file": Text("NumPy file beside this one.")},
        ),
    },
)
"""The contents of the head of a correction file."""


def _payload(setup: Setup) -> dict[str, Any]:
    """Return the last link with flange and tool, in the form of CORRECTION."""
    carried = setup.robot.model.inertias[setup.robot.model.njoints - 1]
    return {"mass": float(carried.mass), "center_of_mass": [float(x) for x in carried.lever]}


@dataclass(frozen=True, eq=False)
class CorrectionFile:
    """The contents of a correction file.

    Attributes:
        file: the head.
        head: its content, as declared by CORRECTION.
        correction: to be played.
        best: offsets of the best trial, rad, shape (n, j): those of `correction`, except after a trial that was
            recorded.
    """

    file: Path
    head: dict[str, Any]
    correction: Correction
    best: Array

    @property
    def measurements(self) -> tuple[str, ...]:
        """Return for each trial by what and where it was measured, of MEASUREMENTS."""
        return tuple(self.head["seen"])

    @property
    def worst(self) -> tuple[float, ...]:
        """Return the largest distance from the path by trial, m."""
        return tuple(self.head["worst"])

    def last_worst(self, how: str) -> tuple[float, ...]:
        """Return the worst distances of the last trials, m, as far back as all of them were measured in this way."""
        first = max((k + 1 for k, measurement in enumerate(self.measurements) if measurement != how), default=0)
        return self.worst[first:]

    def fitting(self, setup: Setup, path: CorrectablePath) -> Correction:
        """Return the correction for an arm and a path; warn if the payload is another one.

        Raises:
            ConfigError: for another robot, period or path, with the numbers.
        """
        period = setup.rates.position_period
        if not math.isclose(self.correction.period, period):
            raise ConfigError(
                f"{plain(self.file)} has offsets every {self.correction.period:g} s, the controller a set-point every "
                f"{period:g} s; accepted: the same"
            )
        check_correction(setup, path.points, self.correction, plain(self.file))
        learned = self.head["payload"]
        here = _payload(setup)
        mass = here["mass"]
        lever = float(np.linalg.norm(np.subtract(learned["center_of_mass"], here["center_of_mass"])))
        if abs(learned["mass"] - mass) > _MASS or lever > _LEVER:
            warn_caller([
                f"{plain(self.file)}: it was learned with {learned['mass']:.6g} kg on the last joint, there are "
                f"{mass:.6g} kg, their centre {lever * 1e3:.3g} mm elsewhere: let it learn one more trial"
            ])  # fmt: skip
        return self.correction


def write_correction(learned: LearnedCorrection, file: Path | str, earlier: CorrectionFile | None = None) -> None:
    """Write a correction file, `FILE.yaml` with `FILE.npz` beside it: both or none.

    Args:
        learned: the result of learning.
        file: the head.
        earlier: file with the earlier trials, if learning continued from it.

    Raises:
        ConfigError: for a name that does not end with .yaml.
        Rx90Error: if it cannot be written.
    """
    head, offsets_file = correction_files(file)
    worst = [trial.worst for trial in learned.trials]
    measurements = [learned.measurement] * len(learned.trials)
    if earlier is not None:
        worst = [*earlier.worst, *worst]
        measurements = [*earlier.measurements, *measurements]
    buffer = io.BytesIO()
    np.savez_compressed(buffer, offsets=learned.correction.offsets, best=learned.best_offsets)
    options = [f"{key} {'none' if value is None else f'{value:g}'}" for key, value in asdict(learned.method).items()]
    motion = asdict(learned_motion(learned.setup, learned.path.points))
    content = {
        "robot": motion.pop("robot"),
        "payload": _payload(learned.setup),
        "path": {**motion, "start": list(motion["start"])},
        "period": learned.correction.period,
        "method": f"{type(learned.method).__name__}: {', '.join(options)}",
        "seen": measurements,
        "worst": worst,
        "offsets": {"file": offsets_file.name},
    }
    write_all({head: yaml_text(content).encode(), offsets_file: buffer.getvalue()})


def correction_files(name: Path | str) -> tuple[Path, Path]:
    """Return head and offsets of a correction file."""
    head = Path(name)
    if head.suffix != ".yaml":
        raise ConfigError(f"{plain(head)}: cannot be a correction file; accepted: a name with .yaml")
    return head, head.with_suffix(".npz")


def load_correction(name: Path | str) -> CorrectionFile:
    """Read a correction file.

    Raises:
        ConfigError: naming file, key, value and what is accepted; for offsets that do not belong to this head.
    """
    file = Path(name)
    content = CORRECTION.read(load_yaml(file))
    offsets_file = file.parent / Path(content["offsets"]["file"]).name
    path = content["path"]
    start = tuple(float(angle) for angle in path["start"])
    motion = LearnedMotion(content["robot"], path["identity"], path["speed"], path["duration"], start)
    try:
        arrays = load_arrays(offsets_file)
        if "best" not in arrays:
            raise KeyError("best is not a file in the archive")
        correction = Correction(np.asarray(arrays["offsets"], dtype=np.float64), content["period"], motion)
        best = Correction(np.asarray(arrays["best"], dtype=np.float64), content["period"]).offsets
    except (DamagedError, KeyError, ValueError, TrajectoryError) as error:
        raise ConfigError(f"{plain(offsets_file)}: {error}; accepted: the file written with {plain(file)}") from error
    shape = correction.offsets.shape
    trials = len(content["worst"]), len(content["seen"])
    if best.shape != shape or shape[1] != len(content["path"]["start"]) or trials[0] != trials[1]:
        raise ConfigError(
            f"{plain(offsets_file)}: offsets of shape {shape}, those of the best trial {best.shape}, in {plain(file)} "
            f"{trials[0]} trials, {trials[1]} seen; accepted: the files written together"
        )
    return CorrectionFile(file, content, correction, best)
