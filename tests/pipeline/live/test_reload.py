"""Settings, rig and empty belt of a running plant read again: all that can change changes, or nothing does."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from beltscape.cli.main import main
from beltscape.core.errors import BeltscapeError, InputError, OutputError
from beltscape.core.interfaces import Observers
from beltscape.core.progress import Silent
from beltscape.pipeline.live.assembly import RunOptions, assemble
from beltscape.pipeline.live.event_log import EventLog
from beltscape.service.access import Access
from beltscape.service.changes import AT_ONCE, RESTART, is_of, list_effects
from beltscape.service.live_state import LiveState
from beltscape.service.production.printing import PrintError
from beltscape.service.production.serving import ReportStatus, ServedProduction
from beltscape.service.project import open_project
from beltscape.service.protocols import ServedPlant
from beltscape.service.reload_requests import answer_requests, request_reload
from beltscape.service.reloader import PARTS, CheckedChange, ReloadablePart, RunningPlant, SettingsReloader
from beltscape.service.tls import CertificateExpiry
from tests.service.access.sample_app import CHEAP


@pytest.fixture
def running(plant: Path, tmp_path: Path) -> Iterator[RunningPlant]:
    """The plant, assembled; no frame set has come yet."""
    project, data = open_project(plant), tmp_path / "data"
    live_state = LiveState(project.settings.web)
    assembled = assemble(project, RunOptions(data), Observers([live_state]))
    access = Access(data, project.settings.web.access, CHEAP)
    served = ServedPlant(live_state, assembled.historian, assembled.engine.acknowledge)
    production = ServedProduction(
        assembled.production, assembled.historian, data, live_state.on_message, ReportStatus()
    )
    yield RunningPlant(
        project,
        assembled,
        assembled.parts,
        live_state,
        access,
        CertificateExpiry(None, None),
        served,
        production,
    )
    production.close()
    components = assembled.components
    components.source.close()
    for writer in components.writers:
        writer.close()
    if components.recorder is not None:
        components.recorder.close()
    assembled.close()
    access.close()


@pytest.fixture
def reloader(running: RunningPlant) -> SettingsReloader:
    return SettingsReloader(running, EventLog(running.assembled.historian), Silent())


def rewrite(path: Path, *changes: tuple[str, str], more: str = "") -> None:
    text = path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text + more)


def test_what_can_change_changes_and_the_rest_is_named(
    running: RunningPlant, reloader: SettingsReloader
) -> None:
    path, before = running.project.path, running.parts
    assert (reloader.reload("anna").at_once, running.parts) == ((), before)
    rewrite(
        path,
        ("kg_m3 = 1500", "kg_m3 = 1600"),
        ("load_mm = 150", "load_mm = 150\nworkers = 3"),
        ("port = 0", 'port = 8999\nplant = "Belt 9"\n[web.access]\nbody_max_bytes = 2048'),
        ("reserve_mib = 1", "reserve_mib = 2\ndatabase_days = 3"),
        more="[alarms.overload]\nmass_flow_t_h = 900\n[csv]\nenabled = true\n[queue]\nframes = 5\n",
    )
    found = reloader.find_changes()
    done = reloader.reload("anna", "10.0.0.9")
    assert done == found
    assert {one.key for one in done.at_once} == {
        *("density.kg_m3", "web.plant", "web.access.body_max_bytes", "history.database_days"),
        *("alarms.overload.mass_flow_t_h", "csv.enabled", "queue.frames"),
    }
    assert {one.key for one in done.restart} == {"web.port", "history.reserve_mib", "matching.workers"}
    assert running.live_state.settings.plant == "Belt 9"
    assert running.access.settings.body_max_bytes == 2048
    assert running.assembled.components.board.settings.overload.mass_flow_t_h == 900
    assert running.parts.context.density.at(0)[0] == 1600
    assert (running.project.settings.web.port, running.project.settings.history.reserve_mib) == (0, 1)
    runs = running.assembled.historian.list_runs(5)
    assert [run.number for run in runs] == [2, 1]
    assert runs[0].provenance["settings"] != runs[1].provenance["settings"]
    assert runs[0].provenance["rig"] == runs[1].provenance["rig"]
    (entry,) = [one for one in running.access.audit.read_last(9) if "density.kg_m3" in one]
    assert (entry["who"], entry["density.kg_m3"]) == ("anna", "1500.0 → 1600.0")
    assert set(entry["needs a restart"].split(", ")) == {
        "web.port",
        "history.reserve_mib",
        "matching.workers",
    }
    assert reloader.reload("anna").at_once == ()  # what needs a restart is named again, nothing else


WRONG = (
    ("kg_m3 = 1500", "kg_m3 = -5", "density.kg_m3 = -5"),
    ("[history]", "[history]\nx = 1", "unknown key history.x"),
    ('rig = "rig.json"', 'rig = "none.json"', "no such file"),
    ("kg_m3 = 1500", "kg_m3 = 1500\nproduct = 'coal'", "product goes with products"),
)
"""Text of project.toml, what replaces it, and the refusal."""


def test_what_is_wrong_changes_nothing(running: RunningPlant, reloader: SettingsReloader) -> None:
    path, before = running.project.path, (running.project, running.parts)
    text, board = path.read_text(), running.assembled.components.board
    alarms = board.settings
    for old, new, message in WRONG:
        path.write_text(text)
        rewrite(path, (old, new), ("port = 0", 'port = 0\nplant = "Belt 9"'))
        with pytest.raises(InputError, match=re.escape(message)):
            reloader.reload("anna")
        assert (running.project, running.parts) == before
        assert (board.settings, running.live_state.settings.plant) == (alarms, "")
        assert running.access.audit.read_last(1)[0]["what"] == "settings refused"


def test_a_rig_that_does_not_fit_is_refused_by_name(
    running: RunningPlant, reloader: SettingsReloader
) -> None:
    rig, before = running.project.path.parent / "rig.json", running.parts
    text = rig.read_text()
    document = json.loads(text)
    name = next(name for name in document["cameras"] if name != document["core"])
    rig.write_text(text.replace(f'"{name}"', '"another"'))
    with pytest.raises(InputError, match=r"rig\.json: (has the cameras|.*contradicts its sha256)"):
        reloader.reload("anna")
    rig.write_text(text[: len(text) // 2])
    with pytest.raises(InputError, match=r"rig\.json"):
        reloader.reload("anna")
    assert running.parts is before
    rig.write_text(text.replace("}", "} ", 1))  # the same rig with other bytes
    assert [one.key for one in reloader.reload("anna").at_once] == ["rig"]
    assert running.parts is not before


def test_a_taken_rig_leaves_other_changes_waiting_and_names_what_is_read_with_it(
    running: RunningPlant, reloader: SettingsReloader
) -> None:
    path, rig = running.project.path, running.project.path.parent / "rig.json"
    rewrite(path, ("kg_m3 = 1500", "kg_m3 = 1600"), ("port = 0", 'port = 0\nplant = "Belt 9"'))
    rig.write_text(rig.read_text().replace("}", "} ", 1))
    assert [one.key for one in reloader.reload_rig("anna").at_once] == ["rig"]
    assert running.parts.context.density.at(0)[0] == 1500
    assert running.live_state.settings.plant == ""
    assert {one.key for one in reloader.find_changes().at_once} == {"density.kg_m3", "web.plant"}
    belt = path.parent / "empty/depth.tiff"
    belt.write_bytes(belt.read_bytes() + bytes(1))  # the same belt with other bytes
    rig.write_text(rig.read_text().replace("}", "} ", 1))
    assert {one.key for one in reloader.reload_rig("anna").at_once} == {"rig", "empty"}
    assert {one.key for one in reloader.reload("anna").at_once} == {"density.kg_m3", "web.plant"}


def test_a_part_that_fails_takes_all_changes_back(
    running: RunningPlant, reloader: SettingsReloader, monkeypatch: pytest.MonkeyPatch
) -> None:
    reverted: list[str] = []

    def fail() -> None:
        raise OutputError("[modbus]: the port is taken; choose another")

    def prepare(*_: object) -> CheckedChange:
        return CheckedChange(fail, lambda: reverted.append("last"))

    monkeypatch.setattr("beltscape.service.reloader.PARTS", (*PARTS, ReloadablePart(("watch",), prepare)))
    rewrite(
        running.project.path,
        ("port = 0", 'port = 0\nplant = "Belt 9"'),
        more="[watch]\nstale_s = 5\n[alarms.overload]\nmass_flow_t_h = 900\n",
    )
    before = running.project, running.parts
    with pytest.raises(OutputError, match="the port is taken"):
        reloader.reload("anna")
    assert reverted == ["last"]
    assert (running.project, running.parts) == before
    assert running.live_state.settings.plant == ""
    assert running.assembled.components.board.settings.overload.mass_flow_t_h is None


def test_the_command_asks_the_run_and_reads_its_answer(
    running: RunningPlant, reloader: SettingsReloader, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / "data"

    def answer(_: float) -> None:
        answer_requests(data, reloader)

    rewrite(running.project.path, ("kg_m3 = 1500", "kg_m3 = 1700"))
    found = request_reload(data, wait=answer)
    assert [one["key"] for one in found["at_once"]] == ["density.kg_m3"]
    rewrite(running.project.path, ("kg_m3 = 1700", "kg_m3 = -1"))
    with pytest.raises(InputError, match="greater than 0; the running settings stay as they were"):
        request_reload(data, wait=answer)
    with pytest.raises(OutputError, match="did not answer"):
        request_reload(data, 0.0, wait=lambda _: None)
    assert not list(data.glob("reload-*"))
    with pytest.raises(InputError, match="nothing runs with this data folder"):
        request_reload(tmp_path / "other")
    assert (
        main(["reload", str(running.project.path), "--list"]) == 2
    )  # the whole project is checked here, too
    assert "density.kg_m3 = -1" in capsys.readouterr().err


def test_every_setting_has_one_effect_and_every_table_exists() -> None:
    effects = {one.key: one.effect for one in list_effects()}
    assert len(effects) > 100
    for table in (*AT_ONCE, *RESTART):
        assert any(is_of(key, (table,)) for key in effects), table
    taken = {table for part in PARTS for table in part.tables}
    for key, effect in effects.items():
        assert effect == "restart" or is_of(key, tuple(taken)), key
    for key in ("cameras.exposure_us", "capture.folder", "encoder.kind", "data", "web.port"):
        assert effects[key] == "restart", key
    for key in ("alarms.overload.mass_flow_t_h", "mqtt.host", "web.access.anonymous_role", "matching.preset"):
        assert effects[key] == "at once", key


def test_a_protocol_is_exchanged_alone(running: RunningPlant, reloader: SettingsReloader) -> None:
    calls: list[tuple[str, object]] = []

    class Protocols:
        def exchange(self, name: str, settings: object) -> None:
            calls.append((name, settings))

    pytest.importorskip("pymodbus", reason="pip install 'beltscape[modbus]'")
    running.protocols = Protocols()  # pyrefly: ignore[bad-assignment]
    for part in PARTS:  # preparing alone changes nothing
        part.prepare(running, running.project)
    assert calls == []
    rewrite(running.project.path, more="[modbus]\nport = 15021\n")
    reloader.reload("anna")
    assert [name for name, _ in calls] == ["modbus"]
    assert running.project.settings.modbus is not None
    check_products(running, reloader)


def check_products(running: RunningPlant, reloader: SettingsReloader) -> None:
    path, production = running.project.path, running.assembled.production
    table = '[[products]]\nname = "ore"\ndensity_kg_m3 = 2100\n'
    rewrite(path, ("[density]\nkg_m3 = 1500\n", table))
    assert {one.key for one in reloader.reload("anna").at_once} == {"density.kg_m3", "products"}
    assert (production.tag.product, production.tag.density_kg_m3) == ("ore", 2100)
    rewrite(path, ("2100", "2200"))
    reloader.reload("anna")
    assert production.tag.density_kg_m3 == 2200
    rewrite(path, ('"ore"', '"coal"'))
    with pytest.raises(InputError, match="ore is the present product; make another the present one first"):
        reloader.reload("anna")


def test_reports_and_scale_change_at_once(running: RunningPlant, reloader: SettingsReloader) -> None:
    path, production = running.project.path, running.production
    text = path.read_text()
    assert production.reports is None and production.figures.scale is None
    rewrite(
        path,
        more='[reports]\nfolder = "papers"\n[scale]\nresolution_kg = 7\ncsv = "scale.csv"\nevery_s = 1\n',
    )
    done = reloader.reload("anna")
    assert {one.key.partition(".")[0] for one in done.at_once} == {"reports", "scale"} and done.restart == ()
    first = production.reports
    assert first is not None and first.folder.name == "papers" and first.folder.is_dir()
    assert production.figures.scale is not None and production.figures.scale.resolution_kg == 7
    rewrite(path, ('"papers"', '"others"'), ("resolution_kg = 7", "resolution_kg = 9"))
    assert [one.key for one in reloader.reload("anna").at_once] == ["reports.folder", "scale.resolution_kg"]
    assert production.reports is not None and production.reports.folder.name == "others"
    assert not first._thread.is_alive()  # one thread writes at a time
    assert production.figures.scale.resolution_kg == 9
    path.write_text(text)
    reloader.reload("anna")
    assert production.reports is None and production.figures.scale is None


def test_reports_that_cannot_be_leave_those_that_are(
    running: RunningPlant, reloader: SettingsReloader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, production = running.project.path, running.production
    rewrite(path, more='[reports]\nfolder = "papers"\npdf = true\n')
    reloader.reload("anna")
    before, text = production.reports, path.read_text()
    monkeypatch.setenv("PATH", str(tmp_path))
    rewrite(path, more='printer = "office"\n')
    with pytest.raises(PrintError, match="lp is missing"):
        reloader.reload("anna")
    assert production.reports is before
    (tmp_path / "taken").write_text("a file")
    path.write_text(text.replace('"papers"', f'"{tmp_path / "taken"}"'))
    with pytest.raises(BeltscapeError, match="taken"):  # fails when the folder is made: taken back
        reloader.reload("anna")
    assert production.reports is not None and production.reports.folder.name == "papers"
    assert production.reports._thread.is_alive()
