"""Lines and windows over a grid, in C++."""

from __future__ import annotations

from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from beltscape.kernels.check_windows import field_input, first_met_input, windows_input
from beltscape.kernels.protocol.first_met import Met, Place
from beltscape.kernels.protocol.windows import Means, Quadratics


class Windows:
    """The kernels of native/bind_windows.cpp."""

    _module: ModuleType

    def first_met(
        self,
        measured: NDArray[np.bool_],
        place: Place,
        down: NDArray[np.floating],
        across: NDArray[np.floating],
        most: int,
        *,
        threads: int = 0,
    ) -> Met:
        """See `beltscape.kernels.protocol.first_met`."""
        given = first_met_input(measured, place, down, across, most)
        shape = (len(given.down), len(given.rows))
        out = Met(np.empty(shape, np.int64), np.empty(shape))
        self._module.first_met(*given, *out, threads)
        return out

    def quadratics(
        self, field: NDArray[np.float64], place: Place, sides: tuple[int, ...], *, threads: int = 0
    ) -> Quadratics:
        """See `beltscape.kernels.protocol.windows`."""
        given = windows_input(field, place, sides)
        out = np.empty((3, len(sides), len(given.rows)))
        self._module.quadratics(*given, *out, threads)
        return Quadratics(*out)

    def window_means(
        self, field: NDArray[np.float64], place: Place, sides: tuple[int, ...], *, threads: int = 0
    ) -> Means:
        """See `beltscape.kernels.protocol.windows`."""
        given = windows_input(field, place, sides)
        out = np.empty((2, len(sides), len(given.rows)))
        self._module.window_means(*given, *out, threads)
        return Means(*out)

    def window_minima(
        self, field: NDArray[np.float64], place: Place, sides: tuple[int, ...], *, threads: int = 0
    ) -> NDArray[np.float64]:
        """See `beltscape.kernels.protocol.windows`."""
        del threads  # one is fast enough
        given = windows_input(field, place, sides)
        out = np.empty((len(sides), len(given.rows)))
        self._module.window_minima(*given, out)
        return out

    def plane_slopes(self, field: NDArray[np.float64], *, threads: int = 0) -> NDArray[np.float64]:
        """See `beltscape.kernels.protocol.windows`."""
        given = field_input(field)
        out = np.empty((2, *given.shape))
        self._module.plane_slopes(given, out, threads)
        return out
