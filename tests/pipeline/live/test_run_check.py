"""``beltscape run --check``: what cannot be opened is refused in one line before anything is written."""

from __future__ import annotations

import json
import shutil
import socket
from pathlib import Path

import pytest

from tests.synthetic.demo import parse_json

PROJECT = """rig = "rig.json"
empty = "belt.json"
[capture]
folder = "belt"
frames_per_s = 5
[history]
reserve_mib = 1
[web]
port = 0
"""
CAMERAS = """rig = "rig.json"
empty = "belt.json"
[cameras.devices]
cam0 = "a"
cam1 = "b"
"""


@pytest.fixture(scope="module")
def plant_parts(tmp_path_factory, small_demo, small_rig, small_frames) -> Path:
    """rig.json and belt.json of the demo's rig, and a capture of the loaded belt."""
    from beltscape.core.progress import Silent
    from beltscape.pipeline.measuring.belt import measure_empty_belt, write_belt_files

    folder = tmp_path_factory.mktemp("plant")
    shutil.copy(small_rig, folder / "rig.json")
    belt, depth = measure_empty_belt(small_frames / "belt_empty", None, Silent())
    write_belt_files(folder / "belt.json", belt, depth)
    shutil.copytree(small_demo / "belt_loaded", folder / "belt")
    return folder


@pytest.fixture
def plant(tmp_path, plant_parts, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(plant_parts, tmp_path, dirs_exist_ok=True)
    Path("project.toml").write_text(PROJECT)
    return tmp_path


def test_sound_project_has_a_line_for_every_part(run, plant):
    code, out, _ = run("run", "--check", "project.toml", "--json")
    assert code == 0
    parts = parse_json(out)["parts"]
    assert list(parts) == ["rig", "alarms", "density", "empty", "source", "encoder", "data", "page", "users"]
    assert parts["rig"].startswith("3 cameras about cam0")
    assert not Path("data").exists()


def edited(old: str, new: str) -> None:
    path = Path("project.toml")
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def changed(path: str, change) -> None:
    document = json.loads(Path(path).read_text())
    change(document)
    Path(path).write_text(json.dumps(document))


def listening() -> int:
    """A port of this machine that is taken while `taken_ports` lives."""
    _TAKEN.append(socket.create_server(("127.0.0.1", 0)))
    return _TAKEN[-1].getsockname()[1]


def free_port() -> int:
    """A port of this machine that nothing listens at."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        _FREE.append(server.getsockname()[1])
    return _FREE[-1]


_TAKEN: list[socket.socket] = []
_FREE: list[int] = []


@pytest.fixture(autouse=True)
def taken_ports():
    yield
    while _TAKEN:
        _TAKEN.pop().close()


FAULTS = {
    "no capture": (lambda: shutil.rmtree("belt"), "belt: no such folder; a capture is"),
    "no core": (lambda: shutil.rmtree("belt/cam0"), "no images of the core camera cam0"),
    "a file": (lambda: edited('"belt"', '"rig.json"'), "rig.json: is a file; a capture is a folder"),
    "no times": (lambda: edited("frames_per_s = 5\n", ""), "give frames_per_s"),
    "no rig": (lambda: Path("rig.json").unlink(), "rig.json': no such file"),
    "rig cut short": (lambda: Path("rig.json").write_text('{"format"'), "rig.json: not JSON"),
    "rig a folder": (lambda: edited('"rig.json"', '"belt"'), "belt: cannot be read (Is a directory)"),
    "no belt": (lambda: Path("belt.json").unlink(), "belt.json': no such file"),
    "belt not JSON": (lambda: Path("belt.json").write_text("x"), "belt.json: not JSON"),
    "belt a rig": (lambda: shutil.copy("rig.json", "belt.json"), "belt.json: format is 'beltscape-rig/1'"),
    "belt of another rig": (
        lambda: changed("belt.json", lambda d: d["core"].update(focal_px=[9e2, 9e2])),
        "belt.json: its content contradicts its sha256",
    ),
    "density table": (lambda: edited("[web]", '[density]\ntable = "d.csv"\n[web]'), "d.csv: no such file"),
    "density product": (
        lambda: edited("[web]", '[density]\nproducts = "p.toml"\nproduct = "coal"\n[web]'),
        "p.toml: no such file",
    ),
    "density twice": (
        lambda: edited("[web]", '[density]\nkg_m3 = 900\ntable = "d.csv"\n[web]'),
        "in one way only",
    ),
    "encoder table": (
        lambda: edited("[web]", '[encoder]\nkind = "capture"\n[web]'),
        "encoder.csv: no such file",
    ),
    "encoder folder": (
        lambda: edited("[web]", '[encoder]\nkind = "file"\npath = "belt"\n[web]'),
        "belt: ",
    ),
    "encoder host": (
        lambda: edited("[web]", '[encoder]\nkind = "udp"\nhost = "203.0.113.9"\n[web]'),
        "cannot listen at 203.0.113.9",
    ),
    "no TLS": (lambda: edited("port = 0", 'port = 0\nhost = "0.0.0.0"'), "host = '0.0.0.0': without TLS"),
    "certificate": (
        lambda: edited("port = 0", 'port = 0\ntls_certificate = "c.pem"\ntls_key = "k.pem"'),
        "c.pem: the TLS certificate cannot be read",
    ),
    "no such host": (lambda: edited("port = 0", 'port = 0\nhost = "203.0.113.9"'), "host = '203.0.113.9'"),
    "port in use": (lambda: edited("port = 0", f"port = {listening()}"), "another program listens there"),
    "two servers at one port": (
        lambda: edited("port = 0", f"port = {free_port()}\n[modbus]\nport = {_FREE[-1]}"),
        "[modbus] port = ",
    ),
    "two protocols at one port": (
        lambda: edited("port = 0", f"port = 0\n[modbus]\nport = {free_port()}\n[opcua]\nport = {_FREE[-1]}"),
        "is that of [modbus], too; give each server its own",
    ),
    "no IPv4 address": (
        lambda: edited("port = 0", 'port = 0\n[modbus]\nhost = "300.1.2.3"'),
        "modbus.host = '300.1.2.3': is no address; IPv4 has four numbers from 0 to 255",
    ),
    "a port in the host": (
        lambda: edited("port = 0", 'port = 0\n[mqtt]\nhost = "broker:1883"'),
        "mqtt.host = 'broker:1883': is no address; give the port in its own key",
    ),
    "protocol's host": (
        lambda: edited("port = 0", 'port = 0\n[modbus]\nhost = "203.0.113.9"'),
        "[modbus]: host = '203.0.113.9'",
    ),
    "protocol's port in use": (
        lambda: edited("port = 0", f"port = 0\n[opcua]\nport = {listening()}"),
        "another program listens there",
    ),
    "pulses of two kinds": (
        lambda: edited("port = 0", "port = 0\n[modbus]\nport = 0\npulse_kg = 1\npulse_l = 2"),
        "pulse_kg = 1 and pulse_l = 2: there is one of the two, remove the other",
    ),
    "width above the images'": (
        lambda: edited("[web]", "[matching]\nwidth_px = 5000\n[web]"),
        "matching.width_px = 5000: the images are ",
    ),
    "density in t/m³": (
        lambda: edited("[web]", "[density]\nkg_m3 = 1.6\n[web]"),
        "density.kg_m3 = 1.6: cannot be a bulk density in kg/m³ (5 to 30000); in t/m³? write 1600",
    ),
    "a number in quotation marks": (
        lambda: edited("[web]", '[matching]\nload_mm = "300"\n[web]'),
        "matching.load_mm = '300': must be a number, without quotation marks",
    ),
    "data a file": (lambda: edited("[capture]", 'data = "rig.json/data"\n[capture]'), "rig.json is a file"),
    "data read-only": (
        lambda: edited("[capture]", 'data = "/proc/data"\n[capture]'),
        "/proc/data: cannot be",
    ),
    "camera encoder": (
        lambda: Path("project.toml").write_text(CAMERAS + '[encoder]\nkind = "camera"\n'),
        'kind = "camera" needs a table [cameras.encoder]',
    ),
    "unread encoder": (
        lambda: Path("project.toml").write_text(
            CAMERAS + '[cameras.encoder]\nmm_per_count = 0.1\nchunk = "CounterValue"\n'
        ),
        'give [encoder] kind = "camera"',
    ),
    "camera without device": (lambda: Path("project.toml").write_text(CAMERAS), "cam3 has no device"),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("check", [True, False], ids=["check", "run"])
def test_part_that_cannot_be_opened_is_refused_in_one_line(run, plant, fault, check):
    break_it, message = FAULTS[fault]
    break_it()
    if not check and fault == "camera without device":
        message = "cameras"  # where Aravis is missing, that is reported first
    code, out, err = run("run", "project.toml", *(["--check"] if check else []))
    assert code == 2, (out, err)
    assert out == ""
    (line,) = [line for line in err if line.startswith("beltscape: ")]
    assert err[-1] == line
    assert message in line
    assert not Path("data").exists() or not any(Path("data").iterdir())


def test_several_faults_are_named_in_one_line(run, plant):
    shutil.rmtree("belt")
    edited("port = 0", 'port = 0\nhost = "0.0.0.0"')
    edited("[web]", '[density]\ntable = "d.csv"\n[web]')
    code, _, err = run("run", "--check", "project.toml")
    assert code == 2
    assert err[-1].startswith("beltscape: belt: no such folder")
    assert err[-1].endswith("further faults in density, page")


def test_certificates_are_looked_for_beside_the_project(run, plant, monkeypatch, tmp_path_factory):
    edited("port = 0", 'port = 0\ntls_certificate = "c.pem"\ntls_key = "k.pem"')
    Path("c.pem").write_text("nothing")
    Path("k.pem").write_text("nothing")
    project = Path("project.toml").resolve()
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    code, _, err = run("run", "--check", project)
    assert code == 2
    assert f"{project.parent}/c.pem: holds no PEM certificate" in err[-1]


def test_machines_that_do_not_answer_are_warned_of_as_a_run_goes_on_without_them(run, plant):
    ports = [free_port() for _ in range(4)]
    edited(
        "[web]",
        f"""[syslog]
host = "127.0.0.1"
transport = "tcp"
port = {ports[0]}
[outputs]
host = "127.0.0.1"
port = {ports[1]}
pulse = {{l = 5, kind = "counter", address = 0}}
[scale.modbus]
host = "no-such-host.invalid"
port = {ports[2]}
address = 0
[reports.mail]
host = "127.0.0.1"
port = {ports[3]}
security = "none"
sender = "belt@plant.example"
to = ["shift@plant.example"]
[web]""",
    )
    code, out, _ = run("run", "--check", "project.toml", "--json")
    assert code == 0
    answer = parse_json(out)
    for part, place in (
        ("syslog", f"127.0.0.1 port {ports[0]}: "), ("outputs", f"127.0.0.1 port {ports[1]}: "),
        ("scale", "no-such-host.invalid port "), ("reports", f"127.0.0.1 port {ports[3]}: "),
    ):  # fmt: skip
        assert f"; not reached: {place}" in answer["parts"][part]
        assert any(line.startswith(f"{part}: not reached now: {place}") for line in answer["warnings"])


def test_unusual_settings_are_warned_of(run, plant):
    edited("[web]", "[matching]\nload_mm = 10\n[web]")
    code, out, _ = run("run", "--check", "project.toml", "--json")
    assert code == 0
    (warning,) = parse_json(out)["warnings"]
    assert (
        "load_mm = 10: is unusual for the height of a load in mm (20 to 1500); in centimetres? write 100"
        in warning
    )
