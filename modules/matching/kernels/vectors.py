"""Vectors of unsigned integers and of floats for kernels: loops that count on one instruction for many lanes get it.

The compiler's own vectorisation gives up where a loop touches more than a few arrays. These operations become vector
instructions of whatever processor the kernel is compiled for. A vector is loaded from a flat contiguous array, at any
index; nothing checks that the index lies inside.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

LANES = 32
FLOAT_LANES = 16
_operation: Any = intrinsic


class Vector(types.Type):
    """Type of `LANES` unsigned integers of so many bits each."""

    def __init__(self, bits: int) -> None:
        self.bits = bits
        super().__init__(name=f"Vector({LANES} x uint{bits})")


class Floats(types.Type):
    """Type of `FLOAT_LANES` numbers, float32."""

    def __init__(self) -> None:
        super().__init__(name=f"Floats({FLOAT_LANES})")


@register_model(Vector)
class VectorModel(models.PrimitiveModel):
    """A vector is a register."""

    def __init__(self, manager: Any, vector: Vector) -> None:
        super().__init__(manager, vector, _register(vector.bits))


@register_model(Floats)
class FloatsModel(models.PrimitiveModel):
    """A vector is a register."""

    def __init__(self, manager: Any, vector: Floats) -> None:
        super().__init__(manager, vector, FLOAT_REGISTER)


FLOAT_REGISTER = ir.VectorType(ir.FloatType(), FLOAT_LANES)


def _register(bits: int) -> Any:
    return ir.VectorType(ir.IntType(bits), LANES)


def _call(builder: Any, name: str, bits: int, arguments: list[Any], result: Any = None) -> Any:
    """Call the compiler's own function of that name for these arguments."""
    kind = ir.FunctionType(result or _register(bits), [argument.type for argument in arguments])
    function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}i{bits}")
    return builder.call(function, arguments)


def _spread(builder: Any, value: Any, kind: Any) -> Any:
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    nowhere = ir.Constant(ir.VectorType(ir.IntType(32), kind.count), [0] * kind.count)
    return builder.shuffle_vector(one, ir.Constant(kind, ir.Undefined), nowhere)


def _place(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    """Return the address of the vector at an index of a flat array."""
    data = context.make_array(array_type)(context, builder, array).data
    kind = FLOAT_REGISTER if array_type.dtype == types.float32 else _register(array_type.dtype.bitwidth)
    return builder.bitcast(builder.gep(data, [index]), kind.as_pointer())


def _flat(array: Any) -> bool:
    return isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"


def _of_two(name: str) -> Any:
    """Return an operation of two vectors of the same kind that the compiler knows by name."""

    def operation(typing_context: Any, a: Any, b: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return _call(builder, name, signature.return_type.bits, list(arguments))

        return a(a, b), generate

    return _operation(operation)


def _by_builder(integers: str, floats: str = "") -> Any:
    """Return an operation of two vectors of the same kind that is one instruction."""

    def operation(typing_context: Any, a: Any, b: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, floats if isinstance(a, Floats) else integers)(*arguments)

        return a(a, b), generate

    return _operation(operation)


smaller: Any = _of_two("umin")
larger: Any = _of_two("umax")
add_clipped: Any = _of_two("uadd.sat")
add: Any = _by_builder("add", "fadd")
subtract: Any = _by_builder("sub", "fsub")
multiply: Any = _by_builder("mul", "fmul")
either: Any = _by_builder("xor")
shift_left: Any = _by_builder("shl")


@_operation
def load(typing_context: Any, array: Any, index: Any) -> Any:
    """Load the vector that begins at an index of a flat array of uint8, uint16 or float32."""
    if not _flat(array):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_place(context, builder, signature.args[0], *arguments), align=1)

    kind = Floats() if array.dtype == types.float32 else Vector(array.dtype.bitwidth)
    return kind(array, types.intp), generate


@_operation
def store(typing_context: Any, array: Any, index: Any, vector: Any) -> Any:
    """Store a vector at an index of a flat array."""
    if not _flat(array):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, index, vector = arguments
        builder.store(vector, _place(context, builder, signature.args[0], array, index), align=1)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), generate


def _splat(bits: int) -> Any:
    def operation(typing_context: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return _spread(builder, arguments[0], _register(bits))

        return Vector(bits)(getattr(types, f"uint{bits}")), generate

    return _operation(operation)


bytes_of: Any = _splat(8)
words_of: Any = _splat(16)


@_operation
def floats_of(typing_context: Any, value: Any) -> Any:
    """Return a float32 in every lane."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _spread(builder, arguments[0], FLOAT_REGISTER)

    return Floats()(types.float32), generate


@_operation
def where_within(typing_context: Any, difference: Any, limit: Any, yes: Any) -> Any:
    """Return `yes` in the lanes where a difference is smaller than a limit, whatever its sign, else 0."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        difference, limit, yes = arguments
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(FLOAT_REGISTER, [FLOAT_REGISTER]), f"llvm.fabs.v{FLOAT_LANES}f32"
        )
        small = builder.fcmp_ordered("<", builder.call(function, [difference]), limit)
        return builder.select(small, yes, ir.Constant(FLOAT_REGISTER, [0.0] * FLOAT_LANES))

    return Floats()(difference, limit, yes), generate


@_operation
def least(typing_context: Any, vector: Any) -> Any:
    """Return the smallest lane."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = signature.args[0].bits
        return _call(builder, "vector.reduce.umin", bits, list(arguments), ir.IntType(bits))

    return getattr(types, f"uint{vector.bits}")(vector), generate


@_operation
def count_bits(typing_context: Any, vector: Any) -> Any:
    """Return how many bits are set, lane by lane."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _call(builder, "ctpop", signature.return_type.bits, list(arguments))

    return vector(vector), generate


@_operation
def mean(typing_context: Any, a: Any, b: Any) -> Any:
    """Return the mean of two vectors of bytes, halves rounded up."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        wide = [builder.zext(argument, _register(16)) for argument in arguments]
        total = builder.add(builder.add(*wide), ir.Constant(_register(16), [1] * LANES))
        return builder.trunc(builder.lshr(total, ir.Constant(_register(16), [1] * LANES)), _register(8))

    return a(a, b), generate


@_operation
def widen(typing_context: Any, vector: Any) -> Any:
    """Return bytes as 16-bit words."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.zext(arguments[0], _register(16))

    return Vector(16)(vector), generate


@_operation
def narrow(typing_context: Any, vector: Any) -> Any:
    """Return the low bytes of 16-bit words."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.trunc(arguments[0], _register(8))

    return Vector(8)(vector), generate


@_operation
def scale(typing_context: Any, a: Any, b: Any) -> Any:
    """Return the high half of the product of two vectors of 16-bit words."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        wide = [builder.zext(argument, _register(32)) for argument in arguments]
        high = builder.lshr(builder.mul(*wide), ir.Constant(_register(32), [16] * LANES))
        return builder.trunc(high, _register(16))

    return a(a, b), generate


@_operation
def first_equal(typing_context: Any, a: Any, b: Any) -> Any:
    """Return the first lane where two vectors are equal, `LANES` if there is none."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = ir.IntType(LANES)
        mask = builder.bitcast(builder.icmp_unsigned("==", *arguments), kind)
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(kind, [kind, ir.IntType(1)]), f"llvm.cttz.i{LANES}"
        )
        found = builder.call(function, [mask, ir.Constant(ir.IntType(1), 0)])
        return builder.zext(found, context.get_value_type(types.intp))

    return types.intp(a, b), generate


@_operation
def where_smaller(typing_context: Any, a: Any, b: Any, yes: Any, no: Any) -> Any:
    """Return `yes` in the lanes where `a` is smaller than `b`, else `no`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        a, b, yes, no = arguments
        return builder.select(builder.icmp_unsigned("<", a, b), yes, no)

    return yes(a, b, yes, no), generate


@_operation
def ramp(typing_context: Any, start: Any) -> Any:
    """Return 16-bit words that count upwards from a number."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.add(
            _spread(builder, arguments[0], _register(16)), ir.Constant(_register(16), list(range(LANES)))
        )

    return Vector(16)(types.uint16), generate
