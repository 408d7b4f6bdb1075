"""The report of a sweep: main effects as statistics define them, worst runs, origins, and a page as all reports are."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from rx90_common.base.errors import SweepError
from rx90_common.report.plot import Curve, Panel
from rx90_emulator.cli.frame import run
from rx90_emulator.sweep.report import SweepFigures, distribution_plot, main_effect
from rx90_emulator.sweep.store import ResultStore
from rx90_emulator.sweep.sweep import RunOutcome, Sweep


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory, sweep: Sweep, outcomes: list[RunOutcome]) -> Path:
    """Return the file of the small sweep's results."""
    file = tmp_path_factory.mktemp("results") / "small.parquet"
    with ResultStore(file, sweep) as store:
        store.add(outcomes)
    return file


def test_the_main_effect_is_that_of_an_analysis_of_variance() -> None:
    """Means by level, and the share of variance that SciPy's F statistic of the same groups stands for."""
    rng = np.random.default_rng(2)
    values = np.repeat([1.0, 2.0, 4.0], 30)
    metric = 3.0 * np.log(values) + rng.standard_normal(90)
    groups = [metric[values == value] for value in (1.0, 2.0, 4.0)]
    given, missing = rng.permutation(92), np.array([np.nan, 2.0])
    found = main_effect("p", np.append(values, missing)[given], np.append(metric, [1e9, np.nan])[given])
    f = scipy.stats.f_oneway(*groups).statistic
    eta = 2.0 * f / (2.0 * f + 87.0)
    assert found.share == pytest.approx(1.0 - (1.0 - eta) * 89.0 / 87.0, rel=1e-12)
    assert (found.values.tolist(), found.runs) == ([1.0, 2.0, 4.0], 90)
    assert found.means == pytest.approx([group.mean() for group in groups])
    drawn = rng.random(4000)
    alone, nothing = main_effect("x", drawn, drawn), main_effect("x", drawn, rng.standard_normal(4000))
    assert len(alone.means) == 8
    assert alone.share == pytest.approx(1.0 - 1.0 / 64.0, abs=0.002)  # what is left within an eighth of the range
    assert nothing.share < 0.01
    assert np.isnan(main_effect("one", np.ones(5), rng.random(5)).share)


def test_the_figures_are_those_of_the_runs(results: Path, sweep: Sweep, outcomes: list[RunOutcome]) -> None:
    """Path errors in mm, failed runs left out, the distribution rising to 1, and every parameter with its effect."""
    figures = SweepFigures.of(results)
    errors = [None if one.metrics is None else one.metrics[0] for one in outcomes]
    assert [value is None for value in errors] == np.isnan(figures.worst).tolist()
    good = sorted(1e3 * value for value in errors if value is not None)
    assert np.sort(figures.worst[np.isfinite(figures.worst)]) == pytest.approx(good)
    assert {one.name for one in figures.effects} == {column.title for column in sweep.runs.columns}
    (panel,) = distribution_plot(figures).panels
    assert isinstance(panel, Panel)
    (curve,) = (mark for mark in panel.marks if isinstance(mark, Curve) and mark.label == "worst")
    assert (curve.x[0], curve.x[-1], curve.y[-1]) == (pytest.approx(good[0]), pytest.approx(good[-1]), 1.0)
    assert np.interp(good[17], curve.x, curve.y) == pytest.approx(18 / 36, abs=1 / 36)


def test_the_page_says_what_came_and_from_where(
    results: Path,
    tmp_path: Path,
    outcomes: list[RunOutcome],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    check_report: Callable[[Path], None],
) -> None:
    """Worst runs in their order, failures, the files with assumed blocks marked; a page that exists is not replaced."""
    monkeypatch.chdir(tmp_path)
    assert run("rx90_sweep", ["report", str(results)]) == 0
    assert capsys.readouterr().out == f"page: {tmp_path / 'small.html'}\n"
    text = (tmp_path / "small.html").read_text(encoding="utf-8")
    good = [one for one in outcomes if one.metrics is not None]
    worst = sorted(good, key=lambda one: -one.metrics[0])  # type: ignore[index]
    table = text[text.index("<h2>Worst runs") : text.index("<h2>Failed runs")]
    assert [int(row) for row in re.findall(r"<tr><td>(\d+)</td>", table)] == [one.run.index for one in worst[:10]]
    assert f"<b>{len(outcomes) - len(good)}</b> of {len(outcomes)} runs failed" in text
    assert "<code>robots/rx90b/drives.yaml</code>" in text
    assert re.search(r'<strong class="assumed">\w+ assumed</strong>', text)
    assert run("rx90_sweep", ["report", str(results)]) == 2
    assert "small.html exists; accepted: another name, or --force" in capsys.readouterr().err
    assert run("rx90_sweep", ["report", str(tmp_path / "small.html"), "--force"]) == 2
    assert "cannot be read as Parquet" in capsys.readouterr().err
    assert (tmp_path / "small.html").read_text(encoding="utf-8") == text
    check_report(tmp_path / "small.html")


def test_results_without_a_good_run_make_no_page(tmp_path: Path, sweep: Sweep, outcomes: list[RunOutcome]) -> None:
    """Where all runs have failed there is no path error to be drawn."""
    failed = [one for one in outcomes if one.metrics is None]
    with ResultStore(tmp_path / "bad.parquet", sweep) as store:
        store.add(failed)
    with pytest.raises(SweepError, match=r"bad\.parquet: no run has succeeded"):
        SweepFigures.of(tmp_path / "bad.parquet")
