"""Export of a robot's friction, and its arm, to another simulator: the files, their errors, and a verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, check_type, write_error
from rx90_common.base.quoting import aligned, listed, plain, quoted
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.parts.part import LINEAR_SPEED
from rx90_common.process.files import atomic_files
from rx90_emulator.export.files import files_of
from rx90_emulator.export.fit import POINTS, FrictionFit, fit_friction, speeds_up_to
from rx90_emulator.export.targets import TARGETS, Target
from rx90_emulator.loop.setup import Arm

REPORT = "export.txt"
"""The file beside those of the simulator that states the errors of the export."""

_BESIDE = 1e-9  # rad/s beside rest: far below the Stribeck velocities
_ROUNDING = 1e-9  # Nm: a smaller difference is rounding
_OTHER_SHAPE = (TypeError, ValueError, KeyError, IndexError, AttributeError)


@dataclass(frozen=True, eq=False)
class Export:
    """An exported robot.

    Attributes:
        target: the simulator.
        fits: the friction of each element, or of each joint.
        files: their texts by their names.
        lost: properties of the arm and its drives that the target does not represent, a sentence each.
        speeds: speeds in use, in words.
    """

    target: Target
    fits: tuple[FrictionFit, ...]
    files: Mapping[str, str]
    lost: tuple[str, ...]
    speeds: str

    @property
    def largest(self) -> float:
        """Return what a friction torque differs by at most, Nm, also while other joints move."""
        return max(fit.worst for fit in self.fits)

    @property
    def text(self) -> str:
        """Return the differences as a table, and the losses."""
        head = [
            "friction",
            "largest, Nm",
            "RMS, Nm",
            "over, rad/s",
            "break-away, Nm",
            "presliding, Nm/rad",
        ]
        rows = [tuple(head)]
        for fit in self.fits:
            break_away = [_both(one) for one in fit.break_away]
            stiffness = ["rigid" if math.isinf(one) else f"{one:.3g}" for one in fit.stiffness]
            over = f"{fit.speeds.min():.2g} to {fit.speeds.max():.2g}"
            numbers = [
                f"{value:.2g}" if value > _ROUNDING else "0" for value in (fit.largest, fit.rms)
            ]
            rows.append((fit.name, *numbers, over, " -> ".join(break_away), " -> ".join(stiffness)))
        lines = [f"{self.target.name}: {self.target.about}", f"speeds: {self.speeds}", ""]
        lines += aligned(rows, right=range(1, 4))
        whose: dict[str, list[str]] = {}
        for fit in self.fits:
            for line in fit.lost:
                whose.setdefault(line, []).append(fit.name)
        lines += ["", "lost:", *(f"  {line}" for line in self.lost)]
        lines += [
            f"  {', '.join(names) if len(names) < len(self.fits) else 'all'}: {x}"
            for x, names in whose.items()
        ]
        return "\n".join(lines)


def _both(values: Sequence[float]) -> str:
    return "/".join(dict.fromkeys(f"{value:.4g}" for value in values))


def export_robot(
    arm: Arm,
    target: str,
    *,
    speeds: tuple[float, float] | None = None,
) -> Export:
    """Return a robot, or its friction alone, in the format of another simulator.

    Args:
        arm: the robot and its friction.
        target: one of TARGETS.
        speeds: the range in use, rad/s; by default that over which each element was identified, or else that of each
            joint, from 1 mrad/s.

    Raises:
        ConfigError: for an unknown target, or an invalid range.
    """
    check_type(arm=(arm, Arm))
    if target not in TARGETS:
        raise ConfigError(f"target {quoted(target)}; accepted: {listed(TARGETS)}")
    simulator = TARGETS[target]
    turns = arm.drives.turning.element_matrix
    names = arm.robot.joint_names
    felt = turns
    if simulator.mjcf:
        names = arm.friction.names
        felt = np.eye(len(turns))
    fits = []
    used, words = _speeds_in_use(arm, turns[: len(names)], speeds)
    for k, (name, speed) in enumerate(zip(names, used, strict=True)):
        fit = fit_friction(
            simulator, name, [arm.friction.elements[e] for e in np.flatnonzero(felt[:, k])], speed
        )
        fits.append(fit if simulator.mjcf else _with_coupling(fit, arm, k, used))
    files = files_of(arm, simulator, fits)
    lost = _arm_losses(arm, simulator)
    return Export(simulator, tuple(fits), files, tuple(lost), words)


def _speeds_in_use(
    arm: Arm, turns: Array, speeds: tuple[float, float] | None
) -> tuple[list[Array], str]:
    """Return the speeds of each row of turns, shape (k, joints), and their source in words."""
    if speeds is not None:
        low, high = speeds
        return [speeds_up_to(high, low)] * len(turns), f"from {low:g} to {high:g} rad/s"
    used = [speeds_up_to(high) for high in np.abs(turns) @ arm.robot.max_velocity]
    words = f"from {LINEAR_SPEED:g} rad/s to the largest of each joint"
    identified = _identified_ranges(arm)
    if identified:
        for k, name in enumerate(arm.friction.names[: len(turns)]):
            if name in identified:
                used[k] = speeds_up_to(*identified[name])
        words = "those over which each element was identified; of others " + words
    return used, words


def _identified_ranges(arm: Arm) -> dict[str, tuple[float, float]]:
    """Return the slowest and the fastest speed at which each element was identified, by its friction file."""
    file = arm.friction.file
    found = {} if file is None else FrictionFile.read(file).identification or {}
    try:
        return {
            name: (float(high), float(low))
            for name, (low, high) in (found.get("speeds") or {}).items()
        }
    except _OTHER_SHAPE as error:
        raise ConfigError(
            f"{plain(str(file))}: its identification has another shape; accepted: as rx90 identify writes it"
        ) from error


def _with_coupling(fit: FrictionFit, arm: Arm, joint: int, used: Sequence[Array]) -> FrictionFit:
    """Return the fit of a joint with a bound of what it errs more while others turn its shared elements, too.

    Against the joint's own motion they have an element's largest torque of the one sign in place of the other one.
    """
    rows = arm.drives.turning.element_matrix
    fastest = np.array([speeds.max() for speeds in used])
    lost = list(fit.lost)
    coupled = 0.0
    for e in np.flatnonzero(rows[:, joint]).tolist():
        others = [k for k in np.flatnonzero(rows[e]).tolist() if k != joint]
        if others:
            speeds = np.geomspace(_BESIDE, np.abs(rows[e]) @ fastest, POINTS)
            torque = arm.friction.elements[e].steady_torque(np.concatenate([-speeds, speeds]))
            most = float(np.abs(rows[e, joint]) * np.ptp(torque))
            moving = " and ".join(arm.robot.joint_names[k] for k in others)
            lost.append(
                f"coupling: while {moving} moves, {arm.friction.names[e]} differs by at most {most:.3g} Nm more"
            )
            coupled += most
    return replace(fit, lost=tuple(lost), coupled=coupled)


def _arm_losses(arm: Arm, target: Target) -> list[str]:
    """Return properties of the drives that a target does not represent."""
    drives = arm.drives
    lost = []
    if target.arm:
        lost.append(
            "drives: encoders, current loop, brakes; end stops are the simulator's own, at the joint limits"
        )
    else:
        lost.append("arm: the friction alone is written, with rotor inertias")
    if target.arm and not target.mjcf:
        if drives.spring_torque.any():
            lost.append(f"gravity-compensation springs: up to {drives.spring_torque.max():g} Nm")
        largest = drives.rotor_inertia.max()
        lost.append(
            f"rotor inertias, for which it has no place: up to {largest:g} kg m^2 at a joint"
        )
    if target.mjcf and not target.lugre:
        lost.append("rest: under less than its friction a joint creeps")
    if drives.elasticity.elastic.any():
        lost.append("elasticity and play of the gears: they are rigid")
    if drives.cogging.used and not target.lugre:
        lost.append(
            f"cogging: up to {np.abs(drives.cogging.amplitude).sum(axis=0).max():.3g} Nm of a motor"
        )
    if drives.winding.used:
        but = ", but for their temperatures" if target.lugre else ""
        lost.append(f"windings: rise of the resistance and derating{but}")
    return lost


def write_export(export: Export, folder: Path | str) -> None:
    """Write the files of an export, and REPORT beside them, into a new folder, all or none.

    Raises:
        ConfigError: if the folder exists.
        Rx90Error: if it cannot be written.
    """
    folder = Path(folder)
    if folder.exists():
        raise ConfigError(f"{plain(folder)} exists; accepted: a new name")
    try:
        folder.absolute().parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise write_error(folder, error) from error
    with atomic_files(folder) as (place,):
        place.mkdir()
        for name, text in {**export.files, REPORT: export.text}.items():
            (place / name).write_text(text, encoding="utf-8")
