"""Names that somebody else takes while a bag or a file is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from rx90_common.bags.exporting.exporting import named_when_done
from rx90_common.bags.whole import named_at_the_end
from rx90_common.base.errors import BagError


def test_a_bag_that_came_first_stays(tmp_path: Path) -> None:
    """Of two writers of one bag the second is refused by the name, and leaves nothing."""
    bag = tmp_path / "run"

    def second() -> None:
        with named_at_the_end(bag) as place:
            place.mkdir()
            bag.mkdir()
            (bag / "metadata.yaml").write_text("of the first")

    with pytest.raises(BagError, match="run exists already, not overwriting"):
        second()
    assert list(tmp_path.rglob("*")) == [bag, bag / "metadata.yaml"]


@pytest.mark.parametrize("single", [True, False])
def test_an_export_that_came_first_stays(tmp_path: Path, single: bool) -> None:
    """Of two exports to one file or folder the second is refused by the name, and leaves nothing."""
    output = tmp_path / "export.csv"

    def second() -> None:
        with named_when_done(output, single=single) as folder:
            (folder / output.name).write_text("of the second")
            if single:
                output.write_text("of the first")
            else:
                output.mkdir()
                (output / "a.csv").write_text("of the first")

    with pytest.raises(BagError, match=r"export\.csv exists already, not overwriting"):
        second()
    assert all(file.is_dir() or file.read_text() == "of the first" for file in tmp_path.rglob("*"))
    assert len(list(tmp_path.iterdir())) == 1
