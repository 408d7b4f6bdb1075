"""Datagrams that get lost between the nodes are sent again: the run is late, and the same to the last bit."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
from pathlib import Path

import pytest
from line_run import run_both_ways
from processes import Processes
from ros_client import Client

from rx90_common.bags.comparison import Verdict
from rx90_common.bags.tables import comparison_text
from rx90_emulator.loop.setup import Setup

SHARE = 0.01
LEAST_LOST = 20


@pytest.fixture(scope="module")
def lossy_udp(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a library that, preloaded into a process, lets datagrams disappear."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        missing = "the datagrams are dropped by a library in C, and there is no compiler; apt-get install gcc libc6-dev"
        if os.environ.get("RIG_FIRMWARE_REQUIRED"):
            pytest.fail(missing)
        pytest.skip(missing)
    library = tmp_path_factory.mktemp("lossy") / "lossy_udp.so"
    source = Path(__file__).with_name("lossy_udp.c")
    command = [compiler, "-std=c11", "-Wall", "-Werror", "-O2", "-fPIC", "-shared", str(source), "-ldl"]
    subprocess.run([*command, "-o", str(library)], check=True)
    return library


@pytest.mark.ros
def test_lost_datagrams_cost_time_and_nothing_else(
    lossy_udp: Path, processes: Processes, client: Client, shipped: Setup, tmp_path: Path
) -> None:
    """With 1 % of what both nodes send lost, every recorded number equals the closed loop without ROS."""
    counts = tmp_path / "counts"
    counts.write_bytes(bytes(16))
    around = (
        "/usr/bin/env",
        f"LD_PRELOAD={lossy_udp}",
        f"LOSSY_SHARE={SHARE}",
        "LOSSY_SEED=1",
        f"LOSSY_COUNTS={counts}",
    )
    comparison = run_both_ways(processes, client, shipped, tmp_path, around=around)
    sent, lost = struct.unpack("QQ", counts.read_bytes())
    print(f"{lost} of {sent} datagrams lost")
    assert lost > LEAST_LOST
    assert lost / sent == pytest.approx(SHARE, rel=0.5)
    assert comparison.verdict is Verdict.SAME, comparison_text(comparison)
