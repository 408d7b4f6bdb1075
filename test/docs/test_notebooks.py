"""The notebooks of docs/ run from their first cell to their last, and draw what they say; `make docs` has a kernel."""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import nbformat
import pytest

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
