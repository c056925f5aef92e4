"""Rules for the manual's commands that are not the program's own; a command without a rule fails the page.

What a machine's administrator types is not done to the machine that tests: files are copied below a root of their
own, services, packages and options are held against what is in this repository.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import yaml

from beltscape.files.toml_text import read_toml
from tests.docs.program import unknown_options

ROOT = Path(__file__).resolve().parents[2]
UNITS = {path.name for path in (ROOT / "deploy").iterdir()}

PACKAGES = {
    "gir1.2-aravis-0.8", "aravis-tools", "aravis-tools-cli", "iproute2", "libgirepository1.0-dev", "libcairo2-dev",
    "pkg-config", "gcc", "python3-dev", "python3-gi", "libpango-1.0-0", "libpangoft2-1.0-0", "cups-client",
}  # fmt: skip
"""Debian's, as in bookworm and trixie."""
OPENSSL_REQ = {"-x509", "-newkey", "-pkeyopt", "-nodes", "-days", "-subj", "-addext", "-keyout", "-out"}


class Wrong(Exception):  # noqa: N818
    """A documented command that does not hold; the message says why."""


def demand(holds: object, why: str) -> None:
    if not holds:
        raise Wrong(why)


def make(words: Sequence[str], folder: Path) -> None:
    """The target exists and is listed by ``make help``."""
    for target in words[1:]:
        found = re.search(rf"^{re.escape(target)}:.*##", (ROOT / "Makefile").read_text(), re.M)
        demand(found, f"Makefile has no target {target!r} with a help text")


def sudo(words: Sequence[str], folder: Path) -> None:
    """What it runs has a rule of its own; ``-u USER`` names the service's user."""
    rest = list(words[1:])
    if rest[0] == "-u":
        demand(rest[1] in (ROOT / "deploy/sysusers.conf").read_text().split(), f"no user {rest[1]}")
        rest = rest[2:]
    if rest and rest[0] != "beltscape":
        run_system(rest, folder)


def apt(words: Sequence[str], folder: Path) -> None:
    demand(words[1] == "install", f"apt {words[1]}: only install is known")
    unknown = set(words[2:]) - PACKAGES
    demand(not unknown, f"Debian packages that no test knows: {sorted(unknown)}")


def pip(words: Sequence[str], folder: Path) -> None:
    """It installs the program, with extras that pyproject.toml has."""
    demand(words[1] == "install", f"pip {words[1]}: only install is known")
    extras = read_toml(ROOT / "pyproject.toml")["project"]["optional-dependencies"]
    for before, word in pairwise(words[1:]):
        if "--find-links" in (before, word):
            continue
        found = re.fullmatch(r"beltscape(?:\[([\w,]+)\])?", word)
        demand(found or word == "--upgrade", f"pip install {word}")
        named = set((found[1] or "").split(",")) - {""} if found else set()
        demand(named <= set(extras), f"no such extra in {word}")


def unshare(words: Sequence[str], folder: Path) -> None:
    demand(list(words) == ["unshare", "-n", "bash"], "only a shell in a network of its own is known")


def python(words: Sequence[str], folder: Path) -> None:
    """A module's options are its own; a script is there; a virtual environment can be made."""
    if words[1:3] == ["-m", "venv"]:
        unknown = {word for word in words[3:] if word.startswith("-")} - {"--system-site-packages"}
        demand(not unknown, f"venv: {unknown}")
    elif words[1:3] == ["-m", "pytest"]:
        pytest_call(words[3:])
    elif words[1] == "-m":
        demand(words[2] == "beltscape.sources.fake_genicam", f"module {words[2]}")
        done = subprocess.run(
            [sys.executable, "-m", words[2], "--help"], capture_output=True, text=True, check=False
        )
        demand(done.returncode == 0, done.stderr)
        for word in words[3:]:
            demand(not word.startswith("--") or word in done.stdout, f"{words[2]} has no {word}")
    else:
        demand((ROOT / words[1]).is_file(), f"{words[1]}: no such script")
        script(words[1:], folder)


def pytest_call(words: Sequence[str]) -> None:
    """Options are known, and each test that is named is there."""
    rest = list(words)
    while rest:
        word = rest.pop(0)
        if word == "-k":
            rest.pop(0)
        elif word.startswith("-"):
            demand(word in ("-n0", "-q", "-x"), f"pytest {word}: no rule knows this option")
        else:
            path, _, name = word.partition("::")
            demand((ROOT / path).exists(), f"{path}: no such test file or folder")
            demand(not name or f"def {name}(" in (ROOT / path).read_text(), f"{path} has no test {name}")


def openssl(words: Sequence[str], folder: Path) -> None:
    """Run where there is one; its options are those of ``openssl req``."""
    demand(words[1] == "req", "only openssl req is known")
    unknown = {word for word in words if word.startswith("-")} - OPENSSL_REQ
    demand(not unknown, f"openssl req: {unknown}")
    if shutil.which("openssl"):
        done = subprocess.run(list(words), cwd=folder, capture_output=True, text=True, check=False)
        demand(done.returncode == 0, done.stderr)


def systemctl(words: Sequence[str], folder: Path) -> None:
    """Verbs are systemd's, units are those of ``deploy/``."""
    verb, units = words[1], [word for word in words[2:] if word != "--now"]
    demand(
        verb in ("status", "start", "stop", "restart", "reload", "enable", "daemon-reload"),
        f"systemctl {verb}",
    )
    for unit in units:
        name = unit if "." in unit else f"{unit}.service"
        demand(name in UNITS, f"no unit {name} in deploy/")


def journalctl(words: Sequence[str], folder: Path) -> None:
    parser = argparse.ArgumentParser(exit_on_error=False)
    parser.add_argument("-u", required=True)
    parser.add_argument("-f", action="store_true")
    demand(f"{parser.parse_args(words[1:]).u}.service" in UNITS, "no such unit in deploy/")


def ip(words: Sequence[str], folder: Path) -> None:
    demand(re.fullmatch(r"ip link set \w+ mtu \d+", " ".join(words)), "only an interface's MTU is known")


def sysctl(words: Sequence[str], folder: Path) -> None:
    """A value is the one that ``deploy/sysctl.conf`` sets."""
    if words[1] == "-w":
        lines = (ROOT / "deploy/sysctl.conf").read_text().replace(" ", "").splitlines()
        demand(words[2].replace(" ", "") in lines, f"deploy/sysctl.conf sets another value than {words[2]}")
    else:
        demand(list(words[1:]) == ["--system"], f"sysctl {words[1:]}")


def files(words: Sequence[str], folder: Path) -> None:
    """cd, cp, mkdir, install and chown are done below a root of their own."""
    root = folder / "root"
    here = Path((root / "cwd").read_text()) if (root / "cwd").is_file() else folder
    root.mkdir(exist_ok=True)

    def moved(word: str) -> str:
        return f"{root}{word}" if word.startswith("/") else word

    if words[0] == "cd":
        target = here / moved(words[1])
        demand(target.is_dir(), f"{words[1]}: no such folder")
        (root / "cwd").write_text(str(target))
        return
    if words[0] == "chown":
        demand(words[-2].startswith("beltscape"), f"chown to {words[-2]}")
        return
    if words[0] in ("cp", "install"):
        Path(moved(words[-1])).parent.mkdir(parents=True, exist_ok=True)
    if words[0] == "cp" and words[-1].endswith("/"):
        Path(moved(words[-1])).mkdir(parents=True, exist_ok=True)
    line = " ".join(moved(word) for word in words)
    done = subprocess.run(["sh", "-c", line], cwd=here, capture_output=True, text=True, check=False)
    demand(done.returncode == 0, done.stderr)


def systemd_files(words: Sequence[str], folder: Path) -> None:
    """Users and folders are made by files of ``deploy/`` that an earlier line put in place."""
    kind = words[0].removeprefix("systemd-")
    there = folder / f"root/etc/{kind}.d/beltscape.conf"
    demand(there.is_file(), f"nobody has copied /etc/{kind}.d/beltscape.conf before")
    demand(set(words[1:]) <= {"--create", "beltscape.conf"}, f"{words}")


def systemd_analyze(words: Sequence[str], folder: Path) -> None:
    demand(words[1] == "security" and f"{words[2]}.service" in UNITS, f"{words}")


def sqlite3(words: Sequence[str], folder: Path) -> None:
    """The database is one that the program writes."""
    demand(Path(words[1]).name in ("users.db", "history.db"), f"{words[1]}: not a database of the program")


def script(words: Sequence[str], folder: Path) -> None:
    """A script of this repository has the options that are named."""
    text = (ROOT / words[0]).read_text()
    for word in words[1:]:
        if word.lstrip("[").startswith("--"):
            demand(f'"{word.strip("[]")}"' in text, f"{words[0]} has no {word}")


def sh(words: Sequence[str], folder: Path) -> None:
    demand((ROOT / words[1]).is_file(), f"{words[1]}: no such script")


def rerun(words: Sequence[str], folder: Path) -> None:
    demand(list(words[1:]) == ["analytics", "disable"], f"{words}")


def nc(words: Sequence[str], folder: Path) -> None:
    """A listener for datagrams; tests/protocols/test_syslog_manual.py sends to it where it is installed."""
    demand(words[1] == "-klu" and words[2].isdigit() and len(words) == 3, "only nc -klu PORT is known")


def ray(words: Sequence[str], folder: Path) -> None:
    """Its options are Ray's own."""
    demand(words[1] in ("start", "stop"), f"ray {words[1]}: only start and stop are known")
    unknown = {word.split("=")[0] for word in words[2:]} - {"--head", "--port", "--address"}
    demand(not unknown, f"ray {words[1]}: {unknown}")


def sbatch(words: Sequence[str], folder: Path) -> None:
    """The script is there and is a shell script; what follows are arguments of the command that it runs."""
    (script_at,) = [at for at, word in enumerate(words) if word.startswith("deploy/")]
    done = subprocess.run(
        ["bash", "-n", ROOT / words[script_at]], capture_output=True, text=True, check=False
    )
    demand(done.returncode == 0, done.stderr)
    demand('beltscape reprocess "$@"' in (ROOT / words[script_at]).read_text(), "runs another command")
    demand(
        not unknown_options(["reprocess", *words[script_at + 1 :]]), "options that reprocess does not have"
    )


def podman(words: Sequence[str], folder: Path) -> None:
    """It builds from a file of ``deploy/``, pushes an image, or starts the composed services."""
    demand(words[1] in ("build", "push", "compose"), f"podman {words[1]}")
    if words[1] == "build":
        demand((ROOT / words[words.index("-f") + 1]).is_file(), "no such Containerfile")


def kubectl(words: Sequence[str], folder: Path) -> None:
    """The file is a RayJob whose entry point is a command with the options that it has."""
    demand(list(words[1:3]) == ["apply", "-f"], "only kubectl apply -f is known")
    job = yaml.safe_load((ROOT / words[3]).read_text())
    demand(job["kind"] == "RayJob", "no RayJob")
    command = job["spec"]["entrypoint"].split()
    demand(command[0] == "beltscape" and not unknown_options(command[1:]), "an entry point that does not run")


RULES: dict[str, Callable[[Sequence[str], Path], None]] = {
    "make": make, "sudo": sudo, "apt": apt, "pip": pip, "unshare": unshare, "python": python, "python3": python,
    "openssl": openssl, "systemctl": systemctl, "journalctl": journalctl, "ip": ip, "sysctl": sysctl, "cd": files,
    "cp": files, "install": files, "chown": files, "systemd-sysusers": systemd_files,
    "systemd-tmpfiles": systemd_files, "systemd-analyze": systemd_analyze, "sqlite3": sqlite3,
    "sh": sh, "rerun": rerun, "nc": nc, "ray": ray, "sbatch": sbatch, "podman": podman, "kubectl": kubectl,
}  # fmt: skip
"""Program → its rule."""


def run_system(words: Sequence[str], folder: Path) -> None:
    """Hold a command against its rule.

    Raises
    ------
    Wrong
        Where it does not hold, or no rule knows the program.
    """
    name = words[0].removeprefix("/opt/beltscape/bin/").removeprefix(".venv/bin/")
    demand(name in RULES, f"no rule of tests/docs/system.py covers {words[0]!r}: write one")
    RULES[name](words, folder)
