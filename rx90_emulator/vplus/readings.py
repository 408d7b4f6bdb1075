"""How uncertain parts of V+ are read: every choice stands here, with the more likely reading as its default."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from rx90_common.base.models import Model

_FACTORS: Final = ("*", "/", "MOD", "AND", "BAND")
_TERMS: Final = ("+", "-", "OR", "BOR", "XOR", "BXOR")
RELATIONS: Final = ("==", "<>", "<", "<=", ">", ">=")
LOGIC: Final = ("AND", "OR", "XOR")


class Readings(Model):
    """The choices."""

    logic_before_relations: Annotated[
        bool,
        Field(
            description="AND binds as *, OR and XOR as +, all before comparisons; if not, comparisons before them all."
        ),
    ] = True
    drive_obeys_program_speed: Annotated[
        bool, Field(description="The program's SPEED scales DRIVE, too; if not, the monitor speed alone does.")
    ] = False
    base_moves_robot: Annotated[
        bool, Field(description="BASE says where the robot stands in the world; if not, where the world is seen from.")
    ] = True
    format_persists: Annotated[
        bool, Field(description="A format of TYPE holds for all items after it; if not, for the next one.")
    ] = True
    ignore_case: Annotated[bool, Field(description="Comparisons of strings ignore upper and lower case.")] = True
    step_time: Annotated[float, Field(gt=0.0, description="Time that the processor takes for a step, s.")] = 40e-6

    def levels(self) -> list[tuple[str, ...]]:
        """Return the binary operators, those first that bind most."""
        if self.logic_before_relations:
            return [_FACTORS, _TERMS, RELATIONS]
        arithmetic = [tuple(sign for sign in level if sign not in LOGIC) for level in (_FACTORS, _TERMS)]
        return [*arithmetic, RELATIONS, ("AND",), ("OR", "XOR")]
