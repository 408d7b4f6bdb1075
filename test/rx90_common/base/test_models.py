"""The models of files: each kind of refusal is one line with place, value and what is accepted."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest
from pydantic import Field, ValidationError, model_validator

from rx90_common.base.errors import ConfigError
from rx90_common.base.models import FileModel, Row, fault_lines, quantity, read_model, refusal


class Slip(FileModel):
    kind: Literal["slip"]
    share: Annotated[Row, Field(min_length=1, max_length=2)]


class Plastic(FileModel):
    kind: Literal["plastic"]
    break_away: Annotated[float, quantity("1", "Break-away.", ge=0.0, le=0.9)]


class Bristle(FileModel):
    stiffness: Annotated[float, quantity("Nm/rad", "Stiffness.", gt=0.0)]
    damping: Annotated[float, quantity("Nm s/rad", "Damping.", ge=0.0)] = 0.5
    kind: Annotated[Slip | Plastic, Field(discriminator="kind")] | None = None

    @model_validator(mode="after")
    def _check_damping(self) -> Bristle:
        if self.damping > self.stiffness:
            raise refusal("damping", self.damping, "up to the stiffness")
        return self


FAULTS: list[tuple[dict[str, Any], list[str]]] = [
    ({}, ["stiffness is missing; accepted: a number > 0"]),
    ({"stiffness": float("nan")}, ["stiffness is nan; accepted: a finite number > 0"]),
    ({"stifness": 3}, ["stifness is not a known key (did you mean stiffness?); accepted: stiffness, damping, kind"]),
    ({"stiffness": 1, "damping": 2}, ["damping is 2.0; accepted: up to the stiffness"]),
    ({"stiffness": 1, "kind": {"share": [1]}}, ["kind.kind is missing; accepted: one of plastic, slip"]),
    ({"stiffness": 1, "kind": {"kind": "soft"}}, ["kind.kind is 'soft'; accepted: one of plastic, slip"]),
    (
        {"stiffness": -1, "kind": {"kind": "slip", "share": [1, 2, 3]}},
        ["stiffness is -1; accepted: a number > 0", "kind.share is [1, 2, 3]; accepted: a list of 1 to 2 numbers"],
    ),
]


@pytest.mark.parametrize(("content", "lines"), FAULTS)
def test_each_fault_is_one_line(content: dict[str, Any], lines: list[str]) -> None:
    """All faults of a file are told, in lines that begin with the place."""
    with pytest.raises(ValidationError) as caught:
        Bristle.model_validate(content)
    assert fault_lines(Bristle, caught.value, "", content) == lines
    assert len(fault_lines(Bristle, caught.value, "")) == len(lines)  # of values that are not at hand


def test_a_file_gives_its_values_and_its_provenance(tmp_path) -> None:
    """Values are checked, remarks kept, and a changed value is checked like one of a file."""
    path = tmp_path / "bristle.yaml"
    path.write_text("stiffness: 3\nprovenance: {stiffness: assumed}\nsource: a book\n", encoding="utf-8")
    bristle = read_model(Bristle, path)
    assert bristle.stiffness == 3.0
    assert bristle.provenance == {"stiffness": "assumed"}
    with pytest.raises(ConfigError, match=r"stiffness is -1\.0; accepted: a number > 0"):
        bristle.replaced(stiffness=-1.0)
