"""Correction files: a YAML head with arm, path and method, and the offsets in a NumPy file beside it."""

from __future__ import annotations

import hashlib
import io
import math
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import load_yaml, yaml_text
from rx90_common.base.entries import PER_JOINT, ListOf, Number, Numbers, Text
from rx90_common.base.errors import ConfigError, TrajectoryError, warn_caller
from rx90_common.base.groups import Group
from rx90_common.base.quoting import plain
from rx90_common.process.files import write_all
from rx90_controller.trajectory.correction import Correction
from rx90_controller.trajectory.points import trajectory_identity
from rx90_emulator.correction.learning import MEASUREMENTS, LearnedCorrection
from rx90_emulator.correction.path import CorrectablePath, TrajectoryPath
from rx90_emulator.loop.setup import Setup

_MAX_BYTES = 256 * 2**20  # of the offsets: more than an hour
_SPEED_SHARE = 1e-3  # of the speed: set-points sample its peak, files round it
_DURATION = 1e-3  # s: a set-point period, to which a trajectory is rounded
_START = 1e-4  # rad: tolerance of the start
_MASS, _LEVER = 1e-6, 1e-6  # kg, m: files are rounded to this

CORRECTION = Group(
    "A correction of one path on one arm, as rx90_correct learns it.",
    keys={
        "robot": Text("The robot's name in its URDF."),
        "arm": Text("Digest of links, gears and gains, without what the last link carries."),
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
            "`offsets` on the set-points, and those of the `best` trial, rad, (n, j); `distance` from the path by "
            "trial, m.",
            keys={"file": Text("NumPy file beside this one."), "sha256": Text("Digest of it.")},
        ),
    },
)
"""The contents of the head of a correction file."""


def identity_of(setup: Setup, path: TrajectoryPath) -> dict[str, Any]:
    """Return robot, arm, payload and path that a correction is valid for, in the form of CORRECTION."""
    model, drives, controller = setup.robot.model, setup.drives, setup.controller
    digest = hashlib.sha256()
    for k in range(1, model.njoints - 1):
        digest.update(np.round(model.inertias[k].toDynamicParameters(), 9).tobytes())
    for place in model.jointPlacements:
        digest.update(np.round(place.homogeneous, 9).tobytes())
    gains = (getattr(controller, name) for name in ("inertia", "kp", "kv", "ki"))
    for values in (drives.gear, drives.rotor_inertia, *gains):
        digest.update(np.asarray(values, dtype=np.float64).tobytes())
    carried = model.inertias[model.njoints - 1]
    return {
        "robot": ET.fromstring(setup.robot.urdf).get("name", ""),
        "arm": digest.hexdigest()[:16],
        "payload": {"mass": float(carried.mass), "center_of_mass": [float(x) for x in carried.lever]},
        "path": {
            "identity": trajectory_identity(path.points),
            "speed": float(np.linalg.norm(np.diff(path.tip, axis=0), axis=1).max()) / path.period,
            "duration": float(path.points.times[-1]),
            "start": path.points.position[0].tolist(),
        },
    }


def _refusals(learned: dict[str, Any], here: dict[str, Any]) -> Iterator[str]:
    """Yield the reasons why a correction must not be played on this arm and path."""
    its, this = learned["path"], here["path"]
    if learned["robot"] != here["robot"]:
        yield f"was learned on the robot {learned['robot']!r}, this one is {here['robot']!r}; accepted: the same robot"
    if learned["arm"] != here["arm"]:
        yield (
            f"was learned on an arm with other links, gears or gains (digest {learned['arm']}, here {here['arm']}); "
            "accepted: the same arm and controller"
        )
    if abs(its["speed"] - this["speed"]) > _SPEED_SHARE * its["speed"]:
        speeds = [f"{1e3 * one['speed']:.4g} mm/s" for one in (its, this)]
        yield f"was learned at {speeds[0]}, the path is travelled at {speeds[1]}; accepted: the same speed"
    if abs(its["duration"] - this["duration"]) > _DURATION:
        yield f"is of a path of {its['duration']:.6g} s, this one has {this['duration']:.6g} s; accepted: the same path"
    for number, (then, now) in enumerate(zip(its["start"], this["start"], strict=False), 1):
        if abs(then - now) > _START:
            yield (
                f"is of a path that begins with joint {number} at {then:.6g} rad, this one at {now:.6g} rad; accepted: "
                "the same path"
            )
    if its["identity"] != this["identity"]:
        yield f"is of another path (digest {its['identity']}, here {this['identity']}); accepted: the same trajectory"


@dataclass(frozen=True, eq=False)
class CorrectionFile:
    """The contents of a correction file.

    Attributes:
        file: the head.
        head: its content, as declared by CORRECTION.
        correction: to be played.
        best: offsets of the best trial, rad, shape (n, j): those of `correction`, except after a trial that was
            recorded.
        distance: from the path at the counted set-points by trial, m, shape (trials, k).
    """

    file: Path
    head: dict[str, Any]
    correction: Correction
    best: Array
    distance: Array

    @property
    def identity(self) -> dict[str, Any]:
        """Return robot, arm, payload and path that it is valid for."""
        return {key: self.head[key] for key in ("robot", "arm", "payload", "path")}

    @property
    def method(self) -> str:
        """Return how it was learned, in words."""
        return str(self.head["method"])

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
        other = max((k + 1 for k, measurements in enumerate(self.measurements) if measurements != how), default=0)
        return self.worst[other:]

    def fitting(self, setup: Setup, path: CorrectablePath, *, go_on: bool = False) -> Correction:
        """Return the correction for an arm and a path; warn if the payload is another one.

        Args:
            setup: the arm.
            path: on which it is played.
            go_on: whether learning continues from it, so that the path error must count at the same set-points, too.

        Raises:
            ConfigError: for another robot, arm, speed or path, with the numbers.
        """
        trajectory, period = TrajectoryPath.of(setup, path.points, path.counted), setup.rates.position_period
        here, counted = identity_of(setup, trajectory), int(trajectory.counts.sum())
        if not math.isclose(self.correction.period, period):
            raise ConfigError(
                f"{plain(self.file)} has offsets every {self.correction.period:g} s, the controller a set-point every "
                f"{period:g} s; accepted: the same"
            )
        for refusal in _refusals(self.identity, here):
            raise ConfigError(f"{plain(self.file)} {refusal}")
        if go_on and self.distance.shape[1] != counted:
            raise ConfigError(
                f"{plain(self.file)}: the path error counted on {self.distance.shape[1]} set-points, here on "
                f"{counted}; accepted: the task or trajectory that it was learned for"
            )
        its, this = self.head["payload"], here["payload"]
        lever = float(np.linalg.norm(np.subtract(its["center_of_mass"], this["center_of_mass"])))
        if abs(its["mass"] - this["mass"]) > _MASS or lever > _LEVER:
            warn_caller([
                f"{plain(self.file)}: it was learned with {its['mass']:.6g} kg on the last joint, there are "
                f"{this['mass']:.6g} kg, their centre {lever * 1e3:.3g} mm elsewhere: let it learn one more trial"
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
    (head, offsets_file), of = correction_files(file), learned.path
    distance = np.array([trial.distance for trial in learned.trials])
    worst, measurements = [trial.worst for trial in learned.trials], [learned.measurement] * len(learned.trials)
    if earlier is not None:
        distance = np.concatenate([earlier.distance, distance])
        worst, measurements = [*earlier.worst, *worst], [*earlier.measurements, *measurements]
    buffer = io.BytesIO()
    np.savez_compressed(buffer, offsets=learned.correction.offsets, best=learned.best_offsets, distance=distance)
    options = asdict(learned.method)  # type: ignore[call-overload]
    options = (f"{key} {'none' if value is None else format(value, 'g')}" for key, value in options.items())
    content = {
        **identity_of(learned.setup, TrajectoryPath.of(learned.setup, of.points, of.counted)),
        "period": learned.correction.period,
        "method": f"{type(learned.method).__name__}: {', '.join(options)}",
        "seen": measurements,
        "worst": worst,
        "offsets": {"file": offsets_file.name, "sha256": hashlib.sha256(buffer.getvalue()).hexdigest()},
    }
    write_all({head: yaml_text(content).encode(), offsets_file: buffer.getvalue()})


def correction_files(name: Path | str) -> tuple[Path, Path]:
    """Return head and offsets of a correction file.

    Raises:
        ConfigError: for a name that does not end with .yaml.
    """
    head = Path(name)
    if head.suffix != ".yaml":
        raise ConfigError(f"{plain(head)}: cannot be a correction file; accepted: a name with .yaml")
    return head, head.with_suffix(".npz")


def load_correction(name: Path | str) -> CorrectionFile:
    """Read a correction file.

    Raises:
        ConfigError: naming file, key, value and what is accepted; for offsets that were not written with this head.
    """
    file = Path(name)
    content = CORRECTION.read(load_yaml(file))
    offsets_file = file.parent / Path(content["offsets"]["file"]).name
    try:
        if offsets_file.stat().st_size > _MAX_BYTES:
            raise ConfigError(
                f"{plain(offsets_file)}: {offsets_file.stat().st_size} bytes; accepted: up to {_MAX_BYTES}"
            )
        data = offsets_file.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"{plain(offsets_file)}: {error.strerror}; accepted: the file written with {plain(file)}"
        ) from error
    if hashlib.sha256(data).hexdigest() != content["offsets"]["sha256"]:
        raise ConfigError(
            f"{plain(offsets_file)}: other offsets than {plain(file)} has; accepted: the file written with it"
        )
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            offsets, best, distance = (
                np.asarray(arrays[key], dtype=np.float64) for key in ("offsets", "best", "distance")
            )
        correction = Correction(offsets, content["period"])
        if Correction(best, content["period"]).offsets.shape != offsets.shape:
            raise ValueError(f"best offsets of shape {best.shape}, offsets of shape {offsets.shape}")
        trials = {len(distance), len(content["worst"]), len(content["seen"])}
        if offsets.shape[1] != len(content["path"]["start"]):
            raise ValueError(f"offsets of {offsets.shape[1]} joints, a path of {len(content['path']['start'])}")
        if distance.ndim != 2 or not distance.size or len(trials) > 1 or not np.isfinite(distance).all():
            raise ValueError(f"distances of shape {distance.shape} that are no row for each trial")
    except (KeyError, ValueError, zipfile.BadZipFile, TrajectoryError) as error:
        raise ConfigError(f"{plain(offsets_file)}: {error}; accepted: a file that rx90_correct wrote") from error
    return CorrectionFile(file, content, correction, best, distance)
