"""The client of one belt's machine: its HTTP interface, read with a key, its answers, and its faults.

Answers have what the site reads; fields that other versions add are ignored. Faults are one line each; the page has
the same texts in all languages by their keys.
"""

from __future__ import annotations

import ssl
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Any, TypeVar

import httpx
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from beltscape.core.errors import InputError
from beltscape.core.ledger import Standing
from beltscape.protocols.client_tls import make_client_context
from beltscape.site.settings import SiteBeltSettings, read_key

_Number = Annotated[int, Field(ge=0, le=2**53)]
_WallMs = Annotated[int, Field(ge=0, le=4_102_444_800_000)]
"""System clock, ms since 1970, up to the beginning of 2100."""


class _AnswerModel(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class PageAnswer(_AnswerModel):
    """GET /api/page."""

    version: str
    plant: str
    stale_s: float
    full_m3_h: float | None = None


class FlowAnswer(_AnswerModel):
    """Flow of a state; None: not known."""

    volume_m3_h: float | None
    sigma_m3_h: float | None
    mass_t_h: float | None
    mass_sigma_t_h: float | None
    area_m2: float | None
    coverage: float | None
    trend: str
    standing: Standing
    age_s: float | None


class FramesAnswer(_AnswerModel):
    """Frames of a state."""

    speed_m_s: float | None
    age_s: float | None


class TotalsAnswer(_AnswerModel):
    """Totals of the ledger."""

    records: int
    volume_m3: float
    sigma_m3: float | None
    mass_t: float | None
    valid_m: float
    degraded_m: float
    missing_m: float
    since_ms: int | None


class CameraAnswer(_AnswerModel):
    """Health of a camera."""

    name: str
    state: str


class AlarmAnswer(_AnswerModel):
    """An alarm that is not clear."""

    name: str
    severity: str
    state: str
    value: float | None
    limit: float | None
    unit: str
    since_ms: int | None
    detail: str
    cause: str
    values: dict[str, Any]


class MaintenanceAnswer(_AnswerModel):
    """The present maintenance."""

    reason: str
    until_ms: int


class StateAnswer(_AnswerModel):
    """GET /api/state."""

    stale_s: float | None = None
    """None: of a version that has it among the settings of the page only."""
    wall_ms: _WallMs
    frames: FramesAnswer
    flow: FlowAnswer
    totals: TotalsAnswer
    cameras: tuple[CameraAnswer, ...]
    alarms: tuple[AlarmAnswer, ...]
    record: int | None
    maintenance: MaintenanceAnswer | None


class RecordAnswer(_AnswerModel):
    """An entry of the ledger, GET /api/records."""

    number: _Number
    run: _Number
    wall_ms: _WallMs
    from_m: float
    to_m: float
    standing: Standing
    volume_m3: float | None
    sigma_m3: float | None
    mass_t: float | None

    @property
    def length_m(self) -> float:
        """Return the length of belt."""
        return self.to_m - self.from_m

    @property
    def mark(self) -> str:
        """Return what tells this entry from another one of the same number."""
        return f"{self.number}/{self.run}/{self.wall_ms}/{self.from_m:.6f}/{self.to_m:.6f}"


FAULT_TEXTS = {
    "unreachable": "{url}: cannot be reached ({reason}); is the machine on, and is the address right?",
    "timeout": "{url}: does not answer in time; the machine or the network is overloaded",
    "certificate": "{url}: its certificate is refused ({reason}); give its authority as ca, and its own host name",
    "not_tls": "{url}: does not speak TLS; give its address with http://, or give that machine a certificate",
    "needs_tls": "{url}: closes the connection; if that machine has a certificate, give its address with https://",
    "key": "{url}: does not know the key; make one there by `beltscape users key`, and write it into key_file",
    "host": "{url}: refuses this host name; list it there in [web.access] allowed_hosts",
    "busy": "{url}: answers too many requests already; it is asked again in {wait_s:.0f} s",
    "history": "{url}: cannot read its history at the moment; see its own alarms",
    "status": "{url}: answers with status {status}; is the address that of a belt's page?",
    "foreign": "{url}: answers, but not as a belt does ({reason}); is the address that of a belt's page?",
    "version": "runs version {version}, this site {own}; update both, if something is missing here",
    "clock": "its clock differs by {offset_s:.0f} s from this machine's; synchronise both (NTP); it is in no balance",
    "replaced": "its ledger was replaced: record {number} is another now; records later than it count",
    "pruned": "its ledger no longer holds the records {first} to {last}; they are in no sum of this site",
    "store": "its sums cannot be written ({reason}); free the disk of the site's machine",
    "no_frames": "sends no frames for {age_s:.0f} s; see its own page",
}
"""Key → the fault and its fix, in English."""
FAULT_ALARMS = ("clock", "replaced", "pruned", "no_frames", "store")
"""Faults of a belt that answers, which are alarms of the site; the others are one once the belt counts as away."""


@dataclass(frozen=True, slots=True)
class BeltFault:
    """Something wrong with a belt."""

    key: str
    """One of TEXTS."""
    values: dict[str, float | int | str] = field(default_factory=dict[str, "float | int | str"])

    @property
    def text(self) -> str:
        """Return the fault and its fix in one line."""
        return FAULT_TEXTS[self.key].format(**self.values)


class BeltFaultError(Exception):
    """A belt's machine cannot be read; ``wait_s``: the least time until it is asked again."""

    def __init__(self, fault: BeltFault, wait_s: float = 0.0) -> None:
        super().__init__(fault.text)
        self.fault, self.wait_s = fault, wait_s


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

    def __init__(self, settings: SiteBeltSettings) -> None:
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
            raise BeltFaultError(BeltFault("timeout", {"url": self._url})) from error
        except httpx.HTTPError as error:
            raise BeltFaultError(self._describe_failure(error)) from error
        if answer.status_code != 200:
            raise self._make_refusal(answer)
        try:
            return httpx.Response(200, content=body).json()
        except ValueError as error:
            raise self._make_foreign("no JSON") from error

    def _describe_failure(self, error: httpx.HTTPError) -> BeltFault:
        """Return the fault behind a connection that was not made, or broke."""
        reason = " ".join(str(error).split())[:200]
        cause = _find_tls_error(error)
        if isinstance(cause, ssl.SSLCertVerificationError):
            return BeltFault("certificate", {"url": self._url, "reason": cause.verify_message})
        if cause is not None:
            return BeltFault("not_tls", {"url": self._url})
        if isinstance(error, httpx.RemoteProtocolError | httpx.ReadError) and self._url.startswith("http:"):
            return BeltFault("needs_tls", {"url": self._url})
        return BeltFault("unreachable", {"url": self._url, "reason": reason or type(error).__name__})

    def _make_refusal(self, answer: httpx.Response) -> BeltFaultError:
        status = answer.status_code
        if status in (401, 403):
            return BeltFaultError(BeltFault("key", {"url": self._url}))
        if status == 429:
            wait = answer.headers.get("retry-after", "")
            wait_s = min(float(wait), 60.0) if wait.isdecimal() else 1.0
            return BeltFaultError(BeltFault("busy", {"url": self._url, "wait_s": wait_s}), wait_s)
        if status == 503:
            return BeltFaultError(BeltFault("history", {"url": self._url}))
        if status == 400:
            return BeltFaultError(BeltFault("host", {"url": self._url}))
        return BeltFaultError(BeltFault("status", {"url": self._url, "status": status}))

    def _validate(self, model: type[Answer], values: Any) -> Answer:
        try:
            return model.model_validate(values)
        except ValidationError as error:
            raise self._make_foreign(_describe(error)) from error

    def _make_foreign(self, reason: str) -> BeltFaultError:
        return BeltFaultError(BeltFault("foreign", {"url": self._url, "reason": reason}))


def _make_tls_context(settings: SiteBeltSettings) -> ssl.SSLContext:
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
