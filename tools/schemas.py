"""Write config/schemas/: a JSON schema for each kind of YAML file, from the tables that the readers check with.

python -m tools.schemas
"""

from __future__ import annotations

import json
from pathlib import Path

from rx90_emulator.configuration.check import KINDS

FOLDER = Path(__file__).resolve().parent.parent / "config" / "schemas"


def texts() -> dict[str, str]:
    """Return the text of each file by its name."""
    return {
        f"{kind.name}.json": json.dumps(
            kind.json_schema(), indent=1, ensure_ascii=False, allow_nan=False
        )
        + "\n"
        for kind in KINDS
    }


def main() -> None:
    """Write the files, and remove those of kinds that there are no more."""
    wanted = texts()
    FOLDER.mkdir(exist_ok=True)
    for path in FOLDER.glob("*.json"):
        if path.name not in wanted:
            path.unlink()
    for name, text in wanted.items():
        (FOLDER / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
