"""Element-wise expressions of arrays on a GPU: a chain of NumPy's functions becomes one program, run in one launch.

`resident` builds an expression where NumPy's function is called with its arrays, and computes it where a kernel or
the processor needs the values. A program is a list of operations on a stack of float32 numbers. Every operation
rounds as NumPy's does; logarithms and exponentials of two libraries may differ in the last digit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import prod
from threading import Lock
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

FLOAT, BYTE, BOOL = np.dtype(np.float32), np.dtype(np.uint8), np.dtype(np.bool_)
_TYPES = FLOAT, BYTE, BOOL
"""Of the elements of operands and results; bytes and truth values are whole numbers on the stack."""
LOAD = 0
"""Operation that pushes an input; as an expression's own it leaves its operand as it is."""
CONSTANT = 1
"""Operation that pushes a number."""
OPERATIONS: dict[Any, int] = {
    function: 2 + i
    for i, function in enumerate(
        (
            np.add, np.subtract, np.multiply, np.divide, np.maximum, np.minimum, np.fmax, np.fmin, np.absolute,
            np.negative, np.sqrt, np.square, np.log, np.log1p, np.exp, np.hypot, np.copysign, np.power, np.less,
            np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal, np.logical_and, np.logical_or,
            np.logical_not, np.isfinite, np.isnan,
        )
    )
}  # fmt: skip
"""NumPy's function → its number in native/cuda/expression.cuh."""
WHERE = 31
"""Operation of three operands: the second where the first is true, else the third."""
TO_BYTE = 32
"""Operation that cuts off what a byte does not hold."""
_OF_TRUTHS = {
    np.bitwise_and: np.logical_and,
    np.bitwise_or: np.logical_or,
    np.invert: np.logical_not,
}
"""Functions of bits that are those of truth values where the operands are such."""
MOST_LENGTH = 40
"""Operations of a program: longer ones keep an intermediate result. 40 need at most 32 numbers on the stack."""


class GatherInput(NamedTuple):
    """Checked input of `gather`."""

    planes: list[NDArray[np.float32]]
    """P of (H, W)"""
    u: NDArray[np.float32]
    """(N,)"""
    v: NDArray[np.float32]
    """(N,)"""
    offsets: NDArray[np.int32]
    """(K, 2)"""


NO_OFFSET = np.zeros((1, 2), np.int32)
"""Of a pixel itself, as offsets."""


class BlocksInput(NamedTuple):
    """Checked input of `average_blocks`, `repeat_blocks` and `subsample_plane`."""

    plane: NDArray[np.float32]
    """(H, W)"""
    step: int
    """Side of a block, or distance of the values, px."""
    first: int
    """Row and column of the first value that `subsample_plane` takes."""


class ResidentOperations(Protocol):
    """What arrays on a device need of its back end."""

    def run(
        self, kernel: str, given: Any, out: Sequence[NDArray[Any]], threads: int
    ) -> Sequence[NDArray[Any]]:
        """See `beltscape.kernels.backend.Backend`; results are resident arrays."""
        ...

    def upload(self, array: NDArray[Any]) -> Any:
        """Return a copy on the device of an array of the processor."""
        ...

    def download(self, array: Any) -> NDArray[Any]:
        """Return a copy of an array of the device."""
        ...


class ExpressionInput(NamedTuple):
    """Checked input of the kernel `evaluate_expression`."""

    program: NDArray[np.int32]
    """(length, 2) operation, and the number of its input or constant."""
    constants: NDArray[np.float32]
    """(k,)"""
    inputs: list[Any]
    """n arrays of at most two axes, of float32, uint8 or bool, which NumPy could broadcast to the result's shape."""


@dataclass(frozen=True, slots=True, eq=False)
class Expression:
    """An operation on operands: numbers, and values that hold an array or another expression."""

    operation: int
    operands: tuple[Any, ...]
    length: int
    """Operations of its program, with those of operands that are expressions."""


class ArrayValue:
    """The elements of an array: on the processor, on the device, on both, or an expression to be computed."""

    __slots__ = ("device", "dtype", "expression", "host", "is_reused", "lock", "operations", "shape")

    def __init__(
        self,
        shape: tuple[int, ...],
        dtype: DTypeLike,
        operations: ResidentOperations | None,
        *,
        host: NDArray[Any] | None = None,
        device: Any = None,
        expression: Expression | None = None,
    ) -> None:
        self.shape = shape
        self.dtype = np.dtype(dtype)
        self.operations = operations
        self.host = host
        self.device = device
        self.expression = expression
        self.is_reused = False
        """Whether several kernels take it."""
        self.lock = Lock()

    @property
    def length(self) -> int:
        """Operations that a program needs for it."""
        expression = self.expression
        return expression.length if expression else 1


def join_shapes(operands: Sequence[Any]) -> tuple[int, ...]:
    """Return the shape to which operands are broadcast."""
    return np.broadcast_shapes(*(each.shape for each in operands if isinstance(each, ArrayValue)))


def find_type(operand: Any) -> Any:
    """Return the type of an operand's elements; Python's numbers have Python's types."""
    if isinstance(operand, bool):
        return BOOL
    return type(operand) if isinstance(operand, int | float) and not isinstance(operand, np.generic) else (
        operand.dtype if hasattr(operand, "dtype") else np.dtype(object)
    )  # fmt: skip


def find_step(index: Any) -> slice | None:
    """Return the slice that an index takes of rows and columns, if it is the same for both and has no end."""
    if not (
        isinstance(index, tuple) and len(index) == 2 and isinstance(index[0], slice) and index[0] == index[1]
    ):
        return None
    every = index[0]
    return every if every.stop is None and (every.step or 1) > 1 and (every.start or 0) >= 0 else None


@lru_cache(maxsize=512)
def find_result_type(function: Any, types: tuple[Any, ...]) -> np.dtype[Any] | None:
    """Return the type of NumPy's result for operands of some types; None where the device lacks the operation."""
    operation = _OF_TRUTHS.get(function, function)
    arrays = [kind for kind in types if isinstance(kind, np.dtype)]
    if operation not in OPERATIONS or any(kind not in _TYPES for kind in arrays):
        return None
    if operation is not function and any(kind != BOOL for kind in types):
        return None
    try:
        result = function.resolve_dtypes((*types, None))[-1]
    except TypeError:  # NumPy refuses them, too
        return None
    computed = function.resolve_dtypes((*types, None))[0]
    return result if result in _TYPES and computed in _TYPES else None


def number_of(function: Any) -> int:
    """Return the number of NumPy's function among the operations."""
    return OPERATIONS[_OF_TRUTHS.get(function, function)]


def wraps_around(function: Any, result: np.dtype[Any]) -> bool:
    """Return whether the function's results can leave the range of bytes, in which NumPy's wrap around."""
    return result == BYTE and function in (np.add, np.subtract, np.multiply, np.negative, np.square)


def flatten_shape(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return the shape of two axes for an expression's result or operand; of more axes all have the same shape."""
    if len(shape) <= 2:
        return cast("tuple[int, int]", (1,) * (2 - len(shape)) + shape)
    return 1, prod(shape)


class ProgramWriter:
    """Collects the operations, inputs and constants of an expression."""

    def __init__(self) -> None:
        self.code: list[tuple[int, int]] = []
        self.inputs: list[Any] = []
        self.constants: list[float] = []
        self._places: dict[int, int] = {}

    def add(self, operand: Any) -> None:
        """Add the operations that leave an operand on the stack."""
        if isinstance(operand, float):
            self.code.append((CONSTANT, len(self.constants)))
            self.constants.append(operand)
            return
        expression: Expression | None = operand.expression
        if expression is None:
            place = self._places.setdefault(id(operand), len(self.inputs))
            if place == len(self.inputs):
                self.inputs.append(operand)
            self.code.append((LOAD, place))
            return
        self.add_expression(expression)

    def add_expression(self, expression: Expression) -> None:
        """Add the operations of an expression."""
        for each in expression.operands:
            self.add(each)
        if expression.operation != LOAD:
            self.code.append((expression.operation, 0))

    def finish(self, arrays: Sequence[Any]) -> ExpressionInput:
        """Return the kernel's input, with arrays in place of the inputs."""
        constants = np.array(self.constants or [0.0], np.float32)
        return ExpressionInput(np.array(self.code, np.int32), constants, list(arrays))


def evaluate_program(given: ExpressionInput, shape: tuple[int, ...], kind: np.dtype[Any]) -> NDArray[Any]:
    """Return a program's result by NumPy: what the device's is compared with."""
    functions = {number: function for function, number in OPERATIONS.items()}
    stack: list[Any] = []
    with np.errstate(all="ignore"):
        for operation, number in given.program.tolist():
            if operation == LOAD:
                stack.append(np.asarray(given.inputs[number], np.float32))
            elif operation == CONSTANT:
                stack.append(given.constants[number])
            elif operation == WHERE:
                no, yes, mask = stack.pop(), stack.pop(), stack.pop()
                stack.append(np.where(mask != 0, yes, no))
            elif operation == TO_BYTE:
                stack.append(np.float32(np.asarray(stack.pop(), np.int64) & 255))
            else:
                function = functions[operation]
                operands = [stack.pop() for _ in range(function.nin)][::-1]
                stack.append(function(*operands).astype(np.float32))
    result = np.broadcast_to(stack[0], shape)
    return np.ascontiguousarray(result.astype(np.int64) if kind != FLOAT else result).astype(kind)
