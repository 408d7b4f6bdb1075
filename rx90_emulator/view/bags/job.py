"""From the paths of bags to a page that plays them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from rx90_common.bags.recorded import time_shift
from rx90_common.base.quoting import one_line
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.identification.options import MeasuredLayout
from rx90_emulator.view.bags.difference import difference
from rx90_emulator.view.bags.player import BagPlayer
from rx90_emulator.view.bags.recording import open_recording
from rx90_emulator.view.page import Page


def open_player(
    make_page: Callable[[], Page], paths: Sequence[Path], files: RobotFiles, layout: MeasuredLayout, align: int | str
) -> tuple[Page, BagPlayer]:
    """Read one bag or two, and only then make the page and show them.

    Args:
        make_page: called once the bags are read.
        paths: of the bags.
        files: of the robot that they are of.
        layout: what their messages hold where it is not as here.
        align: what the stamps of the second are moved by, as in `Scope`.

    Raises:
        Rx90Error: for bags that cannot be read or do not fit together, robot files and pages that cannot be.
    """
    robot = load_robot(files.urdf, files.tool)
    recordings = [open_recording(path, robot, files, layout) for path in paths]
    for path, recording in zip(paths, recordings, strict=True):
        for note in recording.notes:
            print(one_line(f"{path}: {note}"), file=sys.stderr)
    found, shift = None, 0
    if len(recordings) > 1:
        shift = time_shift(align, *recordings)
        recordings[1] = recordings[1].moved(shift)
        first, second = recordings
        found = difference(first.arm, second.arm, robot.chain, (first.path, second.path))
    page = make_page()
    try:
        return page, BagPlayer(page, robot, recordings, found, shift)
    except BaseException:
        page.close()
        raise
