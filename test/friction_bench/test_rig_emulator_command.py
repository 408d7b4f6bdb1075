"""The command friction_rig_emulator and the pseudo-terminal that it serves."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from friction_bench.rig.emulated import EmulatedRig, PtyRig
from friction_bench.rig.rig_file import Rig
from rx90_emulator.cli.frame import run


def test_link_goes_with_the_rig_that_has_it(rig: Rig, tmp_path: Path) -> None:
    """A rig that ends takes its link away, but not one that another rig has taken over meanwhile."""
    link = tmp_path / "rig"
    first = PtyRig(EmulatedRig(rig, 1), link)
    second = PtyRig(EmulatedRig(rig, 2), link)
    first.close()
    assert str(link.readlink()) == second.path
    second.close()
    assert not link.is_symlink()


def test_link_is_gone_before_the_name_it_points_to_is_free(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody opens another program's pseudo-terminal by a link that is left: it goes before the descriptors do."""
    made = PtyRig(EmulatedRig(rig, 1), tmp_path / "rig")
    close, left = os.close, []

    def watched(descriptor: int) -> None:
        left.append((tmp_path / "rig").is_symlink())
        close(descriptor)

    monkeypatch.setattr(os, "close", watched)
    made.close()
    assert left == [False, False]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seed", "-1"], "--seed is -1; accepted: 0 to 2147483647"),
        (["--rig", "nothing.yaml"], "no file 'nothing.yaml'"),
        (["--link", "/dev/null"], "/dev/null: cannot point to the emulated rig"),
        (["--link", "/proc/rig"], "/proc/rig: cannot point to the emulated rig"),
    ],
)
def test_mistakes_get_one_line(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A user's mistake is answered by one line and exit code 2."""
    assert run("friction_rig_emulator", arguments) == 2
    error = capsys.readouterr().err.strip()
    assert error.startswith("friction_rig_emulator: ")
    assert message in error
    assert "\n" not in error
