"""Back ends: implementations of the kernels behind their checked signatures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from numpy.typing import NDArray


class Backend(Protocol):
    """One implementation of all kernels; a kernel is called by its name with a record of checked inputs."""

    name: str

    def run(
        self, kernel: str, given: Sequence[Any], out: Sequence[NDArray[Any]], threads: int
    ) -> Sequence[NDArray[Any]]:
        """Return the kernel's results.

        Parameters
        ----------
        kernel
            The name of the method of a family of kernels.
        given
            The family's input record, a NamedTuple of contiguous arrays and numbers; the native kernel's input has
            the same fields.
        out
            Arrays of the results' shapes and types, which a native back end fills and returns.
        threads
            0 takes all cores; the result does not depend on it.
        """
        ...


class FrameNumbers:
    """Base of records whose floats differ from frame to frame: a recorded graph reads them from memory.

    All other numbers among the arguments of `beltscape.kernels.Kernels.replay` are part of what is recorded.
    """

    __slots__ = ()


class GpuFailures:
    """Why a GPU is no longer used, in this process or in one of its workers; until the program ends."""

    def __init__(self) -> None:
        self._text = ""

    @property
    def text(self) -> str:
        """The first failure, in one line; empty: none."""
        return self._text

    def note(self, text: str) -> None:
        """Note a failure; an empty text notes none."""
        self._text = self._text or " ".join(text.split())

    def clear(self) -> None:
        """Forget the failure, for a test."""
        self._text = ""


gpu_failures = GpuFailures()
"""Of this process: the live system raises an alarm by it, reprocessing writes it into a piece's warnings."""


class KernelFamily:
    """Kernels of one subject: methods that check their arguments once and call the back end."""

    def __init__(self, backend: Backend) -> None:
        self.name = backend.name
        self.backend = backend
        self._run = backend.run
