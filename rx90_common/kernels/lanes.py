"""Lanes: several numbers in parallel, in a formula that is written as if for one.

The links of the arm go through the same formulas, and so do the friction elements. A value of n lanes is a vector
in the processor's registers, so each operation works on all of them at once. Loops over arrays would leave it to the
compiler whether that happens. docs/explanation/kernels.md explains how it works and how to write a kernel.

Every operation rounds each lane by itself, by IEEE 754, in the order in which it is written. Results do not
depend on the processor, on alignment or on where a kernel is inlined. `fma` is a product and a sum rounded
once; the compiler never inserts one.

All functions take floats as well, so that a formula can also serve a single element.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeAlias, TypeVar, cast

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

from rx90_common.base.arrays import Array

_DOUBLE = ir.DoubleType()
_INDEX = ir.IntType(32)
_Some = TypeVar("_Some")
_Function = TypeVar("_Function", bound=Callable[..., Any])


class LaneMask:
    """What a comparison of several lanes gives; a type for annotations, without values outside compiled code."""


Mask: TypeAlias = bool | LaneMask
"""What a comparison gives. `select` and `any_lane` take it, arithmetic does not."""


class Lanes(Protocol):
    """A float or several lanes; a type for annotations: outside compiled code only floats have it.

    Arithmetic combines lanes with lanes of the same number or with floats. An array has to be loaded first.
    """

    def __add__(self: _Some, other: _Some | float, /) -> _Some: ...
    def __radd__(self: _Some, other: float, /) -> _Some: ...
    def __sub__(self: _Some, other: _Some | float, /) -> _Some: ...
    def __rsub__(self: _Some, other: float, /) -> _Some: ...
    def __mul__(self: _Some, other: _Some | float, /) -> _Some: ...
    def __rmul__(self: _Some, other: float, /) -> _Some: ...
    def __truediv__(self: _Some, other: _Some | float, /) -> _Some: ...
    def __rtruediv__(self: _Some, other: float, /) -> _Some: ...
    def __neg__(self: _Some) -> _Some: ...
    def __lt__(self: _Some, other: _Some | float, /) -> Mask: ...
    def __le__(self: _Some, other: _Some | float, /) -> Mask: ...
    def __gt__(self: _Some, other: _Some | float, /) -> Mask: ...
    def __ge__(self: _Some, other: _Some | float, /) -> Mask: ...


Number = TypeVar("Number", float, Lanes)
"""For a function that gives a float for floats and lanes for lanes."""


class LanesType(types.Type):
    """Type of `width` floats, or of `width` truth values.

    Processors have registers of whole multiples of four floats, so the vector is `padded` to one. The content of
    lanes beyond `width` has no meaning and reaches neither memory nor a result.
    """

    def __init__(self, width: int, *, is_mask: bool = False) -> None:
        self.width = width
        self.is_mask = is_mask
        self.padded = -(-width // 4) * 4
        super().__init__(name=f"{'Mask' if is_mask else 'Lanes'}({width})")


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: LanesType) -> None:
        element = ir.IntType(1) if kind.is_mask else _DOUBLE
        super().__init__(manager, kind, ir.VectorType(element, kind.padded))


class Operation(Generic[_Function]):
    """An operation of compiled code; `Operation[F].of` decorates its definition, and kernels call it as an F.

    The definition takes numba's typing context and the types of the operands. It returns a signature and a function
    that emits LLVM instructions, or None, which numba refuses.
    """

    @classmethod
    def of(cls, definition: Callable[..., Any]) -> _Function:
        """Return the operation of a definition."""
        return cast(_Function, intrinsic(prefer_literal=True)(definition))


def _is_float_lanes(kind: Any) -> bool:
    return isinstance(kind, LanesType) and not kind.is_mask


def _common(*kinds: Any) -> Any:
    """Return the common type of lanes and numbers; None, which numba refuses, if they do not fit."""
    lanes = {kind for kind in kinds if isinstance(kind, LanesType)}
    numbers = all(_is_float_lanes(kind) or isinstance(kind, types.Number) for kind in kinds)
    if not numbers or len(lanes) > 1:
        return None
    return lanes.pop() if lanes else types.float64


def _spread(context: Any, builder: Any, value: Any, kind: Any, to: Any) -> Any:
    """Return `value` of type `kind` as the float or the lanes `to`, a number copied to each lane."""
    if isinstance(kind, LanesType):
        return value
    number = context.cast(builder, value, kind, types.float64)
    if not isinstance(to, LanesType):
        return number
    single = builder.insert_element(_undefined(to.padded), number, _INDEX(0))
    return _shuffle(builder, single, single, [0] * to.padded)


def _undefined(count: int) -> Any:
    return ir.Constant(ir.VectorType(_DOUBLE, count), ir.Undefined)


def _shuffle(builder: Any, a: Any, b: Any, order: list[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_INDEX, len(order)), order))


def _binary(symbol: Any, emit: Callable[[Any, Any, Any], Any], *, compares: bool = False) -> None:
    """Give an operator of Python its meaning for two lanes, or lanes and a number."""

    @type_callable(symbol)
    def type_operator(_: Any) -> Any:
        def result(a: Any, b: Any) -> Any:
            kind = _common(a, b)
            if not isinstance(kind, LanesType):
                return None
            return LanesType(kind.width, is_mask=True) if compares else kind

        return result

    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        to = _common(*signature.args)
        a, b = (
            _spread(context, builder, x, kind, to)
            for x, kind in zip(arguments, signature.args, strict=True)
        )
        return emit(builder, a, b)

    for kinds in ((LanesType, LanesType), (LanesType, types.Number), (types.Number, LanesType)):
        lower_builtin(symbol, *kinds)(lower)


_binary(operator.add, lambda builder, a, b: builder.fadd(a, b))
_binary(operator.sub, lambda builder, a, b: builder.fsub(a, b))
_binary(operator.mul, lambda builder, a, b: builder.fmul(a, b))
_binary(operator.truediv, lambda builder, a, b: builder.fdiv(a, b))
_binary(operator.eq, lambda builder, a, b: builder.fcmp_ordered("==", a, b), compares=True)
_binary(operator.lt, lambda builder, a, b: builder.fcmp_ordered("<", a, b), compares=True)
_binary(operator.le, lambda builder, a, b: builder.fcmp_ordered("<=", a, b), compares=True)
_binary(operator.gt, lambda builder, a, b: builder.fcmp_ordered(">", a, b), compares=True)
_binary(operator.ge, lambda builder, a, b: builder.fcmp_ordered(">=", a, b), compares=True)


@type_callable(operator.neg)
def _type_negation(_: Any) -> Any:
    return lambda kind: kind if _is_float_lanes(kind) else None


@lower_builtin(operator.neg, LanesType)  # type: ignore[untyped-decorator]
def _negation(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
    return builder.fneg(arguments[0])


def _call(builder: Any, name: str, *operands: Any) -> Any:
    """Call an instruction of LLVM that exists for one float and for several."""
    kind = operands[0].type
    suffix = f"v{kind.count}f64" if isinstance(kind, ir.VectorType) else "f64"
    declared = ir.FunctionType(kind, [kind] * len(operands))
    function = cgutils.get_or_insert_function(builder.module, declared, f"llvm.{name}.{suffix}")
    return builder.call(function, operands)


def _pieces(width: int) -> list[tuple[int, int]]:
    """Return (offset, size) of the power-of-two pieces in which `width` numbers are read and written."""
    pieces = []
    offset = 0
    for size in (4, 2, 1):
        while width - offset >= size:
            pieces.append((offset, size))
            offset += size
    return pieces


def _place(context: Any, builder: Any, array: Any, kind: Any, offset: int, size: int) -> Any:
    """Return the address of `size` numbers from `offset` on in an array, as that of one number or of a vector."""
    start = context.make_array(kind)(context, builder, array).data
    number = builder.gep(start, [_INDEX(offset)])
    if size == 1:
        return number
    return builder.bitcast(number, ir.VectorType(_DOUBLE, size).as_pointer())


def _check_contiguous(array: Any) -> None:
    if not (isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"):
        raise TypingError(f"lanes lie in {array}; accepted: a contiguous array of one dimension")
    if array.dtype != types.float64:
        raise TypingError(f"lanes hold {array.dtype}; accepted: float64")


@Operation[Callable[[Array | Lanes], int]].of
def size(_: Any, values: Any) -> Any:
    """Return, as a literal, how many lanes there are, or how long the rows are of an array that lies in a record."""
    if isinstance(values, LanesType):
        count = values.width
    elif isinstance(values, types.NestedArray):
        count = values.shape[-1]
    else:
        return None
    return types.IntegerLiteral(count)(values), lambda *_: ir.Constant(ir.IntType(64), count)


@Operation[Callable[[Array, int], Lanes]].of
def load(_: Any, array: Any, width: Any) -> Any:
    """Return the first `width` numbers of a contiguous array; `width` is a literal."""
    if not isinstance(width, types.IntegerLiteral):
        return None
    _check_contiguous(array)
    kind = LanesType(width.literal_value)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        total = _undefined(kind.padded)
        for offset, size in _pieces(kind.width):
            place = _place(context, builder, arguments[0], signature.args[0], offset, size)
            piece = builder.load(place, align=8)
            # no vector of one: LLVM 20's optimiser fails an assertion of its own with them
            if size == 1:
                total = builder.insert_element(total, piece, _INDEX(offset))
                continue
            spread = _shuffle(builder, piece, piece, [min(i, size - 1) for i in range(kind.padded)])
            inside = range(offset, offset + size)
            order = [kind.padded + i - offset if i in inside else i for i in range(kind.padded)]
            total = _shuffle(builder, total, spread, order)
        return total

    return kind(array, width), emit


@Operation[Callable[[Array, Lanes], None]].of
def store(_: Any, array: Any, value: Any) -> Any:
    """Write lanes to the beginning of a contiguous array."""
    _check_contiguous(array)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        for offset, size in _pieces(value.width):
            place = _place(context, builder, arguments[0], signature.args[0], offset, size)
            if size == 1:
                piece = builder.extract_element(arguments[1], _INDEX(offset))
            else:
                piece = _shuffle(
                    builder, arguments[1], arguments[1], list(range(offset, offset + size))
                )
            builder.store(piece, place, align=8)
        return context.get_dummy_value()

    return types.void(array, value), emit


@Operation[Callable[[Lanes, int], float]].of
def lane(_: Any, x: Any, index: Any) -> Any:
    """Return one lane as a float."""

    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.extract_element(*arguments) if isinstance(x, LanesType) else arguments[0]

    return types.float64(x, index), emit


@Operation[Callable[[Lanes, int], Lanes]].of
def first(_: Any, x: Any, width: Any) -> Any:
    """Return the first `width` lanes, or all where there are no more; `width` is a literal."""
    if not isinstance(width, types.IntegerLiteral):
        return None
    kind = LanesType(min(width.literal_value, x.width))

    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return _shuffle(builder, arguments[0], arguments[0], list(range(kind.padded)))

    return kind(x, width), emit


@Operation[Callable[[Lanes, float], Lanes]].of
def append(_: Any, x: Any, value: Any) -> Any:
    """Return the lanes of `x` and one more that holds `value`."""
    kind = LanesType(x.width + 1)

    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        order = [min(i, x.padded - 1) for i in range(kind.padded)]
        widened = _shuffle(builder, arguments[0], arguments[0], order)
        return builder.insert_element(widened, arguments[1], _INDEX(x.width))

    return kind(x, value), emit


@Operation[Callable[[Lanes, float], Lanes]].of
def delay(_: Any, x: Any, value: Any) -> Any:
    """Return (value, x0, x1, ...): each lane moved one up, the last one dropped."""

    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        moved = _shuffle(builder, arguments[0], arguments[0], [0, *range(x.padded - 1)])
        return builder.insert_element(moved, arguments[1], _INDEX(0))

    return x(x, value), emit


@Operation[Callable[[Lanes], Lanes]].of
def prefix_sum(_: Any, x: Any) -> Any:
    """Return (x0, x0 + x1, ...), summed in pairs of growing distance."""
    return x(x), _scan(x, -1)


@Operation[Callable[[Lanes], Lanes]].of
def suffix_sum(_: Any, x: Any) -> Any:
    """Return (..., x(n-2) + x(n-1), x(n-1)), summed in pairs of growing distance."""
    return x(x), _scan(x, +1)


def _scan(kind: LanesType, direction: int) -> Callable[..., Any]:
    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        (total,) = arguments
        zeros = ir.Constant(total.type, [0.0] * kind.padded)
        distance = 1
        while distance < kind.width:
            sources = [i + direction * distance for i in range(kind.padded)]
            order = [i if 0 <= i < kind.width else kind.padded for i in sources]
            total = builder.fadd(total, _shuffle(builder, total, zeros, order))
            distance *= 2
        return total

    return emit


@Operation[Callable[[Mask, Number, Number], Number]].of
def select(_: Any, mask: Any, a: Any, b: Any) -> Any:
    """Return, lane by lane, a where the mask is true and b elsewhere."""
    common = _common(a, b)
    result = LanesType(mask.width) if isinstance(mask, LanesType) else common

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        choices = zip(arguments[1:], signature.args[1:], strict=True)
        yes, no = (_spread(context, builder, value, kind, result) for value, kind in choices)
        return builder.select(arguments[0], yes, no)

    return None if common is None else (result(mask, a, b), emit)


@Operation[Callable[[Mask], bool]].of
def any_lane(_: Any, mask: Any) -> Any:
    """Return whether the mask is true anywhere."""

    def emit(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        if not isinstance(mask, LanesType):
            return arguments[0]
        bits = builder.bitcast(arguments[0], ir.IntType(mask.padded))
        return builder.icmp_unsigned(
            "!=", builder.and_(bits, bits.type(2**mask.width - 1)), bits.type(0)
        )

    return types.boolean(mask), emit


@Operation[Callable[[Number], Number]].of
def absolute(_: Any, x: Any) -> Any:
    """Return |x|."""
    return x(x), lambda _context, builder, _signature, arguments: _call(builder, "fabs", *arguments)


@Operation[Callable[[Number, Number, Number], Number]].of
def fma(_: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once."""
    result = _common(a, b, c)

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        operands = zip(arguments, signature.args, strict=True)
        return _call(
            builder, "fma", *(_spread(context, builder, x, kind, result) for x, kind in operands)
        )

    return None if result is None else (result(a, b, c), emit)
