"""Export of a robot's friction, and its arm, to another simulator: the files, their errors, and a verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import yaml_text
from rx90_common.base.errors import ConfigError, check_type
from rx90_common.base.quoting import aligned, listed, plain, quoted
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.parts.part import LINEAR_SPEED
from rx90_common.process.files import made_folder, write_all
from rx90_emulator.export.files import files_of
from rx90_emulator.export.fit import FrictionFit, fit_friction, speeds_up_to
from rx90_emulator.export.targets import TARGETS, Target
from rx90_emulator.loop.setup import Arm

REPORT = "export.yaml"
"""The file beside those of the simulator that states the errors of the export."""

_GRID = 1_000_000  # most combinations of the speeds of joints that move at once
_BESIDE = 1e-9  # rad/s beside rest: above the rounding of sums of speeds, far below the Stribeck velocities
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
        """Return the largest difference of a friction torque, Nm, also while other joints move."""
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

    def report(self) -> str:
        """Return the same as YAML."""
        elements = {
            fit.name: {
                "speeds": [float(fit.speeds.min()), float(fit.speeds.max())],
                "largest_difference": fit.largest,
                "rms_difference": fit.rms,
                "more_while_others_move": fit.coupled,
                "largest_while_others_move": fit.worst,
                "break_away": {"robot": list(fit.break_away[0]), "exported": list(fit.break_away[1])},
                "presliding_stiffness": {"robot": fit.stiffness[0], "exported": _finite(fit.stiffness[1])},
                "exported": {
                    key: list(value) if isinstance(value, tuple) else _finite(value)
                    for key, value in vars(fit.law).items()
                },
                "lost": list(fit.lost),
            }
            for fit in self.fits
        }  # fmt: skip
        head = f"# What {self.target.name} holds of this robot's friction: Nm, rad/s, Nm/rad, joint side.\n"
        content: dict[str, Any] = {"target": self.target.name, "speeds": self.speeds}
        return head + yaml_text(content | {"lost": list(self.lost), "friction": elements})


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


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
    """Return the fit of a joint with its errors where its friction depends on other joints' motion, too.

    The joint's friction and the target's law are compared over the grid of all their speeds in use, of either sign, and
    where these cancel in an element.
    """
    rows = arm.drives.turning.element_matrix
    felt: list[int] = np.flatnonzero(rows[:, joint]).tolist()
    turning: list[int] = np.flatnonzero(rows[felt].any(axis=0)).tolist()
    joints = [joint, *(k for k in turning if k != joint)]
    if len(joints) == 1:
        return fit
    count = int(_GRID ** (1.0 / len(joints))) // 2
    signed = []
    for k in joints:
        speeds = np.sort(used[k])
        if len(speeds) > count:
            speeds = speeds[np.linspace(0, len(speeds) - 1, count).astype(int)]
        signed.append(np.concatenate([-speeds, speeds]))
    grid = [*np.meshgrid(*signed, indexing="ij", sparse=True)]
    combinations = [grid]
    for e in felt:
        combinations += _near_rest(rows[e, joints], grid)
    worst = fit.largest
    more = dict.fromkeys(felt, 0.0)
    for combination in combinations:
        alone = combination[0]
        difference = -np.sign(alone) * fit.law.torque(np.abs(alone))
        for e in felt:
            element = arm.friction.elements[e]
            turn = rows[e, joint]
            inputs = sum(rows[e, k] * speed for k, speed in zip(joints, combination, strict=True))
            torque = turn * element.steady_torque(inputs)
            difference = difference + torque
            more[e] = max(
                more[e], float(np.abs(torque - turn * element.steady_torque(turn * alone)).max())
            )
        worst = max(worst, float(np.abs(difference).max()))
    lost = list(fit.lost)
    coupled = 0.0
    for e in felt:
        others = [arm.robot.joint_names[k] for k in joints[1:] if rows[e, k]]
        if others:
            name = arm.friction.names[e]
            lost.append(
                f"coupling: while {' and '.join(others)} moves, {name} differs by up to {more[e]:.3g} Nm more"
            )
            coupled += more[e]
    return replace(fit, lost=tuple(lost), coupled=coupled, worst=worst)


def _near_rest(turns: Array, grid: Sequence[Array]) -> list[list[Array]]:
    """Return the grid with the speed of one joint such that an element all but rests, where it breaks away.

    Args:
        turns: how much the element turns with each joint of the grid, shape (joints,).
        grid: speeds of each joint, rad/s, sparse.
    """
    combinations: list[list[Array]] = []
    if not turns[1:].any():
        return combinations
    for place in np.flatnonzero(turns).tolist():
        rest = sum(-turns[k] / turns[place] * grid[k] for k in range(len(grid)) if k != place)
        range_of = np.abs(grid[place])
        reached = np.copysign(np.clip(np.abs(rest), range_of.min(), range_of.max()), rest)
        combinations += [
            [*grid[:place], reached + side, *grid[place + 1 :]] for side in (-_BESIDE, _BESIDE)
        ]
    return combinations


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
    texts = {**export.files, REPORT: export.report()}
    with made_folder(folder):
        write_all({folder / name: text.encode() for name, text in texts.items()})
