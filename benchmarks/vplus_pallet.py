"""Measure how many times faster than real time a program of V+ runs on the engine: twelve parts onto a pallet.

    python -m benchmarks.vplus_pallet

Each part is picked and placed by six lines and joint motions, with hand and approach; the time is that of the
processor, of the second run: the first one imports and compiles.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from benchmarks.report import merge
from rx90_emulator.loop.setup import Setup
from rx90_emulator.vplus.program import load_programs
from rx90_emulator.vplus.run import run_program

PALLET = """\
.PROGRAM pallet()
  SET pick = TRANS(550,-200,-250,0,180)
  SPEED 60 ALWAYS
  MOVE #PPOINT(0,-90,180,0,90,0)
  FOR i = 0 TO 2
    FOR j = 0 TO 3
      SET place = SHIFT(TRANS(450,200,-250,0,180) BY i*40,j*40,0)
      APPRO pick, 80
      MOVES pick
      CLOSEI
      DEPARTS 80
      APPRO place, 80
      MOVES place
      OPENI
      DEPARTS 80
    END
  END
.END
"""
MOTIONS = 73


def main() -> int:
    """Print the ratio and merge it; return 1 if not every part is placed."""
    setup = Setup.load()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "pallet.v2"
        file.write_text(PALLET, encoding="latin-1")
        memory = load_programs(file)
    run_program(setup, memory)
    began = time.process_time()
    run = run_program(setup, memory)
    ratio = run.cell.time / (time.process_time() - began)
    if run.error is not None or len(run.motions) != MOTIONS:
        print(f"the program did not place every part: {run.error}")
        return 1
    print(f"{run.cell.time:.1f} s of simulated time, {ratio:.1f} x real time")
    merge({"vplus_pallet_times_real_time": ratio})
    return 0


if __name__ == "__main__":
    sys.exit(main())
