"""`rx90_run` refuses what it cannot do before it runs anything."""

from __future__ import annotations

from pathlib import Path

import pytest

from rx90_loop import run_command


def test_what_cannot_be_written_is_refused_before_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A decimation of 0, a start without end and a bag that exists are one line each, and nothing is simulated."""
    for words, complaint in (
        (["--decimation", "0"], "--decimation is 0; accepted: a whole number >= 1"),
        (["--start-time", "inf"], "start time is inf s; accepted: a finite number"),
        (["--output", str(tmp_path)], f"--output is {tmp_path}, which exists; accepted: a new folder"),
    ):
        assert run_command.main(words) == 1
        out, err = capsys.readouterr()
        assert out == ""
        assert err.splitlines()[-1] == f"rx90_run: {complaint}"
        assert "Traceback" not in err
