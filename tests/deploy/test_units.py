"""The systemd units: valid, and their commands exist."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml

from beltscape.cli.main import main

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
UNITS = sorted([*DEPLOY.glob("*.service"), *DEPLOY.glob("*.timer")])


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_systemd_understands_it(unit, tmp_path):
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("systemd-analyze is not there")
    for one in UNITS:  # the programs themselves need not be installed here
        text = re.sub(r"^(Exec\w+)=\S+", r"\1=/bin/true", one.read_text(), flags=re.MULTILINE)
        (tmp_path / one.name).write_text(text)
    done = subprocess.run(
        [program, "verify", str(tmp_path / unit.name)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    ours = [line for line in done.stderr.splitlines() if "beltscape" in line]
    assert (done.returncode, ours) == (0, [])


class CaseSensitiveParser(configparser.RawConfigParser):
    """A parser that keeps the names of options as they are written, as systemd does."""

    def optionxform(self, optionstr: str) -> str:
        return optionstr


@pytest.mark.parametrize(("unit", "file"), [("beltscape", "project.toml"), ("beltscape-site", "site.toml")])
def test_the_command_it_starts_is_one_of_ours(unit, file, capsys):
    parser = CaseSensitiveParser(strict=False)
    parser.read(DEPLOY / f"{unit}.service")
    program, *arguments = parser["Service"]["ExecStart"].split()
    assert Path(program).name == "beltscape"
    with pytest.raises(SystemExit) as stopped:
        main([arguments[0], "--help"])
    assert stopped.value.code == 0
    assert file in capsys.readouterr().out
    assert parser["Service"]["Type"] == "notify"


@pytest.mark.parametrize(
    ("unit", "key", "command"),
    [("beltscape-backup", "ExecStart", "backup"), ("beltscape", "ExecReload", "reload")],
)
def test_backup_and_reload_are_commands_with_these_options(unit, key, command, capsys):
    parser = CaseSensitiveParser(strict=False)
    parser.read(DEPLOY / f"{unit}.service")
    _, *words = parser["Service"][key].split()
    assert words[0] == command
    with pytest.raises(SystemExit):
        main([command, "--help"])
    options = [word for word in words if word.startswith("--")]
    text = capsys.readouterr().out
    assert all(option in text for option in options)


def test_the_container_runs_the_service_without_rights():
    text = (DEPLOY / "Containerfile").read_text()
    assert re.search(r"^USER beltscape$", text, re.MULTILINE)
    assert re.search(r"^HEALTHCHECK ", text, re.MULTILINE)
    extras = re.search(r"\[([\w,]+)\]\"$", text, re.MULTILINE)
    assert extras is not None
    declared = tomllib.loads((DEPLOY.parent / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    assert set(extras[1].split(",")) <= set(declared)


def test_the_services_of_the_compose_file_have_a_read_only_root():
    services = yaml.safe_load((DEPLOY / "compose.yaml").read_text())["services"]
    assert set(services) == {"beltscape", "proxy"}
    assert all(one["read_only"] for one in services.values())
    assert "127.0.0.1:8460" in (DEPLOY / "Caddyfile").read_text()
