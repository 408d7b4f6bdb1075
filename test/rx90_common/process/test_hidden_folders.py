"""Hidden folders beside what is being made: gone with their block, and swept where their process was killed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from rx90_common.process.files import hidden_folder, write_text

_HOLDS = """
import sys
from pathlib import Path
from rx90_common.process.files import hidden_folder
with hidden_folder(Path(sys.argv[1])) as folder:
    (folder / "half").write_text("made")
    print(folder, flush=True)
    sys.stdin.read()
"""


def test_what_a_killed_process_left_is_swept_and_what_a_running_one_makes_is_not(tmp_path: Path) -> None:
    """The next start beside it takes the folder of a process that is gone, by kill -9 too, and no other."""
    target, other = tmp_path / "table.csv", tmp_path / "other"
    with subprocess.Popen(
        [sys.executable, "-c", _HOLDS, str(target)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        try:
            assert holder.stdout is not None
            left = Path(holder.stdout.readline().strip())
            mine = tmp_path / ".table.csv.rx90-notes"  # a user's, whose name is another one
            mine.mkdir()
            with hidden_folder(other) as beside:
                assert (left / "half").read_text() == "made"
                write_text(target, "new")
                assert beside.is_dir()
        finally:
            holder.kill()
    assert left.is_dir()
    write_text(other, "next")
    assert sorted(path.name for path in tmp_path.iterdir()) == [mine.name, "other", "table.csv"]
