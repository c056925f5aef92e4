"""What lines and windows over a grid take, checked once at the wrapper."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import KernelError
from beltscape.kernels.protocol.first_met import Place


class CheckedLines(NamedTuple):
    """Contiguous arrays, of shapes that fit each other."""

    measured: NDArray[np.bool_]
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    down: NDArray[np.float64]
    across: NDArray[np.float64]
    most: int


class CheckedWindows(NamedTuple):
    """Contiguous arrays, of shapes that fit each other."""

    field: NDArray[np.float64]
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    sides: NDArray[np.int64]


def first_met_input(
    measured: NDArray[np.bool_],
    place: Place,
    down: NDArray[np.floating],
    across: NDArray[np.floating],
    most: int,
) -> CheckedLines:
    """The arrays as the kernels take them, or KernelError."""
    measured = np.ascontiguousarray(measured, dtype=bool)
    if measured.ndim != 2 or not measured.size:
        raise KernelError(f"measured must have the shape (Ny, Nx), not {measured.shape}")
    rows, columns = _place(place, measured.shape)
    down, across = (np.ascontiguousarray(part, dtype=np.float64) for part in (down, across))
    for name, part in (("down", down), ("across", across)):
        if part.ndim != 2 or part.shape[1] not in (1, len(rows)) or part.shape != down.shape:
            raise KernelError(f"{name} must have the shape (D, 1) or (D, {len(rows)}), not {part.shape}")
        if not (np.abs(part) <= 1).all():
            raise KernelError(f"{name} must be -1 to 1")
    if most < 0:
        raise KernelError(f"most must be at least 0, not {most}")
    return CheckedLines(measured, rows, columns, down, across, most)


def windows_input(field: NDArray[np.floating], place: Place, sides: tuple[int, ...]) -> CheckedWindows:
    """The arrays as the kernels take them, or KernelError."""
    checked = field_input(field)
    if not sides or any(side < 1 or side % 2 == 0 for side in sides):
        raise KernelError(f"sides must be odd and positive, not {sides}")
    return CheckedWindows(checked, *_place(place, checked.shape), np.array(sides, np.int64))


def field_input(field: NDArray[np.floating]) -> NDArray[np.float64]:
    """The field (Ny, Nx) as the kernels take it, or KernelError."""
    field = np.ascontiguousarray(field, dtype=np.float64)
    if field.ndim != 2 or not field.size:
        raise KernelError(f"field must have the shape (Ny, Nx), not {field.shape}")
    return field


def _place(place: Place, shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    rows, columns = (np.ascontiguousarray(part, dtype=np.int64) for part in place)
    if rows.ndim != 1 or rows.shape != columns.shape:
        raise KernelError(f"place must have the shapes (H,) and (H,), not {rows.shape} and {columns.shape}")
    for part, count in ((rows, shape[0]), (columns, shape[1])):
        if len(part) and (part.min() < 0 or part.max() >= count):
            raise KernelError(f"place must lie within the field {shape}")
    return rows, columns
