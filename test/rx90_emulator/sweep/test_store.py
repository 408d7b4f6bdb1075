"""The files of results, whole, in parts and damaged."""

import json
import os
import shutil
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rx90_common.base.errors import ConfigError, SweepError
from rx90_emulator.sweep import store
from rx90_emulator.sweep.store import KEY, ResultStore, describe_results, parts_folder, read_sweep
from rx90_emulator.sweep.sweep import RunOutcome, Sweep


@pytest.fixture
def output(tmp_path: Path, sweep: Sweep, outcomes: list[RunOutcome]) -> Path:
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
    for file, said in (
        (tmp_path, "is a folder"),
        (torn, "cannot be read as Parquet"),
        (foreign, "is not a result of rx90 sweep"),
        (lacking, "lacking.parquet has other columns than"),
        (swapped, "swapped.parquet has other columns than"),
    ):
        with pytest.raises(SweepError, match=said) as error:
            ResultStore(file, sweep, resume=True)
        assert "\n" not in str(error.value)
    assert len(list(tmp_path.iterdir())) == 5


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
