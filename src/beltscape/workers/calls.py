"""Calls of functions that others may make meanwhile: they are begun, and their values are taken later.

Without workers a call is made when it is begun. Its value does not depend on who makes it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar, cast

from beltscape.workers.processes import ProcessPool, ProcessTask

Value = TypeVar("Value")
Value_co = TypeVar("Value_co", covariant=True)


class PendingCall(Protocol[Value_co]):
    """A call that was begun."""

    def result(self) -> Value_co:
        """Wait for the value and return it; the function's error is raised."""
        ...

    def done(self) -> bool:
        """Return whether `result` need not wait."""
        ...


class CallMaker(Protocol):
    """Makes calls."""

    def begin(self, function: Callable[..., Value], *given: Any) -> PendingCall[Value]:
        """Begin the call of a function of a module; neither it nor the caller changes what is ``given``."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class _KnownValue(Generic[Value]):
    """The value of a call that was made."""

    value: Value

    def result(self) -> Value:
        """Return the value."""
        return self.value

    def done(self) -> bool:
        """Return True."""
        return True


class CallsHere:
    """Makes each call at once."""

    def begin(self, function: Callable[..., Value], *given: Any) -> PendingCall[Value]:
        """Call the function; see `CallMaker`."""
        return _KnownValue(function(*given))


@dataclass(frozen=True, slots=True, eq=False)
class Call(Generic[Value]):
    """A call as a task of a pool."""

    function: Callable[..., Value]
    given: tuple[Any, ...]

    def make(self) -> Value:
        """Return the function's value."""
        return self.function(*self.given)


@dataclass(frozen=True, slots=True, eq=False)
class _CallOfPool(Generic[Value]):
    """A call that a worker makes."""

    call: Call[Value]
    pending: ProcessTask

    def result(self) -> Value:
        """Return the value; a call that the workers did not survive is made here, as is one that raises an error."""
        end = self.pending.result()
        return self.call.make() if end.failure else cast("Value", end.value)

    def done(self) -> bool:
        """Return whether the worker has ended it."""
        return self.pending.done()


def make_call(shared: None, call: Call[Any]) -> Any:
    """Return the value of a call: the function of a pool for `CallsOfPool`."""
    del shared
    return call.make()


class CallsOfPool:
    """Has the processes of a pool make the calls; its function is `make_call`."""

    def __init__(self, pool: ProcessPool) -> None:
        self._pool = pool

    def begin(self, function: Callable[..., Value], *given: Any) -> PendingCall[Value]:
        """Hand the call out; see `CallMaker`."""
        call = Call(function, given)
        return _CallOfPool(call, self._pool.submit(call, function.__name__))
