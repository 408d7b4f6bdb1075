"""`rx90 sweep` as a person uses it, in a process of its own."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from processes import Start, wait_until

from rx90_common.process.children import TIMEOUT, executable
from rx90_emulator.cli.frame import run
from rx90_emulator.sweep.plan import load_sweep_plan
from rx90_emulator.sweep.store import parts_folder, read_sweep
from rx90_emulator.sweep.sweep import Sweep

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
    """Return a plan that takes hours; the kernels are compiled."""
    del sweep
    file = tmp_path / "plan.yaml"
    file.write_text(ENDLESS.format(task=task_file), encoding="utf-8")
    return file


def parts(output: Path) -> list[Path]:
    """Return the parts that an unfinished sweep has written."""
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
    plan, output, page = tmp_path / "plan.yaml", tmp_path / "out.parquet", tmp_path / "page.html"
    grid = f"{{a: {{grid: {{task.speed: {{value: [{speeds}]}}}}}}}}"
    plan.write_text(f"base: {{task: {task_file}}}\nblocks: {grid}", encoding="utf-8")
    words, lost = ["run", str(plan), "--output", str(output), "--workers", "1"], not speeds.startswith("0")
    for more, said in ((["--report", str(page)], "3 of 3 runs"), (["--resume"], "is complete, 3 runs")):
        assert run("rx90 sweep", [*words, *more]) == (3 if lost else 0)
        out, err = capsys.readouterr()
        if lost:
            (line,) = (one for one in err.splitlines() if one.startswith("rx90 sweep: "))
            assert line.startswith("rx90 sweep: each of the 2 runs failed, for example: LineError: ")
            assert line.endswith(f"; rx90 sweep info {output} says more")
        else:
            assert said in out
            assert (f"1 failed (rx90 sweep info {output} says why)" in out) == ("--report" in more)
    assert page.exists() != lost
    assert run("rx90 sweep", ["info", str(output)]) == 0
    shown = capsys.readouterr().out
    assert ("2 runs failed (LineError 2)" if lost else "1 run failed (LineError 1)") in shown
    assert "path_error_worst" in shown
