"""Options that count only together with others, in all commands."""

from __future__ import annotations

from pathlib import Path

import pytest

from rx90_emulator.cli.frame import run

CASES = [
    ("rx90_run", "--decimation 5", "--decimation without --output; accepted: with it"),
    ("rx90_run", "--storage mcap --arrays run.npz", "--storage without --output; accepted: with it"),
    ("rx90_run", "--temperature-rate 10", "--temperature-rate without --output or --arrays; accepted: with one"),
    ("rx90_run", "--temperature-rate 10 --from-bag bag --output again", "--temperature-rate with --from-bag; accepted"),
    ("rx90_run", "--temperature-rate 3 --output bag", "temperature_rate is 3 Hz; accepted: a rate that divides 4000"),
    ("rx90_run", "--hours 8 --temperature-rate 1", "--temperature-rate with --hours; accepted: --task and --plot"),
    ("rx90_line", "--reference --approach-speed 0.1", "--approach-speed without --approach; accepted: with it"),
    ("rx90_bag", "plot bag --align start", "--align start with one bag; accepted: with two"),
    ("rx90_bag", "export bag -o t.npz --format csv", "--format csv with the file t.npz; accepted: with a folder"),
    ("rx90_experiment", "run --nodes --output new --storage mcap", "--storage without --engine; accepted: with it"),
    ("rx90_experiment", "run --engine --output new --timeout 9", "--timeout without --nodes; accepted: with it"),
    (
        "rx90_identify",
        "--sliding bag --output new.yaml --total-torque-tolerance 0.2",
        "--total-torque-tolerance 0.2 without excitation runs; accepted: with --excitation BAG ...",
    ),
    (
        "rx90_identify",
        "--excitation bag --output new --tip-tolerance 0.001",
        "--tip-tolerance 0.001 with excitation runs; accepted: --torque-tolerance and --total-torque-tolerance",
    ),
    ("friction_ramp", "--port /dev/rig --seed 0", "--seed with --port /dev/rig; accepted: with the emulated rig alone"),
    ("friction_ramp", "--port /dev/rig --real-time", "--real-time with --port /dev/rig; accepted: with the emulated"),
    ("friction_ramp", "--baud 9600", "--baud 9600 with the emulated rig; accepted: with --port of a serial line"),
    ("friction_ramp", "--no-load-file 0.1:old.csv --repeats 2", "--repeats with old data; accepted: with a rig"),
    ("friction_ramp", "--loaded-file 0.1:old.csv --load joint", "--load with old data; accepted: with a rig"),
    ("friction_presliding", "--baud 9600", "--baud 9600 with the emulated rig; accepted: with --port of a serial line"),
    ("friction_presliding", "--kinds drift --blocks 9", "--blocks 9 without loops; accepted: with --kinds loops, or"),
    ("friction_presliding", "--kinds loops --cycles 900", "--cycles 900 without drift; accepted: with --kinds drift"),
]  # fmt: skip


@pytest.mark.parametrize(("command", "words", "said"), CASES)
def test_an_option_that_would_have_no_effect_is_refused(
    command: str,
    words: str,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One line names the option and what it counts with; nothing is read or written before."""
    monkeypatch.chdir(tmp_path)
    assert run(command, words.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    assert line.startswith(f"{command}: {said}")
    assert not list(tmp_path.iterdir())
