"""Errors of the libraries that read files, as one kind."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.errors import BagError, Rx90Error
from rx90_common.base.quoting import plain

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""With which no CDR message begins."""


class DamagedError(BagError):
    """A file contradicts itself; the text names the place, and who opened the file prefixes its name."""

    def __str__(self) -> str:
        return f"is damaged: {super().__str__()}"


@contextmanager
def library_errors() -> Iterator[None]:
    """Make one BagError of whatever a library raises for a file that it cannot read."""
    try:
        yield
    except Rx90Error:
        raise
    except Exception as error:  # the libraries have no common error
        if isinstance(error, OSError) and error.strerror:
            raise BagError(f"cannot be read ({error.strerror})") from error
        text = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")
        raise DamagedError(plain(text, 300)) from error


def load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an NPZ file.

    Raises:
        DamagedError: if it is none.
    """
    with (
        library_errors(),
        np.errstate(invalid="ignore"),
        np.load(path, allow_pickle=False) as content,
    ):
        return {name: values for name, values in content.items() if isinstance(values, np.ndarray)}
