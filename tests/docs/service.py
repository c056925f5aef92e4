"""The running system that a page's ``curl`` lines ask, in a process of its own."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Generator, Sequence
from pathlib import Path

from tests.docs.system import demand

ADDRESS = "http://127.0.0.1:8460"
"""Of the page, as the manual has it."""
START_S = 120
"""Longest wait for the first record, on a machine with other work."""


@contextlib.contextmanager
def run_service(project: Path) -> Generator[str]:
    """Run the system until the context ends; yield the address of its page, once it has written a record."""
    log = project.parent / "run.log"
    code = "import sys; from beltscape.cli.main import main; sys.exit(main())"
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with log.open("w") as output:
        process = subprocess.Popen(
            [sys.executable, "-c", code, "run", project.name],
            cwd=project.parent, stdout=output, stderr=subprocess.STDOUT, env=environment,
        )  # fmt: skip
    try:
        yield wait_for_records(log, process)
    finally:
        process.terminate()
        process.wait(START_S)


def wait_for_records(log: Path, process: subprocess.Popen[bytes]) -> str:
    """Return the page's address once the totals count a record."""
    end = time.monotonic() + START_S
    while time.monotonic() < end:
        demand(process.poll() is None, f"the run has ended: {log.read_text()[-400:]}")
        _, _, rest = log.read_text().partition("the page is at ")
        if rest:
            address = rest.split()[0]
            if "beltscape_records_total 0" not in fetch(f"{address}/metrics"):
                return address
        time.sleep(0.2)
    demand(False, f"no record after {START_S} s: {log.read_text()[-400:]}")
    return ""


def fetch(address: str) -> str:
    """Return what an address answers."""
    try:
        with urllib.request.urlopen(address, timeout=10) as response:
            return response.read().decode()
    except urllib.error.HTTPError as error:
        demand(False, f"{address}: status {error.code}")
        return ""


def curl(words: Sequence[str], address: str) -> str:
    """Return what the page answers to a ``curl`` line of the manual."""
    demand(list(words[1:-1]) in (["-s"], []), f"curl {words[1:-1]}: no rule knows these options")
    demand(words[-1].startswith(ADDRESS), f"{words[-1]} is not an address of the page at {ADDRESS}")
    return fetch(words[-1].replace(ADDRESS, address))
