"""Fuzzing of every endpoint against its OpenAPI description, with every role and without login."""

from __future__ import annotations

import asyncio
import itertools
import json
import warnings
from contextlib import closing
from typing import cast
from urllib.parse import unquote, urlsplit

import pytest
import requests
from hypothesis import HealthCheck, given, settings
from hypothesis.errors import Unsatisfiable

from beltscape.core.events import CameraHealth, ZeroProposal
from beltscape.core.findings import Finding
from beltscape.service.access import Access, AccessSettings
from beltscape.service.access.accounts import ROLES, Role, User
from beltscape.service.access.sessions import derive_page_token
from beltscape.service.app import create_app
from beltscape.service.live_state import LiveState
from beltscape.service.settings import WebSettings
from beltscape.sinks.historian import Historian, StoredFinding
from beltscape.sinks.settings import HistorySettings
from tests.service.access.sample_app import CHEAP, PASSWORD
from tests.service.alarm_controls import SimulatedAlarmControls
from tests.service.feeder import SimulatedPlant
from tests.thorough import THOROUGH

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import schemathesis
    from schemathesis import Case, GenerationMode
    from schemathesis.core.result import Ok

EXAMPLES = 6 if THOROUGH else 2
"""Number of cases for each kind, endpoint and role."""
HEALTH_CHECKS = cast("list[HealthCheck]", list(HealthCheck))


class AcceptingControls:
    """Controls that accept every request."""

    def __init__(self) -> None:
        self.alarm_controls = SimulatedAlarmControls({}, lambda: None)

    def acknowledge(self, alarm: str, by: str) -> bool:
        return len(alarm) % 2 == 0

    def keep_recording(self, reason: str, by: str) -> bool:
        return len(reason) % 2 == 0

    def begin_maintenance(self, reason: str, minutes: float, by: str) -> bool:
        return len(reason) % 2 == 0

    def end_maintenance(self, by: str) -> bool:
        return True

    def learn_images(self, by: str) -> bool:
        return True

    def measure_zero(self) -> ZeroProposal:
        return ZeroProposal(1, 0.1, 0.02, 0.3, 5, 2.0)

    def set_zero(self, number: int, by: str) -> bool:
        return number % 2 == 0


class Caller:
    """Calls the application as uvicorn does, each time from another address."""

    def __init__(self, app, access: Access) -> None:
        self.app, self.access = app, access
        self.addresses = (f"10.{i >> 16 & 255}.{i >> 8 & 255}.{i & 255}" for i in itertools.count(1))
        self.runner = asyncio.Runner()
        self.sessions: dict[str, str] = {}

    def session(self, role: Role) -> str:
        token = self.sessions.get(role, "")
        if self.access.sessions.find(token) is None:  # the last request may have logged out
            token = self.sessions[role] = self.access.sessions.open(User(f"the-{role}", role), "")
        return token

    def __call__(self, case: Case, role: Role | None) -> tuple[int, bytes]:
        words = case.as_transport_kwargs(base_url="http://localhost")
        words.pop("cookies", None)
        prepared = requests.Request(
            **{key: words.get(key) for key in ("method", "url", "headers", "params", "data", "json", "files")}
        ).prepare()
        body = prepared.body or b""
        body = body.encode() if isinstance(body, str) else body
        assert isinstance(body, bytes)
        headers = [(b"host", b"localhost")]
        for name, value in prepared.headers.items():
            if name.lower() not in ("host", "cookie", "x-beltscape-token"):
                plain = value.encode("latin-1", "replace") if isinstance(value, str) else value
                headers.append((name.lower().encode("latin-1", "replace"), plain))
        if role is not None:
            token = self.session(role)
            headers += [
                (b"cookie", f"beltscape={token}".encode()),
                (b"x-beltscape-token", derive_page_token(token).encode()),
            ]
        target = urlsplit(prepared.url or "")
        raw = target.path.encode("ascii")
        scope = {
            "type": "http", "method": prepared.method, "scheme": "http", "path": unquote(target.path),
            "raw_path": raw, "query_string": target.query.encode(), "root_path": "", "headers": headers,
            "http_version": "1.1", "client": (next(self.addresses), 1), "server": ("localhost", 80),
        }  # fmt: skip
        return self.runner.run(self._make_summary(scope, body))

    async def _make_summary(self, scope: dict, body: bytes) -> tuple[int, bytes]:
        sent: list[dict] = []
        ended = asyncio.Event()
        messages = [{"type": "http.request", "body": body, "more_body": False}]

        async def receive() -> dict:
            if messages:
                return messages.pop()
            await ended.wait()
            return {"type": "http.disconnect"}

        async def send(message: dict) -> None:
            sent.append(message)

        await self.app(scope, receive, send)
        ended.set()
        return sent[0]["status"], b"".join(m.get("body", b"") for m in sent[1:])


@pytest.fixture(scope="module")
def caller(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    limits = AccessSettings(requests_per_s=100_000, requests_burst=1_000_000)
    web = WebSettings(access=limits)
    with (
        closing(Access(folder, limits, CHEAP)) as access,
        closing(Historian(folder, HistorySettings())) as history,
    ):
        for role in ROLES:
            access.accounts.add(f"the-{role}", role, PASSWORD)
        history.begin_run()
        live_state = LiveState(web)
        plant = SimulatedPlant([live_state], history)
        for i in range(30):
            plant.step(1_800_000_000_000_000_000 + i * 200_000_000)
        found = [
            Finding("sharpness", 0.4, 0.1, 0.5, "", name, "", "none", place=(0.1, 0.2, 0.3, 0.4))
            for name in ("cam1", "cam2")
        ]
        found.append(
            Finding("zero_shift", float("nan"), float("nan"), float("nan"), "mm", text="x", effect="missing")
        )
        live_state.on_findings(found)
        history.add_findings([StoredFinding(1_800_000_000_000_000_000, each) for each in found])
        history.add_event(
            "alarm", "encoder_silent", "raised", wall_ns=1_800_000_000_000_000_000, parameters={"value": 5.0}
        )
        live_state.on_health({"cam1": CameraHealth("cam1", "lost", 0, 9, 0.0, float("nan"), "gone")})
        caller = Caller(create_app(live_state, history, access, AcceptingControls(), web), access)
        with caller.runner:
            yield caller


def collect_statuses(caller: Caller, operation, mode: GenerationMode, role: Role | None) -> set[int]:
    """Return the statuses that an endpoint answers with."""
    statuses: set[int] = set()

    @settings(max_examples=EXAMPLES, deadline=None, database=None, suppress_health_check=HEALTH_CHECKS)
    @given(case=operation.as_strategy(generation_mode=mode))
    def each(case: Case) -> None:
        status, body = caller(case, role)
        statuses.add(status)
        assert status < 500, case.as_curl_command()
        if status >= 400:
            assert json.loads(body)["detail"]

    try:
        each()
    except Unsatisfiable:
        assert mode is GenerationMode.NEGATIVE, "an endpoint that takes nothing can be given nothing wrong"
    return statuses


@pytest.mark.parametrize(
    ("mode", "role"),
    [
        *(
            pytest.param(GenerationMode.POSITIVE, role, marks=pytest.mark.thorough)
            for role in (None, *ROLES[:-1])
        ),
        (GenerationMode.POSITIVE, "engineer"),
        (GenerationMode.NEGATIVE, "engineer"),
    ],
)
def test_no_input_breaks_an_endpoint(caller, mode, role):
    schema = schemathesis.openapi.from_dict(caller.app.openapi())
    results = list(schema.get_all_operations())
    operations = [result.ok() for result in results if isinstance(result, Ok)]
    assert len(operations) == len(results)
    answers = {operation.label: collect_statuses(caller, operation, mode, role) for operation in operations}
    assert len(answers) >= 15
    for label, statuses in answers.items():
        if role is None and "/api/access/" not in label:
            assert statuses <= {401, 404, 414}, label
        if (
            mode is GenerationMode.POSITIVE
            and role == "engineer"
            and label.startswith("GET")
            and "{" not in label
        ):
            assert {200, 404, 422} & statuses, f"{label} never let anything through"
