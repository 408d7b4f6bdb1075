"""The robot that excitation runs identified, as files."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from rx90_common.base.quoting import listed
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.identification.excitation.result import ASSUMED_BRISTLES, ExcitationIdentification
from rx90_emulator.identification.output.robot.folder import IdentifiedRobot, folder_base, robot_texts
from rx90_emulator.identification.output.robot.marking import Identified


def robot_files(result: ExcitationIdentification, date: datetime) -> tuple[dict[str, str], str]:
    """Return the text of each file by its name, and in one line what they are.

    Args:
        result: what was identified.
        date: of the identification.

    Raises:
        Rx90Error: for a value that no file may hold.
    """
    problem, options, setup = result.problem, result.options, result.robot.setup
    drives = {}
    base: RobotFiles | None
    if setup is not None:
        files = setup.files or RobotFiles()
        urdf, base, note = files.urdf, files, "a robot folder; what the runs do not tell is as it was"
    else:
        urdf = Path(str(options.urdf))
        base, note = folder_base(problem.arm, urdf)
        if options.gear is not None:
            drives["transmission", "gear"] = _given(options.gear, "gear")
            if options.torque_constant is not None:
                drives["motor", "torque_constant"] = _given(options.torque_constant, "torque-constant")
    constants = torque_constants(result)
    if constants is not None:
        drives["motor", "torque_constant"] = constants
    robot = IdentifiedRobot(
        problem.arm,
        result.consistency.inertias,
        problem.columns.names,
        result.elements,
        result.robot.fallback_name or ASSUMED_BRISTLES,
        tuple(bag for use, bag in result.bags if use == "excitation"),
        drives,
    )
    return robot_texts(robot, urdf, base, date), note


def torque_constants(result: ExcitationIdentification) -> Identified | None:
    """Return the motors' torque constants with identified drive gains; None where nothing tells them.

    Efforts of another robot that are no currents of its motors tell gains, but no constants.
    """
    gains, setup, options = result.gains, result.robot.setup, result.options
    if gains is None or (setup is None and (options.gear is None or options.torque_constant is None)):
        return None
    before = options.torque_constant if setup is None else setup.drives.torque_constant
    values = np.asarray(before, dtype=np.float64) * gains.factor
    sure = [name for name, one in zip(result.problem.arm.names, gains.deviation, strict=True) if np.isfinite(one)]
    rest = "" if len(sure) == len(values) else "; the others are as before, for the payload does not tell them"
    odd = [result.problem.arm.names[k] for k in gains.implausible]
    rest += f"; {listed(odd)} hardly to be believed: parameters.yaml says why" if odd else ""
    return Identified(
        [float(f"{value:.6g}") for value in values], "identified",
        f"torques of {listed(sure)} in runs with and without a known payload{rest}",
    )  # fmt: skip


def _given(values: Sequence[float], option: str) -> Identified:
    return Identified([float(value) for value in values], "assumed", f"as given with --{option}")
