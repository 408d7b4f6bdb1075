"""Correction files: a YAML head with arm, path and method, and the offsets in a NumPy file beside it."""

from __future__ import annotations

import io
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from rx90_common.bags.damage import load_arrays
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError, ConfigError, TrajectoryError, warn_caller
from rx90_common.base.models import (
    FileModel,
    NotNegative,
    PerJoint,
    Triple,
    model_text,
    quantity,
    read_model,
)
from rx90_common.base.quoting import counted, plain
from rx90_common.process.files import write_all
from rx90_controller.trajectory.correction import Correction, LearnedMotion
from rx90_emulator.correction.learning import LearnedCorrection, Measurement
from rx90_emulator.correction.path import CorrectablePath
from rx90_emulator.loop.learned_motion import check_correction, learned_motion
from rx90_emulator.loop.setup import Setup

_MASS = 1e-6  # kg: files are rounded to this
_LEVER = 1e-6  # m


class Payload(FileModel):
    """The last link with flange and tool."""

    mass: Annotated[float, quantity("kg", "Mass.", ge=0.0)]
    center_of_mass: Annotated[Triple, quantity("m", "In the frame of the last joint.")]

    @classmethod
    def of(cls, setup: Setup) -> Payload:
        """Return that of an arm."""
        carried = setup.robot.model.inertias[setup.robot.model.njoints - 1]
        return cls(mass=float(carried.mass), center_of_mass=tuple(float(x) for x in carried.lever))


class CorrectedPath(FileModel):
    """The trajectory."""

    identity: Annotated[str, Field(description="Digest of its points.")]
    speed: Annotated[float, quantity("m/s", "Largest speed of the tip.", gt=0.0)]
    duration: Annotated[float, quantity("s", "From first to last point.", gt=0.0)]
    start: Annotated[PerJoint, quantity("rad", "Where it begins.")]


class Offsets(FileModel):
    """`offsets` on the set-points, and those of the `best` trial, rad, (n, j)."""

    file: Annotated[str, Field(description="NumPy file beside this one.")]


class CorrectionHead(FileModel):
    """A correction of one path on one arm, as rx90 correct learns it."""

    robot: Annotated[str, Field(description="The robot's name in its URDF.")]
    payload: Payload
    path: CorrectedPath
    period: Annotated[float, quantity("s", "From one offset to the next.", gt=0.0)]
    method: Annotated[str, Field(description="How it was learned, with the options.")]
    seen: Annotated[
        tuple[Measurement, ...],
        Field(strict=False, description="By what each trial was measured, and where."),
    ]
    worst: Annotated[
        tuple[NotNegative, ...],
        Field(strict=False, min_length=1),
        quantity("m", "Largest distance from the path, trial by trial."),
    ]
    offsets: Offsets


@dataclass(frozen=True, eq=False)
class CorrectionFile:
    """The contents of a correction file.

    Attributes:
        file: the head.
        head: its content.
        correction: to be played.
        best: offsets of the best trial, rad, shape (n, j): those of `correction`, except after a trial that was
            recorded.
    """

    file: Path
    head: CorrectionHead
    correction: Correction
    best: Array

    def last_worst(self, how: str) -> tuple[float, ...]:
        """Return the worst distances of the last trials, m, as far back as all of them were measured in this way."""
        first = max(
            (k + 1 for k, measurement in enumerate(self.head.seen) if measurement != how),
            default=0,
        )
        return self.head.worst[first:]

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
        learned = self.head.payload
        here = Payload.of(setup)
        lever = float(np.linalg.norm(np.subtract(learned.center_of_mass, here.center_of_mass)))
        if abs(learned.mass - here.mass) > _MASS or lever > _LEVER:
            warn_caller([
                f"{plain(self.file)}: it was learned with {learned.mass:.6g} kg on the last joint, there are "
                f"{here.mass:.6g} kg, their centre {lever * 1e3:.3g} mm elsewhere: let it learn one more trial"
            ])  # fmt: skip
        return self.correction


def write_correction(
    learned: LearnedCorrection, file: Path | str, earlier: CorrectionFile | None = None
) -> None:
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
        worst = [*earlier.head.worst, *worst]
        measurements = [*earlier.head.seen, *measurements]
    buffer = io.BytesIO()
    np.savez_compressed(buffer, offsets=learned.correction.offsets, best=learned.best_offsets)
    options = [
        f"{key} {'none' if value is None else f'{value:g}'}"
        for key, value in asdict(learned.method).items()
    ]
    motion = asdict(learned_motion(learned.setup, learned.path.points))
    content = CorrectionHead.model_validate(
        {
            "robot": motion.pop("robot"),
            "payload": Payload.of(learned.setup),
            "path": motion,
            "period": learned.correction.period,
            "method": f"{type(learned.method).__name__}: {', '.join(options)}",
            "seen": measurements,
            "worst": worst,
            "offsets": {"file": offsets_file.name},
        }
    )
    write_all({head: model_text(content).encode(), offsets_file: buffer.getvalue()})


def correction_files(name: Path | str) -> tuple[Path, Path]:
    """Return head and offsets of a correction file."""
    head = Path(name)
    if head.suffix != ".yaml":
        raise ConfigError(
            f"{plain(head)}: cannot be a correction file; accepted: a name with .yaml"
        )
    return head, head.with_suffix(".npz")


def load_correction(name: Path | str) -> CorrectionFile:
    """Read a correction file.

    Raises:
        ConfigError: naming file, key, value and what is accepted; for offsets that do not belong to this head.
    """
    file = Path(name)
    head = read_model(CorrectionHead, file)
    offsets_file = file.parent / Path(head.offsets.file).name
    path = head.path
    motion = LearnedMotion(head.robot, path.identity, path.speed, path.duration, path.start)
    try:
        arrays = load_arrays(offsets_file)
        if "best" not in arrays:
            raise KeyError("best is not a file in the archive")
        correction = Correction(
            np.asarray(arrays["offsets"], dtype=np.float64), head.period, motion
        )
        best = Correction(np.asarray(arrays["best"], dtype=np.float64), head.period).offsets
    except (BagError, KeyError, ValueError, TrajectoryError) as error:
        raise ConfigError(
            f"{plain(offsets_file)}: {error}; accepted: the file written with {plain(file)}"
        ) from error
    shape = correction.offsets.shape
    trials = len(head.worst), len(head.seen)
    if best.shape != shape or shape[1] != len(path.start) or trials[0] != trials[1]:
        raise ConfigError(
            f"{plain(offsets_file)}: offsets of shape {shape}, those of the best trial {best.shape}, in {plain(file)} "
            f"{counted(trials[0], 'trial')}, {trials[1]} seen; accepted: the files written together"
        )
    return CorrectionFile(file, head, correction, best)
