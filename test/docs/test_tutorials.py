"""Tutorials, first pages and notebooks do what they say, with their commands, files and programs as written."""

import io
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import nbformat
import pytest
from page_session import PageSession, blocks
from processes import Processes
from two_joints import Bench

from rx90_emulator.cli.frame import run

DOCS = Path(__file__).resolve().parents[2] / "docs"
MADE = {
    "python": (
        "path_error.png friction.png reference_run/metadata.yaml grid.parquet scatter.parquet identified.yaml "
        "measured.html"
    ),
    "own_motion": "my_run.png",
    "friction": "joint_3.png",
    "own_identification": "run.csv",
    "README": "my_arm/report.html my_arm/friction.yaml check.html circle.yaml",
}
"""What pages leave in the reader's folder besides, by their names."""
OF_NODES = {"README", "own_motion", "own_controller", "controller_check", "another_arm"}
PAGES = [
    pytest.param(page, id=page.stem, marks=[pytest.mark.ros] * (page.stem in OF_NODES))
    for page in sorted(
        [
            DOCS.parent / "README.md",
            *(DOCS / "howto" / f"{name}.md" for name in ("own_controller", "controller_check")),
            *(DOCS / "tutorials").glob("*.md"),
            *(DOCS / "start").glob("*.md"),
        ]
    )
]


def write_logs(folder: Path) -> None:
    bench = Bench.make(folder)
    for seed, name in enumerate(("log", "unseen"), 1):
        assert (
            run("rx90 bag export", [str(bench.bag(f"{name}_bag", seed)), "--output", str(folder / f"{name}.csv")]) == 0
        )


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("page", PAGES)
def test_a_page_does_what_it_says(
    page: Path, processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every block of the page works, in its order, in an empty folder, and prints what the page says."""
    folder = tmp_path / "reader"
    folder.mkdir()
    monkeypatch.chdir(folder)
    mpl.use("Agg")
    if page.stem == "README":
        write_logs(folder)
    PageSession(page, processes).run()
    for made in MADE.get(page.stem, "").split():
        assert (folder / made).stat().st_size > 200, made


def test_no_command_of_a_tutorial_is_left_out() -> None:
    """What a reader of a tutorial is to type stands in blocks that are run, or that say that they are not."""
    for page in (DOCS / "tutorials").glob("*.md"):
        assert not [block for block in blocks(page) if block.language in {"sh", "bash"}], page.name


NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "docs/notebooks").glob("*.ipynb"))


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every cell runs, in their order and an empty folder, and every plot is drawn; the file holds no outputs."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in code)
    mpl.use("Agg")
    plt.close("all")
    names: dict[str, object] = {}
    with plt.rc_context():
        for cell in code:
            exec(compile(cell.source, str(path), "exec"), names)
            drawn = plt.get_fignums()
            for number in drawn:
                plt.figure(number).savefig(io.BytesIO())
            plt.close("all")
            assert len(drawn) == ("plt." in cell.source and "rcParams" not in cell.source), cell.source
    assert sum("plt." in cell.source for cell in code) > 4
