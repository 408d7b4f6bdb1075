"""The files of results, and the report on them: main effects as statistics define them, worst runs, origins."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.stats

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, SweepError
from rx90_emulator.cli.frame import run
from rx90_emulator.sweep import store
from rx90_emulator.sweep.effects import MainEffect, SweptColumn, main_effect
from rx90_emulator.sweep.plots import distribution
from rx90_emulator.sweep.report import SweepFigures
from rx90_emulator.sweep.store import KEY, ResultStore, describe_results, parts_folder, read_sweep
from rx90_emulator.sweep.sweep import RunOutcome, Sweep


@pytest.fixture
def output(tmp_path: Path, sweep: Sweep, outcomes: list[RunOutcome]) -> Path:
    """Return the file of a finished sweep."""
    file = tmp_path / "out.parquet"
    with ResultStore(file, sweep) as kept:
        kept.add(reversed(outcomes))
    return file


def test_units_and_plan_are_in_the_file(output: Path, sweep: Sweep) -> None:
    """PyArrow and pandas find the unit of every number, and the metadata hold plan, seed, files and versions."""
    schema = pq.read_schema(output)
    units = {field.name: field.metadata[b"unit"].decode() for field in schema}
    for name, unit in (("path_error_worst", "m"), ("friction_work_joint_5_6", "J"), ("arm.link_3.mass", "kg"),
                       ("factor of friction.*.c0", "1")):  # fmt: skip
        assert units[name] == unit
    assert "friction.*.c0" not in units  # what is a factor does not stand under the parameter's name
    assert schema.field("viscous").type == pa.bool_()
    frame = pd.read_parquet(output)
    assert frame.attrs["units"] == units
    meanings = frame.attrs["meanings"]
    assert list(meanings) == list(units) == list(frame.columns)
    assert meanings["factor of friction.*.c0"].startswith("factor of friction.*.c0;")
    assert meanings["arm.link_3.mass"].startswith("value of arm.link_3.mass;")
    assert all(meanings.values())
    assert frame["index"].tolist() == list(range(len(sweep)))
    assert frame["path_error_worst"].isna().equals(frame["error"].notna())
    about = json.loads(schema.metadata[KEY])
    assert (about["seed"], about["runs"]) == (7, 40)
    assert about["plan"]["files"]["friction"]["name"] == "robots/rx90b/friction.yaml"
    assert len(about["plan"]["files"]["task"]["sha256"]) == 64
    assert about["versions"]["numpy"]
    lines = describe_results(output)
    assert lines[0].endswith("complete, 40 runs")
    assert any(line.startswith("4 runs failed (ConfigError 4), for example: ConfigError: arm") for line in lines)
    mass = next(line for line in lines if line.startswith("arm.link_3.mass"))
    assert mass.split() == ["arm.link_3.mass", "kg", "-1", "12", "20"]


def test_parts_are_readable_before_the_end(
    tmp_path: Path, sweep: Sweep, outcomes: list[RunOutcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    """While a sweep runs, pandas reads what is done out of its folder, and a torn file there is overlooked."""
    monkeypatch.setattr(store, "_FLUSH_AFTER", 0.0)
    monkeypatch.setattr(store, "_FLUSH_SHARE", 0.0)
    file = tmp_path / "out.parquet"
    with ResultStore(file, sweep) as kept:
        for first in (0, 4, 8):
            kept.add(outcomes[first : first + 4])
        (parts_folder(file) / ".part-000009.parquet").write_bytes(b"PAR1 torn")
        assert pd.read_parquet(parts_folder(file))["index"].tolist() == list(range(12))
        assert len(read_sweep(file)) == 12
        assert "12 of 40 runs; go on with --resume" in describe_results(file)[0]
        with pytest.raises(SweepError, match=r"out\.parquet\.parts exists; accepted: another output"):
            ResultStore(file, sweep)
    assert len(read_sweep(file)) == 12
    assert not parts_folder(file).exists()


def test_runs_are_there_once(output: Path, sweep: Sweep, outcomes: list[RunOutcome]) -> None:
    """A kill between gathering the parts and removing them leaves no run twice."""
    whole = output.read_bytes()
    kept = ResultStore(output, sweep, resume=True)
    kept.add(outcomes[:5])
    kept.flush()
    assert len(read_sweep(output)) == len(sweep)
    with kept:
        pass
    assert output.read_bytes() == whole


def test_existing_results_are_safe(output: Path, sweep: Sweep) -> None:
    """Without resume nothing is overwritten, with it no other plan is taken up; the message says so."""
    before = output.read_bytes()
    with pytest.raises(SweepError, match=r"exists; accepted: another output, or resume"):
        ResultStore(output, sweep)
    other = Sweep(sweep.plan.replaced(seed=8))
    with pytest.raises(SweepError, match="has other plan and files"):
        ResultStore(output, other, resume=True)
    changed = Sweep(sweep.plan)
    changed.versions = {**changed.versions, "numba": "0.1"}
    with pytest.raises(SweepError, match=r"has other versions: .*, not .*'numba': '0.1'"):
        ResultStore(output, changed, resume=True)
    assert output.read_bytes() == before


def test_foreign_files_are_refused(tmp_path: Path, sweep: Sweep) -> None:
    """A folder, a text, a torn file, somebody else's Parquet and missing columns are refused in one line, and stay."""
    text, foreign, lacking = (tmp_path / f"{name}.parquet" for name in ("text", "foreign", "lacking"))
    rows = store.table_of(sweep, store.schema_of(sweep), [])
    pq.write_table(rows.drop_columns(["index", "error"]), lacking)
    swapped = tmp_path / "swapped.parquet"
    pq.write_table(rows.select(rows.column_names[::-1]), swapped)
    text.write_text("index,error\n", encoding="utf-8")
    pq.write_table(pa.table({"index": [1, 2]}), foreign)
    torn = tmp_path / "torn.parquet"
    torn.write_bytes(foreign.read_bytes()[:-20])
    bomb = tmp_path / "bomb.parquet"
    pq.write_table(pa.table({"index": np.zeros(40_000_000, np.int8)}), bomb)
    assert bomb.stat().st_size < 1 << 20
    for file, said in (
        (tmp_path, "is a folder"),
        (bomb, "320,000,000 bytes unpacked; accepted: up to 268,435,456"),
        (torn, "cannot be read as Parquet"),
        (foreign, "is not a result of rx90 sweep"),
        (lacking, "lacking.parquet has other columns, lacking index, error; accepted: "),
        (swapped, "swapped.parquet has other columns, lacking none; accepted: "),
    ):
        with pytest.raises(SweepError, match=said) as error:
            ResultStore(file, sweep, resume=True)
        assert "\n" not in str(error.value)
    assert len(list(tmp_path.iterdir())) == 6


def test_a_damaged_part_is_named(tmp_path: Path, sweep: Sweep, outcomes: list[RunOutcome]) -> None:
    """A part with one flipped bit in its data is refused with what to do about it, and doing that goes on."""
    file = tmp_path / "out.parquet"
    store_of_killed = ResultStore(file, sweep)
    for first in (0, 20):
        store_of_killed.add(outcomes[first : first + 20])
        store_of_killed.flush()
    os.close(store_of_killed._lock)  # as the end of a killed process does
    part = parts_folder(file) / "part-000001.parquet"
    data = bytearray(part.read_bytes())
    data[100] ^= 1
    part.write_bytes(data)
    with pytest.raises(SweepError, match=r"part-000001.* cannot be read .*; accepted: remove this part") as error:
        ResultStore(file, sweep, resume=True)
    assert "\n" not in str(error.value)
    part.unlink()
    with ResultStore(file, sweep, resume=True) as kept:
        assert kept.done.sum() == 20


def test_one_sweep_at_a_time(tmp_path: Path, sweep: Sweep, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second sweep that resumes the same output is turned away while the first one runs, or takes its folder away."""
    file = tmp_path / "out.parquet"
    with ResultStore(file, sweep), pytest.raises(SweepError, match="another sweep is writing"):
        ResultStore(file, sweep, resume=True)
    with pytest.raises(ConfigError, match="cannot be written"):
        ResultStore(tmp_path / "no" / "out.parquet", sweep)
    monkeypatch.setattr(store.fcntl, "flock", lambda *_: shutil.rmtree(parts_folder(file)))
    with pytest.raises(SweepError, match="another sweep is writing"):
        ResultStore(file, sweep)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory, sweep: Sweep, outcomes: list[RunOutcome]) -> Path:
    """Return the file of the small sweep's results."""
    file = tmp_path_factory.mktemp("results") / "small.parquet"
    with ResultStore(file, sweep) as store:
        store.add(outcomes)
    return file


def effect(values: Array, metric: Array) -> MainEffect:
    """Return the main effect of a parameter."""
    return main_effect(SweptColumn("p", "1", "", values), metric)


def test_the_main_effect_is_that_of_an_analysis_of_variance() -> None:
    """Means by level, and the share of variance that SciPy's F statistic of the same groups stands for."""
    rng = np.random.default_rng(2)
    values = np.repeat([1.0, 2.0, 4.0], 30)
    metric = 3.0 * np.log(values) + rng.standard_normal(90)
    groups = [metric[values == value] for value in (1.0, 2.0, 4.0)]
    given, missing = rng.permutation(92), np.array([np.nan, 2.0])
    found = effect(np.append(values, missing)[given], np.append(metric, [1e9, np.nan])[given])
    f = scipy.stats.f_oneway(*groups).statistic
    eta = 2.0 * f / (2.0 * f + 87.0)
    assert found.share == pytest.approx(1.0 - (1.0 - eta) * 89.0 / 87.0, rel=1e-12)
    assert (found.levels.tolist(), found.runs) == ([1.0, 2.0, 4.0], 90)
    assert found.means == pytest.approx([group.mean() for group in groups])
    drawn = rng.random(4000)
    alone, nothing = effect(drawn, drawn), effect(drawn, rng.standard_normal(4000))
    assert len(alone.means) == 8
    assert alone.share == pytest.approx(1.0 - 1.0 / 64.0, abs=0.002)  # what is left within an eighth of the range
    assert nothing.share < 0.01
    assert np.isnan(effect(np.ones(5), rng.random(5)).share)


def test_the_figures_are_those_of_the_runs(results: Path, sweep: Sweep, outcomes: list[RunOutcome]) -> None:
    """Path errors in mm, failed runs left out, the distribution rising to 1, and every parameter with its effect."""
    figures = SweepFigures.of(results)
    errors = [None if one.metrics is None else one.metrics[0] for one in outcomes]
    assert [value is None for value in errors] == np.isnan(figures.worst).tolist()
    good = sorted(1e3 * value for value in errors if value is not None)
    assert np.sort(figures.worst[np.isfinite(figures.worst)]) == pytest.approx(good)
    assert {effect.column.name for effect in figures.effects} == {column.title for column in sweep.runs.columns}
    (shown,) = distribution({"worst": figures.worst})
    assert shown.xaxis.axis_label.text == "worst path error, mm"
    curve = shown.select_one({"name": "runs"}).data_source.data
    assert (curve["x"][0], curve["x"][-1], curve["y"][-1]) == (pytest.approx(good[0]), pytest.approx(good[-1]), 1.0)
    assert np.interp(good[17], curve["x"], curve["y"]) == pytest.approx(18 / 36, abs=1 / 36)


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
    assert run("rx90 sweep", ["report", str(results)]) == 0
    assert "None plant step" not in (tmp_path / results.with_suffix(".html").name).read_text(encoding="utf-8")
    assert capsys.readouterr().out == f"page: {tmp_path / 'small.html'}\n"
    text = (tmp_path / "small.html").read_text(encoding="utf-8")
    good = [one for one in outcomes if one.metrics is not None]
    worst = sorted(good, key=lambda one: -one.metrics[0])  # type: ignore[index]
    table = text[text.index("<h2>Worst runs") : text.index("<h2>Failed runs")]
    assert [int(row) for row in re.findall(r"<tr><td>(\d+)</td>", table)] == [one.run.index for one in worst[:10]]
    assert f"<b>{len(outcomes) - len(good)}</b> of {len(outcomes)} runs failed" in text
    assert "<code>robots/rx90b/drives.yaml</code>" in text
    assert re.search(r'<strong class="assumed">\w+ assumed</strong>', text)
    assert run("rx90 sweep", ["report", str(results)]) == 2
    assert "small.html exists; accepted: another name, or --force" in capsys.readouterr().err
    assert (tmp_path / "small.html").read_text(encoding="utf-8") == text
    check_report(tmp_path / "small.html")


def test_results_without_a_good_run_make_no_page(tmp_path: Path, sweep: Sweep, outcomes: list[RunOutcome]) -> None:
    """Where all runs have failed there is no path error to be drawn."""
    failed = [one for one in outcomes if one.metrics is None]
    with ResultStore(tmp_path / "bad.parquet", sweep) as store:
        store.add(failed)
    with pytest.raises(SweepError, match=r"bad\.parquet: no run has succeeded"):
        SweepFigures.of(tmp_path / "bad.parquet")
