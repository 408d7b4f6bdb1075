"""The tutorials and the first pages do what they say, with their commands, files and programs as written."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import pytest
from page_session import PageSession, blocks
from processes import Processes

from rx90_emulator.identification.excitation import filtering, instruments

DOCS = Path(__file__).resolve().parents[2] / "docs"
MADE = {
    "python": (
        "path_error.png friction.png run.npz reference_run/metadata.yaml grid.parquet scatter.parquet identified.yaml "
        "measured.html"
    ),
    "own_motion": "my_run.png",
    "friction": "joint_3.png",
    "own_identification": "run.csv",
}
"""What pages leave in the reader's folder besides, by their names."""
OF_NODES = {"own_motion", "own_controller", "another_arm"}
PAGES = [
    pytest.param(page, id=page.stem, marks=[pytest.mark.ros] * (page.stem in OF_NODES))
    for page in sorted(
        [*(DOCS / "tutorials").glob("*.md"), *(DOCS / "start").glob("*.md"), DOCS / "howto" / "own_controller.md"]
    )
]


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("page", PAGES)
def test_a_page_does_what_it_says(
    page: Path, processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every block of the page works, in its order, in an empty folder, and prints what the page says."""
    folder = tmp_path / "reader"
    folder.mkdir()
    monkeypatch.chdir(folder)
    # Tests of identification look at simulations of the closed loop and at all rows; words and files need a part.
    monkeypatch.setattr(instruments, "_MAX_ROUNDS", 0)
    monkeypatch.setattr(filtering, "_MAX_ROWS", 4000)
    mpl.use("Agg")
    PageSession(page, processes).run()
    for made in MADE.get(page.stem, "").split():
        assert (folder / made).stat().st_size > 200, made


def test_no_command_of_a_tutorial_is_left_out() -> None:
    """What a reader of a tutorial is to type stands in blocks that are run, or that say that they are not."""
    for page in (DOCS / "tutorials").glob("*.md"):
        assert not [block for block in blocks(page) if block.language in {"sh", "bash"}], page.name
