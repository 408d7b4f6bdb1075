"""Figures in README.md and docs/ are generated from the measurements, and from nothing else."""

from __future__ import annotations

import json
import re

import pytest

from benchmarks.figures import MEASURED, Range, add, as_text, pages, read, tables, with_figures
from rx90_common.base.errors import ConfigError


def test_pages_hold_what_is_generated() -> None:
    """README.md and docs/ equal what `python -m benchmarks.figures` writes; each table stands in one of them."""
    measured = read(MEASURED)
    contents = {page: page.read_text(encoding="utf-8") for page in pages()}
    for page, content in contents.items():
        assert content == with_figures(content, measured), f"{page.name}: run python -m benchmarks.figures"
    placed = re.findall(r"<!-- figures: (\w+) -->\n\|", "\n".join(contents.values()))
    assert sorted(placed) == sorted(tables())
    assert MEASURED.read_text(encoding="utf-8") == as_text(add(measured, {}))


@pytest.mark.parametrize(
    ("values", "runs", "spec", "shown"),
    [
        ([0.25], [], ".3f", "0.250"),
        ([3999.0, 4001.0], [], ",.0f", "3,999 to 4,001"),
        ([0.744, 0.738], [], ".0f%", "74"),
        ([2.0, 1.8], [1.5, 2.25], ".1f", "1.8 to 2.0 (single runs: 1.5 to 2.2)"),
        ([], [], ".1f", "not measured yet"),
    ],
)
def test_a_range_names_the_lowest_and_the_highest(
    values: list[float], runs: list[float], spec: str, shown: str
) -> None:
    """Two ends, one where they look the same, single runs where they are known, and no number without a measurement."""
    assert format(Range(values, runs), spec) == shown


def test_a_machine_s_run_is_added() -> None:
    """Values of a run widen the range of what is shown; equal values and other figures add nothing."""
    run = {"sweep_1000_runs_s": 9.0, "versus_mujoco_c": 7.0, "versus_mujoco_c_lowest": 6.5, "of no table": 1.0}
    measured = add({"sweep_1000_runs_s": [10.0, 12.0], "versus_mujoco_c": [7.0]}, run)
    assert measured == {
        "sweep_1000_runs_s": [9.0, 10.0, 12.0],
        "versus_mujoco_c": [7.0],
        "versus_mujoco_c_lowest": [6.5],
    }
    assert json.loads(as_text(measured)) == measured
    assert "| 9 to 12 s |" in with_figures("<!-- figures: main -->\n<!-- end of figures -->", measured)
    assert "| not measured yet |" in with_figures("<!-- figures: main -->\n<!-- end of figures -->", {})
    assert "not measured yet s" not in with_figures("<!-- figures: main -->\n<!-- end of figures -->", {})


def test_what_cannot_be_used_is_refused() -> None:
    """A table that there is not, and a figure that is not a number, are named with what is accepted."""
    with pytest.raises(ConfigError, match=r"^sweep_1000_runs_s is \[9\.0\]; accepted: a number$"):
        add({}, {"sweep_1000_runs_s": [9.0]})  # type: ignore[dict-item]
    with pytest.raises(ConfigError, match="the table is 'speed'; accepted: main, path_error"):
        with_figures("<!-- figures: speed -->\n<!-- end of figures -->", {})
