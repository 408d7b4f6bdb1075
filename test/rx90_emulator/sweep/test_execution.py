"""The same results wherever and in whatever order the runs are computed, what a run is judged by, and the command."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path

import distributed
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from processes import Start, wait_until

import rx90_emulator as rx
from rx90_common.base.errors import SweepError
from rx90_common.base.share import config_path
from rx90_common.process.children import TIMEOUT, executable
from rx90_emulator.cli.frame import run
from rx90_emulator.sweep import execution
from rx90_emulator.sweep.execution import dask_pool, local_pool, run_sweep
from rx90_emulator.sweep.plan import SweepBase, SweepPlan, load_sweep_plan
from rx90_emulator.sweep.store import parts_folder, read_sweep, schema_of, table_of
from rx90_emulator.sweep.sweep import RunOutcome, Sweep, measure, metrics_of


@pytest.fixture(scope="module")
def expected(sweep: Sweep, outcomes: list[RunOutcome]) -> pa.Table:
    return table_of(sweep, schema_of(sweep), outcomes)


def assert_same(table: pa.Table, expected: pa.Table) -> None:
    assert table.schema.equals(expected.schema, check_metadata=True)
    assert table.equals(expected)


def test_workers_change_nothing(tmp_path: Path, sweep: Sweep, expected: pa.Table) -> None:
    """One worker and three write the same file, byte for byte, with the results of runs in this process."""
    for workers in (1, 3):
        assert run_sweep(sweep, tmp_path / f"{workers}.parquet", workers=workers, quiet=True) == (len(sweep), 4)
    assert_same(read_sweep(tmp_path / "1.parquet"), expected)
    assert len({file.read_bytes() for file in tmp_path.iterdir()}) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["1.parquet", "3.parquet"]
    other, order = Sweep(sweep.plan), np.random.default_rng(0).permutation(len(sweep)).tolist()
    outcomes = sorted((other.run(index) for index in order), key=lambda one: one.run.index)
    assert_same(table_of(sweep, schema_of(sweep), outcomes), expected)


@contextmanager
def a_cluster(processes: int) -> Iterator[distributed.LocalCluster]:
    """Give a Dask cluster of so many processes, which find the rooms as these tests do."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(__file__).resolve().parents[3]))
        with distributed.LocalCluster(
            n_workers=processes, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs="CRITICAL"
        ) as cluster:
            yield cluster


@pytest.fixture
def cluster() -> Iterator[distributed.LocalCluster]:
    with a_cluster(2) as cluster:
        yield cluster


def test_cluster_changes_nothing(
    tmp_path: Path, sweep: Sweep, expected: pa.Table, cluster: distributed.LocalCluster
) -> None:
    """Two processes of a Dask cluster give the same table; one that is killed with work in hand costs no run."""
    run_sweep(sweep, tmp_path / "out.parquet", scheduler=cluster.scheduler_address, quiet=True)
    assert_same(read_sweep(tmp_path / "out.parquet"), expected)
    victim = next(iter(cluster.workers.values())).process.pid
    with dask_pool(sweep, cluster.scheduler_address) as pool:
        futures = [pool.submit([index]) for index in range(len(sweep))]
        os.kill(victim, signal.SIGKILL)
        outcomes = [outcome for future in futures for outcome in future.result(timeout=TIMEOUT)]
    assert_same(table_of(sweep, schema_of(sweep), outcomes), expected)


class Ended:
    """What only the process that made it may delete, as nodes of rclpy, whose threads a fork does not have."""

    def __init__(self) -> None:
        self.cycle = self
        self.process = os.getpid()

    def __del__(self) -> None:
        if os.getpid() != self.process:
            os._exit(1)


def test_workers_leave_the_garbage_of_their_parent_alone(
    tmp_path: Path, sweep: Sweep, expected: pa.Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What lay about when they were forked is not theirs to delete."""
    warm_up = Sweep.warm_up

    def leave_garbage(sweep: Sweep) -> None:
        warm_up(sweep)
        for _ in range(3):
            Ended()

    monkeypatch.setattr(Sweep, "warm_up", leave_garbage)
    run_sweep(sweep, tmp_path / "out.parquet", workers=2, quiet=True)
    assert_same(read_sweep(tmp_path / "out.parquet"), expected)


def test_no_cluster(tmp_path: Path, sweep: Sweep, monkeypatch: pytest.MonkeyPatch) -> None:
    """An address where nobody answers, that is none, or has no workers, is refused in one line and leaves nothing."""
    monkeypatch.setattr(execution, "_CONNECT_TIMEOUT", 0.2)
    for address, said in (
        ("tcp://127.0.0.1:1", "no Dask scheduler answers at tcp://127.0.0.1:1"),
        ("nonsense://x", "no Dask scheduler answers at nonsense://x"),
        ("foo", "no Dask scheduler answers at foo"),
    ):
        with pytest.raises(SweepError, match=said) as error:
            run_sweep(sweep, tmp_path / "out.parquet", scheduler=address, quiet=True)
        assert "\n" not in str(error.value)
    monkeypatch.undo()
    with a_cluster(0) as cluster, pytest.raises(SweepError, match="has no workers"):
        run_sweep(sweep, tmp_path / "out.parquet", scheduler=cluster.scheduler_address, quiet=True)
    assert not list(tmp_path.iterdir())


def test_resuming_completes(tmp_path: Path, sweep: Sweep, expected: pa.Table) -> None:
    """A result that lacks runs is completed to the same table, computing those alone."""
    output = tmp_path / "out.parquet"
    pq.write_table(expected.take([0, 3, 4, 17, 39]), output)
    counts = run_sweep(sweep, output, workers=2, resume=True, quiet=True)
    assert counts.computed == len(sweep) - 5
    assert_same(read_sweep(output), expected)
    before = output.read_bytes()
    assert run_sweep(sweep, output, workers=2, resume=True, quiet=True).computed == 0
    assert output.read_bytes() == before


@pytest.mark.parametrize(
    ("path", "factor", "values", "said"),
    [
        ("friction.*.c1", True, (1.0, 1e7), "ConfigError: friction.joint_6.c1 is 5e+07 Nm s/rad"),
        ("controller.following_error[1]", False, (0.05, 1e-6), "SupervisionError: joint_2: following error"),
        ("controller.start_tolerance", False, (1e-3, 0.0), "TrajectoryError: point 0"),
        ("task.end[0]", False, (0.604, 3.0), "LineError: the line cannot be travelled at"),
    ],
)
def test_a_failing_run_is_a_row(
    tmp_path: Path, task_file: Path, path: str, factor: bool, values: tuple[float, ...], said: str
) -> None:
    """A bad value, a drive fault, a refused trajectory, a line out of reach end their own run alone."""
    swept = {"paths": [path], "factor" if factor else "value": values}
    blocks = {"a": {"grid": {"swept": swept}}}
    sweep = Sweep(SweepPlan.model_validate({"blocks": blocks, "base": {"task": str(task_file)}}))
    assert run_sweep(sweep, tmp_path / "out.parquet", workers=1, quiet=True) == (2, 1)
    good, bad = read_sweep(tmp_path / "out.parquet").to_pylist()
    assert good["error"] is None
    assert 0 < good["path_error_worst"] < 1e-3
    assert bad["error"].startswith(said)
    assert all(bad[metric.name] is None for metric in sweep.metrics)
    assert bad["factor of swept" if factor else "swept"] == values[1]


def test_an_error_that_nobody_thought_of_is_a_row(sweep: Sweep, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever a run raises becomes one line of its own row."""

    def fail(*_: object) -> None:
        raise MemoryError("no room for\n7 TiB")

    monkeypatch.setattr("rx90_emulator.sweep.sweep.measure", fail)
    outcome = sweep.run(0)
    assert outcome.metrics is None
    assert outcome.error == "MemoryError: no room for 7 TiB"


def test_a_lost_worker_is_said(sweep: Sweep) -> None:
    """A worker process that is killed ends the sweep with an error instead of a wait without end."""

    def lose() -> None:
        before = active_children()
        with local_pool(sweep, 1) as pool:
            (worker,) = set(active_children()) - set(before)
            worker.kill()
            pool.submit([0]).result(timeout=TIMEOUT)

    with pytest.raises(SweepError, match="a worker process died"):
        lose()


def test_a_sweep_goes_along_a_path(shipped: rx.Setup) -> None:
    """The task may be a path file: path errors of its runs are those of `run_path` at the speed of the run."""
    speeds, file = (0.05, 0.1), config_path("paths/circle.yaml")
    sweep = Sweep(SweepPlan.of_grid({"task.speed": speeds}, SweepBase(task=str(file))))
    column = [metric.name for metric in sweep.metrics].index("path_error_worst")
    for index, speed in enumerate(speeds):
        metrics = sweep.run(index).metrics
        accuracy = rx.run_path(shipped, replace(rx.load_path(file), speed=speed)).path_accuracy
        assert metrics[column] == pytest.approx(accuracy.worst, abs=1e-12)
        assert metrics[column + 2] == pytest.approx(accuracy.worst_along_track, abs=1e-12)
        assert metrics[column + 3] == pytest.approx(accuracy.worst_orientation, rel=5e-3)


def test_metrics_of_a_run(shipped: rx.Setup, task: rx.LineTask) -> None:
    """The metrics are those that the series of the run give, from the line's start until it has settled."""
    result = rx.run_line(shipped, task)
    names = [metric.name for metric in metrics_of(shipped.robot.joint_names, shipped.friction.names)]
    found = dict(zip(names, measure(task, result), strict=True))
    accuracy = rx.path_accuracy(shipped.robot, task, result.times, result.slow.joint_states[:, 0])
    # The error that remains of two ways to the same sum, against 1e-5 m.
    assert abs(found["path_error_worst"] - accuracy.worst) < 1e-13
    assert abs(found["path_error_rms"] - accuracy.rms) < 1e-13
    assert found["along_track_worst"] == pytest.approx(accuracy.worst_along_track, abs=1e-13)
    assert found["orientation_worst"] == pytest.approx(accuracy.orientation[::10].max(), rel=1e-9)
    rows = np.isin(result.times, accuracy.times)
    error, joint = result.slow.tracking_error[rows, 0], result.slow.joint_states[rows]
    friction = result.slow.friction_states[rows]
    for i in range(6):
        assert found[f"tracking_error_worst_joint_{i + 1}"] == np.abs(error[:, i]).max()
        assert np.isclose(found[f"tracking_error_rms_joint_{i + 1}"], error[:, i].std(mean=0.0), rtol=1e-12)
        assert found[f"velocity_peak_joint_{i + 1}"] == np.abs(joint[:, 1, i]).max()
        assert found[f"drive_torque_peak_joint_{i + 1}"] == np.abs(joint[:, 2, i]).max()
        assert found[f"saturated_ticks_motor_{i + 1}"] == result.saturated[i]
    for i, name in enumerate(shipped.friction.names):
        power = friction[:, 1, i] * friction[:, 2, i]
        assert np.isclose(found[f"friction_work_{name}"], (power[1:] + power[:-1]).sum() / 2 * 1e-3)


ROOT = Path(__file__).resolve().parents[3]
ENDLESS = """
seed: 3
base: {{task: {task}}}
blocks:
  many:
    random:
      friction.*.c0: {{factor: {{uniform: [0.5, 2.0]}}}}
    draws: 1000000
"""


@pytest.fixture
def plan_file(tmp_path: Path, task_file: Path, sweep: Sweep) -> Path:
    del sweep
    file = tmp_path / "plan.yaml"
    file.write_text(ENDLESS.format(task=task_file), encoding="utf-8")
    return file


def parts(output: Path) -> list[Path]:
    return list(parts_folder(output).glob("part-*.parquet"))


def alive(pid: int) -> bool:
    """Return whether a process runs; one that ended and was not waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def assert_true_rows(output: Path, plan_file: Path) -> int:
    """Check the first and the last kept run against a run of it alone; return how many are kept."""
    table, sweep = read_sweep(output), Sweep(load_sweep_plan(plan_file))
    for row in (0, len(table) - 1):
        kept = table.slice(row, 1).to_pylist()[0]
        outcome = sweep.run(kept["index"])
        assert outcome.metrics == tuple(kept[metric.name] for metric in sweep.metrics)
    return len(table)


def test_interrupt_and_kill_keep_what_is_done(
    tmp_path: Path, plan_file: Path, start_apart: Start, request: pytest.FixtureRequest
) -> None:
    """Ctrl-C exits 130, says how to go on and leaves one readable file; a resumed sweep that is killed adds to it."""
    output = tmp_path / "out.parquet"
    command = executable("rx90 sweep", "run", plan_file, "--output", output, "--workers", "2")
    first = start_apart(*command, cwd=ROOT)
    wait_until(lambda: bool(parts(output)), "the first part")
    os.killpg(first.pid, signal.SIGINT)
    _, error = first.communicate(timeout=TIMEOUT)
    assert first.returncode == 130
    assert [line for line in error.splitlines() if "compiling the numerical kernels" not in line] == [
        "rx90 sweep: interrupted; what is done is kept; go on with: "
        f"rx90 sweep run {plan_file} --output {output} --resume"
    ]
    assert not parts_folder(output).exists()
    kept = assert_true_rows(output, plan_file)

    request.getfixturevalue("warm")  # how it starts has been seen
    second = start_apart(*command, "--resume", cwd=ROOT)
    wait_until(lambda: bool(parts(output)), "its first part")
    workers = [
        int(pid) for pid in Path(f"/proc/{second.pid}/task/{second.pid}/children").read_text(encoding="utf-8").split()
    ]
    second.send_signal(signal.SIGKILL)
    second.wait(timeout=TIMEOUT)
    assert len(workers) == 2
    wait_until(lambda: not any(alive(pid) for pid in workers), "the end of the workers")
    assert assert_true_rows(output, plan_file) > kept


@pytest.mark.parametrize("speeds", ["0.05, -1, 0.1", "-1, -2"])
def test_run_and_info(speeds: str, tmp_path: Path, task_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A plan runs to its end, is not run over again without need, and info shows what came of it."""
    plan, output = tmp_path / "plan.yaml", tmp_path / "out.parquet"
    grid = f"{{a: {{grid: {{task.speed: {{value: [{speeds}]}}}}}}}}"
    plan.write_text(f"base: {{task: {task_file}}}\nblocks: {grid}", encoding="utf-8")
    words, lost = ["run", str(plan), "--output", str(output), "--workers", "1"], not speeds.startswith("0")
    for more, said in (([], "3 of 3 runs"), (["--resume"], "is complete, 3 runs")):
        assert run("rx90 sweep", [*words, *more]) == (3 if lost else 0)
        out, err = capsys.readouterr()
        if lost:
            (line,) = (one for one in err.splitlines() if one.startswith("rx90 sweep: "))
            assert line.startswith("rx90 sweep: every run failed, for example: LineError: ")
            assert line.endswith(f"; rx90 sweep info {output} says more")
        else:
            assert said in out
            assert (f"1 failed (rx90 sweep info {output} says why)" in out) == (not more)
    assert run("rx90 sweep", ["info", str(output)]) == 0
    shown = capsys.readouterr().out
    assert ("2 runs failed (LineError 2)" if lost else "1 run failed (LineError 1)") in shown
    assert "path_error_worst" in shown
