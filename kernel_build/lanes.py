"""Machine code for ``msal_cli.kernels.lanes``: a type of numba's, whose values LLVM has."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing.templates import ConcreteTemplate, infer_global
from numba.core.typing.templates import signature as typed
from numba.extending import intrinsic, lower_builtin, models, register_model

from msal_cli.kernels import lanes as plain

_COUNT = int(plain.LANES)
_SINGLE, _DOUBLE = ir.FloatType(), ir.DoubleType()
_VECTOR = ir.VectorType(_SINGLE, _COUNT)
_LONG, _INT = ir.IntType(64), ir.IntType(32)


class Lanes(types.Type):
    """The type of eight numbers."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")


LANES = Lanes()


@register_model(Lanes)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, of: Any) -> None:
        super().__init__(manager, of, _VECTOR)


def _register_operator(of: Any, instruction: str) -> None:
    @infer_global(of)
    class _Template(ConcreteTemplate):
        cases = [typed(LANES, LANES, LANES)]  # noqa: RUF012

    @lower_builtin(of, LANES, LANES)
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return getattr(builder, instruction)(*args)


for _operator, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _register_operator(_operator, _instruction)


def _data(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """The pointer to the items of an array."""
    return context.make_array(kind)(context, builder, value).data


def _constant(numbers: list[int]) -> Any:
    return ir.Constant(ir.VectorType(_INT, len(numbers)), numbers)


def _fill(builder: Any, number: Any, kind: Any) -> Any:
    """A vector with the same number in all places."""
    none = ir.Constant(kind, ir.Undefined)
    first = builder.insert_element(none, number, ir.Constant(_INT, 0))
    return builder.shuffle_vector(first, none, _constant([0] * kind.count))


def _load(builder: Any, pointer: Any, kind: Any) -> Any:
    """A vector from where a number is, which need not be aligned."""
    return builder.load(builder.bitcast(pointer, kind.as_pointer()), align=4)


def _transpose(builder: Any, parts: list[Any]) -> list[Any]:
    """Four lanes of eight vectors of four."""
    ends = _constant(list(range(8)))
    a, b, c, d = (builder.shuffle_vector(parts[k], parts[k + 4], ends) for k in range(4))
    low, high = _constant([0, 8, 1, 9, 4, 12, 5, 13]), _constant([2, 10, 3, 11, 6, 14, 7, 15])
    pairs = [builder.shuffle_vector(*two, mask) for two in ((a, b), (c, d)) for mask in (low, high)]
    first, second = _constant([0, 1, 8, 9, 4, 5, 12, 13]), _constant([2, 3, 10, 11, 6, 7, 14, 15])
    return [
        builder.shuffle_vector(pairs[k], pairs[k + 2], mask)
        for k in (0, 1)
        for mask in (first, second)
    ]


@intrinsic
def _fill_lanes(typing_context, value):
    def lower(context, builder, sig, args):
        number = context.cast(builder, args[0], sig.args[0], types.float32)
        return _fill(builder, number, _VECTOR)

    return LANES(value), lower


@intrinsic
def _load_lanes(typing_context, array, at):
    def lower(context, builder, sig, args):
        data = _data(context, builder, sig.args[0], args[0])
        return _load(builder, builder.gep(data, [args[1]]), _VECTOR)

    return LANES(array, types.uint64), lower


@intrinsic
def _store_lanes(typing_context, array, at, lanes):
    def lower(context, builder, sig, args):
        data = _data(context, builder, sig.args[0], args[0])
        pointer = builder.bitcast(builder.gep(data, [args[1]]), _VECTOR.as_pointer())
        builder.store(args[2], pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.uint64, LANES), lower


@intrinsic
def _load_rows(typing_context, numbers, at):
    def lower(context, builder, sig, args):
        data = _data(context, builder, sig.args[0], args[0])
        rows = []
        for lane in range(_COUNT):
            place = builder.add(args[1], ir.Constant(_LONG, lane))
            rows.append(builder.zext(builder.load(builder.gep(data, [place])), _LONG))
        return context.make_tuple(builder, sig.return_type, rows)

    return types.UniTuple(types.uint64, _COUNT)(numbers, types.uint64), lower


@intrinsic
def _load_columns(typing_context, array, rows, width, offset):
    kind = ir.VectorType(_SINGLE, 4)

    def lower(context, builder, sig, args):
        data = _data(context, builder, sig.args[0], args[0])
        parts = []
        for row in cgutils.unpack_tuple(builder, args[1], _COUNT):
            place = builder.add(builder.mul(row, args[2]), args[3])
            parts.append(_load(builder, builder.gep(data, [place]), kind))
        return context.make_tuple(builder, sig.return_type, _transpose(builder, parts))

    return types.UniTuple(LANES, 4)(array, rows, types.uint64, types.uint64), lower


@intrinsic
def _load_offsets(typing_context, points, rows, others, scales):
    four, three = ir.VectorType(_DOUBLE, 4), ir.Constant(_LONG, 3)

    def lower(context, builder, sig, args):
        data, factors = (_data(context, builder, sig.args[k], args[k]) for k in (0, 3))
        parts = []
        ends = (cgutils.unpack_tuple(builder, rows, _COUNT) for rows in args[1:3])
        for lane, pair in enumerate(zip(*ends, strict=True)):
            own, other = (
                _load(builder, builder.gep(data, [builder.mul(row, three)]), four) for row in pair
            )
            factor = builder.load(builder.gep(factors, [ir.Constant(_LONG, lane)]))
            offset = builder.fmul(builder.fsub(other, own), _fill(builder, factor, four))
            parts.append(builder.fptrunc(offset, ir.VectorType(_SINGLE, 4)))
        return context.make_tuple(builder, sig.return_type, _transpose(builder, parts)[:3])

    return types.UniTuple(LANES, 3)(points, rows, others, scales), lower


@intrinsic
def _choose_greater(typing_context, a, b, yes, no):
    def lower(context, builder, sig, args):
        return builder.select(builder.fcmp_ordered(">", args[0], args[1]), args[2], args[3])

    return LANES(LANES, LANES, LANES, LANES), lower


@intrinsic
def _has_greater(typing_context, a, b):
    def lower(context, builder, sig, args):
        mask = builder.bitcast(builder.fcmp_ordered(">", args[0], args[1]), ir.IntType(_COUNT))
        return builder.icmp_unsigned("!=", mask, ir.Constant(ir.IntType(_COUNT), 0))

    return types.boolean(LANES, LANES), lower


@intrinsic
def _root(typing_context, lanes):
    def lower(context, builder, sig, args):
        kind = ir.FunctionType(_VECTOR, [_VECTOR])
        name = f"llvm.sqrt.v{_COUNT}f32"
        return builder.call(builder.module.declare_intrinsic(name, (), kind), args)

    return LANES(LANES), lower


COMPILED: dict[Callable[..., Any], Any] = {
    plain.fill_lanes: _fill_lanes,
    plain.load_lanes: _load_lanes,
    plain.store_lanes: _store_lanes,
    plain.load_rows: _load_rows,
    plain.load_columns: _load_columns,
    plain.load_offsets: _load_offsets,
    plain.choose_greater: _choose_greater,
    plain.has_greater: _has_greater,
    plain.root: _root,
}
"""The machine code of each function of ``msal_cli.kernels.lanes``."""
