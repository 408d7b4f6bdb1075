"""Correction files: a YAML head with what it was learned for and how, and the offsets in a NumPy file beside it."""

from __future__ import annotations

import hashlib
import io
import math
import xml.etree.ElementTree as ET
import zipfile
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
from rx90_emulator.correction.learning import ENCODERS, TIP, LearnedCorrection
from rx90_emulator.correction.path import CorrectablePath, Nominal
from rx90_emulator.loop.setup import Setup

_MOST_BYTES = 256 * 2**20  # of the offsets: more than an hour
_SPEED_SHARE, _START, _DURATION = 1e-3, 1e-4, 1e-3  # of the speed; rad; s: the same but for rounding
_MASS, _LEVER = 1e-6, 1e-6  # kg, m

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
        "measured": Text("What it was learned from.", choices=(ENCODERS, TIP)),
        "method": Text("How, with its options."),
        "worst": ListOf(
            "Largest distance from the path, trial by trial.",
            "m",
            item=Number("", low=0.0),
            accepted="a list of numbers >= 0",
        ),
        "offsets": Group(
            "`offsets` on the set-points, rad, (n, j), and `distance` from the path by trial, m.",
            keys={"file": Text("NumPy file beside this one."), "sha256": Text("Digest of it.")},
        ),
    },
)
"""What the head of a correction file holds."""


@dataclass(frozen=True)
class Identity:
    """What a correction is for; see CORRECTION."""

    robot: str
    arm: str
    mass: float
    center_of_mass: tuple[float, ...]
    path: str
    speed: float
    duration: float
    start: tuple[float, ...]

    @classmethod
    def of(cls, setup: Setup, path: CorrectablePath) -> Identity:
        """Return that of an arm and a path."""
        model, drives, controller = setup.robot.model, setup.drives, setup.controller
        digest = hashlib.sha256()
        for k in range(1, model.njoints - 1):
            digest.update(np.round(model.inertias[k].toDynamicParameters(), 9).tobytes())
        for place in model.jointPlacements:
            digest.update(np.round(place.homogeneous, 9).tobytes())
        for values in (
            drives.gear,
            drives.rotor_inertia,
            *(getattr(controller, k) for k in ("inertia", "kp", "kv", "ki")),
        ):
            digest.update(np.asarray(values, dtype=np.float64).tobytes())
        nominal = Nominal.of(setup, path.points, path.counted)
        speed = float(np.linalg.norm(np.diff(nominal.tip, axis=0), axis=1).max()) / nominal.period
        carried = model.inertias[model.njoints - 1]
        return cls(
            ET.fromstring(setup.robot.urdf).get("name", ""),
            digest.hexdigest()[:16],
            float(carried.mass),
            tuple(float(x) for x in carried.lever),
            trajectory_identity(path.points),
            speed,
            float(path.points.times[-1]),
            tuple(path.points.position[0].tolist()),
        )

    def refusal(self, other: Identity) -> str:
        """Return why a correction of this one must not be played on another arm or path; empty where it may."""
        apart = np.abs(np.subtract(self.start, other.start))
        joint, mm = int(apart.argmax()), 1e3
        faults = (
            (
                self.robot != other.robot,
                f"it was learned on the robot {self.robot!r}, this one is {other.robot!r}; accepted: the same robot",
            ),
            (
                self.arm != other.arm,
                f"it was learned on an arm with other links, gears or gains (digest {self.arm}, here {other.arm}); "
                "accepted: the same arm and controller",
            ),
            (
                abs(self.speed - other.speed) > _SPEED_SHARE * self.speed,
                f"it was learned at {self.speed * mm:.4g} mm/s, the path is travelled at {other.speed * mm:.4g} mm/s; "
                "accepted: the same speed",
            ),
            (
                abs(self.duration - other.duration) > _DURATION,
                f"its path takes {self.duration:.6g} s, this one {other.duration:.6g} s; accepted: the same path",
            ),
            (
                apart[joint] > _START,
                f"its path begins with joint {joint + 1} at {self.start[joint]:.6g} rad, this one at "
                f"{other.start[joint]:.6g} rad; accepted: the same path",
            ),
            (
                self.path != other.path,
                f"its path is another one (digest {self.path}, here {other.path}); accepted: the same trajectory",
            ),
        )
        return next((why for wrong, why in faults if wrong), "")

    def warning(self, other: Identity) -> str:
        """Return how the other payload differs; empty where it does not."""
        lever = float(np.linalg.norm(np.subtract(self.center_of_mass, other.center_of_mass)))
        if abs(self.mass - other.mass) <= _MASS and lever <= _LEVER:
            return ""
        return (
            f"it was learned with {self.mass:.6g} kg on the last joint, there are {other.mass:.6g} kg, their centre "
            f"{lever * 1e3:.3g} mm elsewhere: let it learn one more trial"
        )


@dataclass(frozen=True, eq=False)
class CorrectionFile:
    """What a correction file holds.

    Attributes:
        file: the head.
        identity: what it is for.
        correction: what is played.
        measured: what it was learned from, ENCODERS or TIP.
        method: how, in words.
        worst: largest distance from the path by trial, m.
        distance: from the path on the set-points that count by trial, m, shape (trials, k).
    """

    file: Path
    identity: Identity
    correction: Correction
    measured: str
    method: str
    worst: tuple[float, ...]
    distance: Array

    def fitting(self, setup: Setup, path: CorrectablePath) -> Correction:
        """Return the correction for an arm and a path; another payload is warned of.

        Raises:
            ConfigError: for another robot, arm, speed or path, with the numbers.
        """
        here = Identity.of(setup, path)
        refusal, warning = self.identity.refusal(here), self.identity.warning(here)
        if refusal:
            raise ConfigError(f"{plain(self.file)}: {refusal}")
        warn_caller([f"{plain(self.file)}: {warning}"] if warning else [])
        return self.correction


def write_correction(learned: LearnedCorrection, file: Path | str, earlier: CorrectionFile | None = None) -> None:
    """Write a correction file, `FILE.yaml` with `FILE.npz` beside it: both or none.

    Args:
        learned: what was learned.
        file: the head.
        earlier: whose trials stand before these, where it was gone on from.

    Raises:
        ConfigError: for a name that does not end with .yaml.
        Rx90Error: if it cannot be written.
    """
    head = Path(file)
    if head.suffix != ".yaml":
        raise ConfigError(f"{plain(head)}: cannot be a correction file; accepted: a name with .yaml")
    identity, beside = Identity.of(learned.setup, learned.path), head.with_suffix(".npz")
    distance = np.array([trial.distance for trial in learned.trials])
    worst = [trial.worst for trial in learned.trials]
    if earlier is not None:
        distance, worst = np.concatenate([earlier.distance, distance]), [*earlier.worst, *worst]
    buffer = io.BytesIO()
    np.savez_compressed(buffer, offsets=learned.correction.offsets, distance=distance)
    content = {
        "robot": identity.robot,
        "arm": identity.arm,
        "payload": {"mass": identity.mass, "center_of_mass": list(identity.center_of_mass)},
        "path": {
            "identity": identity.path,
            "speed": identity.speed,
            "duration": identity.duration,
            "start": list(identity.start),
        },
        "period": learned.correction.period,
        "measured": TIP if learned.tip else ENCODERS,
        "method": _described(learned.method),
        "worst": worst,
        "offsets": {"file": beside.name, "sha256": hashlib.sha256(buffer.getvalue()).hexdigest()},
    }
    write_all({head: yaml_text(content).encode(), beside: buffer.getvalue()})


def _described(method: Any) -> str:
    options = ", ".join(
        f"{key} {'none' if value is None else format(value, 'g')}" for key, value in asdict(method).items()
    )
    return f"{type(method).__name__}: {options}"


def load_correction(name: Path | str) -> CorrectionFile:
    """Read a correction file.

    Raises:
        ConfigError: naming file, key, value and what is accepted; for offsets that are not those it was written with.
    """
    file = Path(name)
    root = load_yaml(file)
    content = CORRECTION.read(root)
    path, payload = content["path"], content["payload"]
    beside = file.parent / Path(content["offsets"]["file"]).name
    try:
        if beside.stat().st_size > _MOST_BYTES:
            raise ConfigError(f"{plain(beside)}: {beside.stat().st_size} bytes; accepted: up to {_MOST_BYTES}")
        data = beside.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"{plain(beside)}: {error.strerror}; accepted: the file written with {plain(file)}"
        ) from error
    if hashlib.sha256(data).hexdigest() != content["offsets"]["sha256"]:
        raise ConfigError(f"{plain(beside)}: other offsets than {plain(file)} has; accepted: the file written with it")
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            offsets, distance = (np.asarray(arrays[key], dtype=np.float64) for key in ("offsets", "distance"))
        correction = Correction(offsets, content["period"])
    except (KeyError, ValueError, zipfile.BadZipFile, TrajectoryError) as error:
        raise ConfigError(f"{plain(beside)}: {error}; accepted: a file that rx90_correct wrote") from error
    if distance.ndim != 2 or len(distance) != len(content["worst"]) or not np.isfinite(distance).all():
        raise ConfigError(f"{plain(beside)}: distances of shape {distance.shape}; accepted: a row for each trial")
    identity = Identity(
        content["robot"], content["arm"], payload["mass"], payload["center_of_mass"], path["identity"], path["speed"],
        path["duration"], path["start"],
    )  # fmt: skip
    measured, method, worst = content["measured"], content["method"], content["worst"]
    return CorrectionFile(file, identity, correction, measured, method, worst, distance)


def described(found: CorrectionFile) -> str:
    """Return what a correction file holds, in lines."""
    identity, offsets = found.identity, found.correction.offsets
    rate = float(np.abs(np.diff(offsets, axis=0)).max(initial=0.0)) / found.correction.period
    rows = [
        f"robot {identity.robot}, {identity.mass:.4g} kg on the last joint",
        f"path of {identity.duration:.3f} s, up to {identity.speed * 1e3:.4g} mm/s",
        f"learned from the {found.measured}; {found.method}",
        *(f"trial {k}: worst {worst * 1e3:.4f} mm" for k, worst in enumerate(found.worst)),
        f"largest offset {float(np.abs(offsets).max()):.3g} rad, fastest change {rate:.3g} rad/s",
    ]
    if found.worst and min(found.worst) > 0.0:
        rows.append(f"best of the first: {found.worst[0] / min(found.worst):.3g} times better")
    return "\n".join(rows)


def spectrum(rows: Array, period: float) -> tuple[Array, Array]:
    """Return frequencies, Hz, and amplitudes of a series, of its unit; the mean is left out."""
    window = np.hanning(len(rows))
    amplitude = np.abs(np.fft.rfft((rows - rows.mean()) * window)) * 2.0 / max(window.sum(), math.ulp(1.0))
    return np.asarray(np.fft.rfftfreq(len(rows), period)[1:], dtype=np.float64), amplitude[1:]
