"""What every file must do that is not what it should be."""

from collections.abc import Callable
from pathlib import Path

import pytest

from rx90_common.base.errors import ConfigError


def refusal_by(load: Callable[[Path], object], path: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load(path)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    assert "accepted: " in text
    return text
