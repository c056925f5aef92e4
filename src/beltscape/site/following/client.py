"""The client of one belt's machine: its HTTP interface, read with a key."""

from __future__ import annotations

import ssl
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, TypeVar

import httpx
from pydantic import BaseModel, TypeAdapter, ValidationError

from beltscape.core.errors import InputError
from beltscape.protocols.client_tls import make_client_context
from beltscape.site.following.answers import PageAnswer, RecordAnswer, StateAnswer
from beltscape.site.following.faults import BeltFaultError, Fault
from beltscape.site.settings import BeltSettings, read_key

Answer = TypeVar("Answer", bound=BaseModel)
RECORDS = 1000
"""Most records in one answer, the limit of the interface."""
_END_MS = 4_102_444_800_000
"""Latest time of a request, ms: the beginning of 2100, as the interface has it."""
_TIMEOUT_S = 10.0
"""Time for a connection, and for each part of an answer. Chosen: a thousand records take below 1 s."""
_MOST_BYTES = 4_000_000
"""Longest answer that is read; a thousand records have 0.3 MB."""
_RECORDS_OF: TypeAdapter[list[RecordAnswer]] = TypeAdapter(list[RecordAnswer])


class BeltClient:
    """Reads one belt; every method raises BeltFaultError with one line where that fails."""

    def __init__(self, settings: BeltSettings) -> None:
        """Prepare; InputError if the key or the authority cannot be read."""
        self._url = settings.url
        self._http = httpx.Client(
            base_url=settings.url,
            verify=_make_tls_context(settings),
            timeout=_TIMEOUT_S,
            headers={"Authorization": f"Bearer {read_key(settings)}", "Accept": "application/json"},
            trust_env=False,  # a proxy of the environment is not meant for machines of the plant
        )

    def read_page(self) -> PageAnswer:
        """Return the settings of the belt's page and its version."""
        return self._validate(PageAnswer, self._get("/api/page", {}))

    def read_state(self) -> StateAnswer:
        """Return the present state."""
        return self._validate(StateAnswer, self._get("/api/state", {}))

    def read_records(self, after: int, since_ms: int) -> list[RecordAnswer]:
        """Return the next records with numbers above ``after``, not older than ``since_ms``, in order."""
        query = {"since_ms": max(since_ms, 0), "until_ms": _END_MS, "limit": RECORDS, "after": after}
        try:
            records = _RECORDS_OF.validate_python(self._get("/api/records", query))
        except ValidationError as error:
            raise self._make_foreign(_describe(error)) from error
        numbers = [after, *(record.number for record in records)]
        if any(later <= earlier for earlier, later in pairwise(numbers)):
            raise self._make_foreign("its records are not in the order of their numbers")
        return records

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def _get(self, path: str, query: Mapping[str, int]) -> Any:
        """Return the JSON of an answer."""
        try:
            with self._http.stream("GET", path, params=dict(query)) as answer:
                body = b""
                for part in answer.iter_bytes():
                    body += part
                    if len(body) > _MOST_BYTES:
                        raise self._make_foreign("its answer is too long")
        except httpx.TimeoutException as error:
            raise BeltFaultError(Fault("timeout", {"url": self._url})) from error
        except httpx.HTTPError as error:
            raise BeltFaultError(self._describe_failure(error)) from error
        if answer.status_code != 200:
            raise self._make_refusal(answer)
        try:
            return httpx.Response(200, content=body).json()
        except ValueError as error:
            raise self._make_foreign("no JSON") from error

    def _describe_failure(self, error: httpx.HTTPError) -> Fault:
        """Return the fault behind a connection that was not made, or broke."""
        reason = " ".join(str(error).split())[:200]
        cause = _find_tls_error(error)
        if isinstance(cause, ssl.SSLCertVerificationError):
            return Fault("certificate", {"url": self._url, "reason": cause.verify_message})
        if cause is not None:
            return Fault("not_tls", {"url": self._url})
        if isinstance(error, httpx.RemoteProtocolError | httpx.ReadError) and self._url.startswith("http:"):
            return Fault("needs_tls", {"url": self._url})
        return Fault("unreachable", {"url": self._url, "reason": reason or type(error).__name__})

    def _make_refusal(self, answer: httpx.Response) -> BeltFaultError:
        status = answer.status_code
        if status in (401, 403):
            return BeltFaultError(Fault("key", {"url": self._url}))
        if status == 429:
            wait = answer.headers.get("retry-after", "")
            wait_s = min(float(wait), 60.0) if wait.isdecimal() else 1.0
            return BeltFaultError(Fault("busy", {"url": self._url, "wait_s": wait_s}), wait_s)
        if status == 503:
            return BeltFaultError(Fault("history", {"url": self._url}))
        if status == 400:
            return BeltFaultError(Fault("host", {"url": self._url}))
        return BeltFaultError(Fault("status", {"url": self._url, "status": status}))

    def _validate(self, model: type[Answer], values: Any) -> Answer:
        try:
            return model.model_validate(values)
        except ValidationError as error:
            raise self._make_foreign(_describe(error)) from error

    def _make_foreign(self, reason: str) -> BeltFaultError:
        return BeltFaultError(Fault("foreign", {"url": self._url, "reason": reason}))


def _make_tls_context(settings: BeltSettings) -> ssl.SSLContext:
    try:
        return make_client_context(settings.ca)
    except OSError as error:
        raise InputError(f"{settings.ca}: no certificates in PEM form ({error})") from error


def _describe(error: ValidationError) -> str:
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    return f"{place}: {first['msg']}" if place else first["msg"]


def _find_tls_error(error: BaseException | None) -> ssl.SSLError | None:
    """Return the TLS error among the causes of an error; None if there is none."""
    while error is not None:
        if isinstance(error, ssl.SSLError):
            return error
        error = error.__cause__ or error.__context__
    return None
