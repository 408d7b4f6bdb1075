"""Skip tests whose packages are missing; fail them where CI says that nothing may be missing."""

import os
from typing import NoReturn

import pytest

from tools.packages import NEEDS, REQUIRED


def need(name: str) -> None:
    """Skip the test, or fail it where packages are required, if this row of tools/packages.py is not there."""
    required = NEEDS[name]
    if not required.is_there():
        give_up(f"{required.title} is missing; to get it: apt-get install {' '.join(required.packages)}")


def give_up(reason: str) -> NoReturn:
    if os.environ.get(REQUIRED):
        pytest.fail(reason)
    pytest.skip(reason)
