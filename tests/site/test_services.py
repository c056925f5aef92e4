"""A site on real services over HTTP: stopped and started, with a wrong key, certificate, address or version."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from beltscape.core.errors import InputError
from beltscape.site.client import BeltFaultError
from beltscape.site.run import RunningSite, check_site
from beltscape.site.settings import SiteBeltSettings, read_site
from tests.protocols.broker import find_port, wait_until
from tests.service.access.certificates import make_certificate
from tests.service.access.sample_app import CHEAP, PASSWORD
from tests.site.services import Belt, run, serve_belts, write_site

pytest.importorskip("httpx", reason="httpx is not installed; pip install 'beltscape[site]' brings it")

from beltscape.site.client import BeltClient


@pytest.fixture
def belts(tmp_path: Path) -> Iterator[dict[str, Belt]]:
    """Return three belts that answer."""
    with serve_belts(tmp_path, "abc") as made:
        yield made


def count(running: RunningSite, name: str) -> int:
    store = running.state.store
    return sum(sums.records for sums in store.read_quarters(name, 0, 1 << 40).values())


def list_alarms(running: RunningSite) -> list[tuple[str, str]]:
    return [(one["kind"], one["subject"]) for one in running.state.take_snapshot()["alarms"]]


def test_three_belts_one_away_and_back(belts: dict[str, Belt], tmp_path: Path) -> None:
    path = write_site(tmp_path, belts)
    for belt in belts.values():
        belt.measure(20)
    with run(path) as (running, show):
        wait_until(lambda: [count(running, name) for name in "abc"] == [20, 20, 20])
        wait_until(lambda: show("a")["flow"] is not None)
        assert show("a")["totals"]["records"] == 20
        assert show("a")["cameras"] == {"ok": 5, "all": 5}
        belts["b"].stop()
        belts["b"].measure(30)  # it goes on by itself
        belts["a"].measure(7)
        wait_until(lambda: show("b")["is_away"])
        shown = show("b")
        assert shown["flow"] is None
        assert shown["age_s"] > 1
        assert shown["faults"][0]["key"] == "unreachable"
        assert shown["totals"]["records"] == 20  # the last that is known
        wait_until(lambda: count(running, "a") == 27)
        wait_until(lambda: list_alarms(running) == [("away", "b")])
        assert show("b")["age_s"] > shown["age_s"]
        belts["b"].start()
        wait_until(lambda: not show("b")["is_away"] and count(running, "b") == 50)
        assert show("b")["faults"] == []
    belts["c"].measure(5)  # the site was away, too
    with run(path) as (running, _):
        wait_until(lambda: [count(running, name) for name in "abc"] == [27, 50, 25])


@pytest.mark.thorough
def test_signed_in_users_only(belts: dict[str, Belt], tmp_path: Path) -> None:
    import httpx

    from beltscape.service.access import Access, AccessSettings

    path = write_site(tmp_path, {"a": belts["a"]})
    site = read_site(path)
    site.data.mkdir()
    access = Access(site.data, AccessSettings(), CHEAP)
    access.accounts.add("anna", "viewer", PASSWORD)
    access.close()
    with run(path) as (running, _), httpx.Client(base_url=running.server.address) as client:
        assert client.get("/api/site").status_code == 401
        assert client.get("/api/site/totals").status_code == 401
        assert (
            client.post("/api/access/login", json={"name": "anna", "password": PASSWORD}).status_code == 200
        )
        shown = client.get("/api/site").json()
        assert [belt["name"] for belt in shown["belts"]] == ["a"]
        assert belts["a"].key not in client.get("/api/site").text
        for kind in ("hour", "shift", "day"):
            totals = client.get("/api/site/totals", params={"kind": kind, "count": 3}).json()
            assert len(totals["periods"]) == 3
        assert client.get("/api/site/totals", params={"kind": "week"}).status_code == 422
        assert client.get("/").text.startswith("<!doctype html>")
        for name in ("main", "belts", "balances", "alarms", "totals"):
            assert client.get(f"/site/{name}.js").status_code == 200


def find_fault(folder: Path, url: str, key: str, ca: Path | None = None) -> str:
    """Return the key of the fault of reading a belt."""
    (folder / "one.key").write_text(key)
    client = BeltClient(SiteBeltSettings(name="a", url=url, key_file=folder / "one.key", ca=ca))
    try:
        client.read_page()
        client.read_state()
        client.read_records(0, 0)
    except BeltFaultError as error:
        assert "\n" not in error.fault.text
        assert key not in error.fault.text
        return error.fault.key
    finally:
        client.close()
    return ""


def test_what_is_wrong_with_a_belt_is_one_clear_line(belts: dict[str, Belt], tmp_path: Path) -> None:
    belt = belts["a"]
    url = f"http://127.0.0.1:{belt.port}"
    assert find_fault(tmp_path, url, belt.key) == ""
    assert find_fault(tmp_path, url, "another") == "key"
    assert find_fault(tmp_path, f"http://127.0.0.1:{find_port()}", belt.key) == "unreachable"
    assert find_fault(tmp_path, "http://no-such-host.invalid", belt.key) == "unreachable"
    assert find_fault(tmp_path, url.replace("http", "https"), belt.key) == "not_tls"
    belt.stop()
    certificate, private = make_certificate(tmp_path, "belt")
    other, _ = make_certificate(tmp_path, "other")
    belt.tls = {"tls_certificate": certificate, "tls_key": private}
    belt.start()
    secure = url.replace("http", "https")
    assert find_fault(tmp_path, secure, belt.key, certificate) == ""
    assert find_fault(tmp_path, secure, belt.key, other) == "certificate"
    assert find_fault(tmp_path, secure, belt.key) == "certificate"
    assert find_fault(tmp_path, url, belt.key) == "needs_tls"


def test_check_names_every_belt(belts: dict[str, Belt], tmp_path: Path) -> None:
    belts["a"].measure(3)
    warnings: list[str] = []
    site = read_site(write_site(tmp_path, belts, c=f"http://127.0.0.1:{find_port()}"))
    lines = check_site(site, warnings.append)
    assert "3 records" in lines["a"]
    assert "cannot be reached" in lines["c"]
    assert lines["page"] == "127.0.0.1 port 0"
    assert warnings == [f"c: {lines['c']}"]
    for belt in belts.values():
        belt.stop()
    with pytest.raises(InputError, match=r"no belt can be read; a: .*; b: .*; c: "):
        check_site(site)


def test_another_version_is_marked_and_read_nevertheless(
    belts: dict[str, Belt], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from beltscape.site import follower

    monkeypatch.setattr(follower, "__version__", "9.4.0")
    belts["a"].measure(2)
    # A busy machine takes more than a second between two answers, which must raise nothing here.
    with run(write_site(tmp_path, {"a": belts["a"]}, away_s=60)) as (running, show):
        wait_until(lambda: count(running, "a") == 2)
        fault = show("a")["faults"][0]
        assert fault["key"] == "version"
        assert fault["values"]["own"] == "9.4.0"
        assert running.state.take_snapshot()["alarms"] == []


def test_a_foreign_server_is_named(tmp_path: Path) -> None:
    import threading
    from http.server import BaseHTTPRequestHandler, HTTPServer

    class Foreign(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            body = b'{"wall_ms": 1}' if "page" in self.path else b"<html>"
            self.send_response(200 if "nothing" not in self.headers.get("Authorization", "") else 404)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            """Print nothing."""

    with HTTPServer(("127.0.0.1", 0), Foreign) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        url = f"http://127.0.0.1:{server.server_port}"
        assert find_fault(tmp_path, url, "some-key") == "foreign"
        assert find_fault(tmp_path, url, "nothing-here") == "status"
        server.shutdown()
        thread.join()


def test_the_command_checks_a_site_and_names_what_does_not_fit(
    belts: dict[str, Belt], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from beltscape.cli.main import main

    path = write_site(tmp_path, {"a": belts["a"]})
    assert main(["site", str(path), "--check"]) == 0
    assert "0 records" in capsys.readouterr().out
    (tmp_path / "a.key").unlink()
    assert main(["site", str(path), "--check"]) == 2
    error = capsys.readouterr().err
    assert "a.key: the key of belt 'a' cannot be read" in error
    assert error.count("\n") == 1
