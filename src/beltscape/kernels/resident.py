"""Arrays that stay in a GPU's memory between kernels and copy themselves to the processor where NumPy reads them.

NumPy's element-wise functions of such arrays are computed on the GPU, too, once their result is needed
(`expressions`). Functions that the GPU lacks read the processor's copies.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from math import prod
from operator import attrgetter
from typing import Any, cast

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import DTypeLike, NDArray

from beltscape.kernels.expressions import (
    BOOL,
    BYTE,
    FLOAT,
    LOAD,
    MOST_LENGTH,
    NO_OFFSET,
    TO_BYTE,
    WHERE,
    ArrayValue,
    BlocksInput,
    Expression,
    ExpressionInput,
    GatherInput,
    ProgramWriter,
    ResidentOperations,
    find_result_type,
    find_step,
    find_type,
    flatten_shape,
    join_shapes,
    number_of,
    wraps_around,
)


def _read(value: ArrayValue) -> NDArray[Any]:
    """Return the array of the processor, read-only, downloaded at the first call; the value's lock is held."""
    if value.host is None:
        _compute(value)
        assert value.operations is not None
        value.host = value.operations.download(value.device)
        value.host.setflags(write=False)
    return value.host


def _write_program(expression: Expression) -> ExpressionInput:
    """Return the program of an expression."""
    writer = ProgramWriter()
    writer.add_expression(expression)
    return writer.finish([ResidentArray(each).reshape(flatten_shape(each.shape)) for each in writer.inputs])


def _compute(value: ArrayValue) -> None:
    """Compute an expression on the device; the value's lock is held."""
    if value.expression is None:
        return
    assert value.operations is not None
    given, out = _write_program(value.expression), np.empty(flatten_shape(value.shape), value.dtype)
    (result,) = value.operations.run("evaluate_expression", given, (out,), 1)
    assert isinstance(result, ResidentArray)
    value.device = result.reshape(value.shape).on_device(value.operations.upload)
    value.expression = None


class ResidentArray(NDArrayOperatorsMixin):
    """An array of the device, of the processor, or of both; kernels take the one and NumPy the other.

    Elements are not assigned: results are new arrays, and ``out=`` of a result makes it another array. Each of both
    copies is made once, when it is first needed. Where the device is lost, reading a result that only the device has
    raises what its back end's ``download`` raises.
    """

    def __init__(self, value: ArrayValue, *, kept: bool = False) -> None:
        self._value = value
        self._is_kept = kept

    @classmethod
    def from_host(cls, array: NDArray[Any], operations: ResidentOperations | None = None) -> ResidentArray:
        """Return the array for the device, which copies it at its first use; the array becomes read-only."""
        array = np.ascontiguousarray(array)
        array.setflags(write=False)
        return cls(ArrayValue(array.shape, array.dtype, operations, host=array), kept=True)

    @classmethod
    def from_device(cls, array: Any, operations: ResidentOperations) -> ResidentArray:
        """Return a result of the device."""
        return cls(ArrayValue(array.shape, array.dtype, operations, device=array))

    @property
    def shape(self) -> tuple[int, ...]:
        """Elements along each axis."""
        return self._value.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the elements."""
        return self._value.dtype

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self._value.shape)

    @property
    def size(self) -> int:
        """Number of elements."""
        return prod(self._value.shape)

    @property
    def identity(self) -> int:
        """The same for arrays that are the same one."""
        return id(self._value)

    @property
    def operations(self) -> ResidentOperations | None:
        """The back end that computes with it; None for an array that was kept without one."""
        return self._value.operations

    def on_device(self, upload: Callable[[NDArray[Any]], Any]) -> Any:
        """Return the array of the device, computed or uploaded at the first call."""
        value = self._value
        with value.lock:
            _compute(value)
            if value.device is None:
                value.device = upload(_read(value))
            return value.device

    def find_on_device(self) -> Any:
        """Return the array of the device, computed if it is an expression; None where only the processor has it."""
        value = self._value
        with value.lock:
            _compute(value)
            return value.device

    def adopt(self, array: Any) -> None:
        """Note the copy on the device that another made of the processor's array."""
        with self._value.lock:
            if self._value.device is None:
                self._value.device = array

    def on_host(self) -> NDArray[Any]:
        """Return the array of the processor, read-only, computed and downloaded at the first call."""
        with self._value.lock:
            return _read(self._value)

    @property
    def operand(self) -> Any:
        """What expressions hold of it."""
        return self._value

    @property
    def is_awaited(self) -> bool:
        """Whether it is an expression that several kernels take: the first that computes it by the way writes it."""
        return self._value.is_reused and self._value.expression is not None

    def find_program(self) -> ExpressionInput | None:
        """Return the program of an expression that one kernel takes, which may run it by the way; None for others."""
        value = self._value
        with value.lock:
            expression = None if value.is_reused else value.expression
            return _write_program(expression) if expression else None

    def mark_reused(self) -> None:
        """Note that several kernels take it."""
        self._value.is_reused = True

    def adopt_result(self, found: Any) -> None:
        """Note the values of an expression that a kernel computed by the way."""
        value = self._value
        with value.lock:
            if value.expression is not None:
                value.device, value.expression = found.find_on_device(), None

    def astype(self, dtype: DTypeLike, *, copy: bool = True) -> Any:
        """Return the values as another type; without ``copy`` the array itself where it has that type."""
        kind = np.dtype(dtype)
        if kind == self.dtype and not copy:
            return self
        if self.operations is None or kind not in (FLOAT, BYTE) or self.dtype not in (FLOAT, BYTE, BOOL):
            return self.on_host().astype(kind)
        if (self.dtype, kind) == (BOOL, BYTE):
            return self.view(kind)
        operation = TO_BYTE if kind == BYTE and self.dtype == FLOAT else LOAD
        return _make_expression(operation, [self._value], self.shape, kind, self.operations)

    def copy(self) -> Any:
        """Return the values for changes in place, which leave this array as it is."""
        return ResidentArray(self._value)

    def reshape(self, *shape: Any) -> Any:
        """Return the same values in another shape, on the device where they are there."""
        wanted = shape[0] if len(shape) == 1 and isinstance(shape[0], tuple) else shape
        known = prod(n for n in wanted if n != -1)
        full = tuple(self.size // known if n == -1 else int(n) for n in wanted)
        if full == self.shape:
            return self
        if self._value.expression and self.operations and full == (1, *self.shape) and self.ndim == 1:
            return _make_expression(LOAD, [self._value], full, self.dtype, self.operations)
        return self._share(lambda array: array.reshaped(full), lambda array: array.reshape(full))

    def ravel(self) -> Any:
        """Return the same values along one axis."""
        return self.reshape(-1)

    def view(self, dtype: DTypeLike) -> Any:
        """Return the same bits as elements of another type of the same size."""
        return self._share(lambda array: array.viewed(np.dtype(dtype)), lambda array: array.view(dtype))

    def _share(self, of_device: Callable[[Any], Any], of_host: Callable[[Any], Any]) -> Any:
        """Return a part or another form of the same memory: of the device's, if there is one."""
        operations = self._value.operations
        if operations is None:
            return of_host(self.on_host())
        return self.from_device(of_device(self.on_device(operations.upload)), operations)

    def _part(self, of_device: Callable[[Any], Any], index: Any) -> Any:
        """Return a part of the same memory: of the processor's, if it has a copy."""
        if self._value.host is not None:
            return self._value.host[index]
        return self._share(of_device, lambda array: array[index])

    def clip(self, low: Any = None, high: Any = None, out: Any = None) -> Any:
        """Return the values within bounds; NaN stays."""
        result: Any = self if low is None else np.maximum(self, low)
        return np.minimum(result, np.inf if high is None else high, out=out)

    def __float__(self) -> float:
        return float(self.on_host())

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        array = self.on_host()
        if dtype is not None and np.dtype(dtype) != array.dtype:
            return array.astype(dtype)
        return array.copy() if copy else array

    def __array_ufunc__(self, function: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """Compute on the device what it can, and else with the processor's arrays."""
        (out,) = options.pop("out", (None,))
        result = None
        if method == "__call__" and not options:
            result = _apply(function, inputs)
        if result is None:
            result = getattr(function, method)(*map(as_host, inputs), **options)
        if out is None:
            return result
        if not isinstance(out, ResidentArray):
            np.copyto(out, as_host(result))
        elif out._is_kept or not isinstance(result, ResidentArray):
            return NotImplemented  # read-only
        elif (result.shape, result.dtype) != (out.shape, out.dtype):
            return NotImplemented
        else:
            out._value = result._value
        return out

    def __array_function__(self, function: Any, types: Any, args: Any, options: Any) -> Any:
        """Compute NumPy's other functions: those below on the device, the rest with the processor's arrays."""
        del types
        found = _FUNCTIONS.get(function)
        result = found(*args, **options) if found else None
        if result is not None:
            return result
        return function(*map(as_host, args), **{name: as_host(each) for name, each in options.items()})

    def __getitem__(self, index: Any) -> Any:
        if self.operations is not None and index is None:
            return self.reshape((1, *self.shape))
        if isinstance(index, int) and self.ndim == 2 and self._value.expression and self.operations:
            return ResidentArray(_take_row(self._value, index, self.operations))
        if isinstance(index, int) and self.ndim > 1:
            return self._part(lambda array: array.part(index), index)
        if isinstance(index, slice) and index.step in (None, 1):
            first, last, _ = index.indices(self.shape[0])
            if (first, last) == (0, self.shape[0]):
                return ResidentArray(self._value)
            return self._part(lambda array: array.rows(first, max(first, last)), index)
        if _is_pixels(index) and self.ndim == 2 and self.dtype in (FLOAT, BYTE, BOOL):
            return self._gather(*index)
        if (every := find_step(index)) and self.ndim == 2 and self.dtype == FLOAT:
            return self._subsample(every)
        return self.on_host()[as_host(index)]

    def _gather(self, rows: ResidentArray, columns: ResidentArray) -> Any:
        """Return the values (N,) at some pixels."""
        assert rows.operations is not None
        given = GatherInput(
            [self.astype(FLOAT, copy=False)], cast("Any", columns), cast("Any", rows), NO_OFFSET
        )
        (values,) = rows.operations.run("gather", given, (np.empty((1, rows.size), FLOAT),), 1)
        return values.reshape(-1)

    def _subsample(self, every: slice) -> Any:
        """Return every n-th value of every n-th row."""
        if self.operations is None or self._value.host is not None:
            return self.on_host()[every, every]
        first = every.start or 0
        shape = tuple(len(range(first, size, every.step)) for size in self.shape)
        given = BlocksInput(cast("Any", self), every.step, first)
        return self.operations.run("subsample_plane", given, (np.empty(shape, FLOAT),), 1)[0]

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(len(self)))

    def __len__(self) -> int:
        return self.shape[0]

    def __getattr__(self, name: str) -> Any:
        """Return what NumPy's array has of that name: methods and attributes that are not defined here."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.on_host(), name)


def _is_pixels(index: Any) -> bool:
    """Return whether an index is the rows and columns of some pixels, on the device."""
    return isinstance(index, tuple) and len(index) == 2 and all(isinstance(i, ResidentArray) for i in index)


def _find_operations(operands: Sequence[Any]) -> ResidentOperations | None:
    found = (each.operations for each in operands if isinstance(each, ResidentArray))
    return next((each for each in found if each is not None), None)


def _apply(function: Any, inputs: Sequence[Any]) -> Any:
    """Return NumPy's function of some operands as an expression; None where the device lacks it."""
    operations = _find_operations(inputs)
    kind = find_result_type(function, tuple(map(find_type, inputs)))
    if operations is None or kind is None:
        return None
    operands = [_as_operand(each, operations) for each in inputs]
    result = _make_expression(number_of(function), operands, join_shapes(operands), kind, operations)
    if result is not None and wraps_around(function, kind):
        return _make_expression(TO_BYTE, [result._value], result.shape, kind, operations)
    return result


def _where(mask: Any, *both: Any) -> Any:
    """Compute `numpy.where` of three operands."""
    operations = _find_operations((mask, *both))
    if len(both) != 2 or operations is None or find_type(mask) != BOOL:
        return None
    scalars = (np.float32(0) if find_type(each) is float else each for each in both)
    kind = np.result_type(
        *(each.dtype if isinstance(each, ResidentArray | np.ndarray) else each for each in scalars)
    )
    if kind not in (FLOAT, BYTE, BOOL) or any(
        find_type(each) not in (FLOAT, BYTE, BOOL, float, int) for each in both
    ):
        return None
    operands = [_as_operand(each, operations) for each in (mask, *both)]
    return _make_expression(WHERE, operands, join_shapes(operands), kind, operations)


def _fill_like(array: Any, value: float, dtype: DTypeLike | None = None) -> Any:
    """Compute `numpy.full_like`."""
    kind = np.dtype(dtype or array.dtype)
    if not isinstance(array, ResidentArray) or array.operations is None or kind not in (FLOAT, BYTE, BOOL):
        return None
    return _make_expression(LOAD, [float(value)], array.shape, kind, array.operations)


def _broadcast(array: Any, shape: tuple[int, ...]) -> Any:
    """Compute `numpy.broadcast_to`."""
    if not isinstance(array, ResidentArray) or array.operations is None:
        return None
    return _make_expression(LOAD, [array._value], shape, array.dtype, array.operations)


def _clip(array: Any, low: Any = None, high: Any = None, out: Any = None) -> Any:
    return array.clip(low, high, out) if isinstance(array, ResidentArray) else None


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where,
    np.clip: _clip,
    np.full_like: _fill_like,
    np.zeros_like: partial(_fill_like, value=0),
    np.ones_like: partial(_fill_like, value=1),
    np.broadcast_to: _broadcast,
    np.shape: attrgetter("shape"),
    np.ndim: attrgetter("ndim"),
    np.size: attrgetter("size"),
}


def _as_operand(given: Any, operations: ResidentOperations) -> Any:
    """Return a number, or the value of an array; one of the processor is copied, because it may change."""
    if isinstance(given, ResidentArray):
        return given._value
    array = np.asarray(given)
    if array.ndim == 0:
        return float(array)
    return ResidentArray.from_host(np.array(array, order="C"), operations)._value


def _make_expression(
    operation: int, operands: list[Any], shape: tuple[int, ...], kind: Any, operations: ResidentOperations
) -> Any:
    """Return the array of an expression; None where its operands are spread over more than two axes."""
    arrays = [each for each in operands if isinstance(each, ArrayValue)]
    if len(shape) > 2 and any(each.shape != shape for each in arrays):
        return None
    length = 1 + sum(each.length if isinstance(each, ArrayValue) else 1 for each in operands)
    if length > MOST_LENGTH:
        for each in arrays:
            with each.lock:
                _compute(each)
        length = 1 + len(operands)
    expression = Expression(operation, tuple(operands), length)
    return ResidentArray(ArrayValue(shape, kind, operations, expression=expression))


def _take_row(operand: Any, row: int, operations: ResidentOperations) -> Any:
    """Return a row of an expression of two axes or of its operand: an expression of its arrays' rows."""
    if not isinstance(operand, ArrayValue) or len(operand.shape) < 2:
        return operand
    if operand.expression is None:
        return _as_operand(ResidentArray(operand)[row if operand.shape[0] > 1 else 0], operations)
    expression = operand.expression
    operands = tuple(_take_row(each, row, operations) for each in expression.operands)
    of_row = Expression(expression.operation, operands, expression.length)
    return ArrayValue(operand.shape[1:], operand.dtype, operations, expression=of_row)


def to_processor(array: Any) -> NDArray[Any]:
    """Return an array of the processor that may be changed; one of the device is not kept besides."""
    if not isinstance(array, ResidentArray) or array.operations is None:
        return np.array(array, copy=None)
    return array.operations.download(array.on_device(array.operations.upload))


def as_host(value: Any) -> Any:
    """Return a value with the processor's arrays in place of resident ones, in lists and tuples too."""
    if isinstance(value, ResidentArray):
        return value.on_host()
    if isinstance(value, list):
        return [as_host(each) for each in value]
    if isinstance(value, tuple):
        parts = map(as_host, value)
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value
