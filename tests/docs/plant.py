"""What the manual's commands of a running plant find: a history, and backups by their real names."""

from __future__ import annotations

from pathlib import Path

from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.docs.blocks import read_blocks
from tests.docs.system import ROOT, demand
from tests.pipeline.certifying.plants import SimulatedPlant
from tests.sinks.ledgers import ledger


def make_history(data: Path) -> None:
    """Write a history of some records, unless there is one."""
    if not (data / "history.db").is_file():
        historian = Historian(data, HistorySettings(reserve_mib=1))
        historian.write(ledger(5))
        historian.close()


def make_tested_history(folder: Path) -> None:
    """Write the history of a zero test and four runs of the folder's project.toml, unless there is a history."""
    if not (folder / "data/history.db").is_file():
        plant = SimulatedPlant(folder, project=folder / "project.toml")
        plant.add_zero(3)
        for load in ("half", "full", "half", "full"):
            plant.add_run(load)
        plant.write_history()


def write_test_file(folder: Path) -> None:
    """Write the material test's file of the manual, as the step writes it of answers, unless there is one."""
    path, page = folder / "material_test.toml", "docs/reference/certificates.md"
    if not path.is_file():
        text = (ROOT / page).read_text()
        blocks = [
            one.text for one in read_blocks(page, text) if one.kind == "toml" and "[[runs]]" in one.text
        ]
        demand(blocks, f"{page}: no test's file")
        path.write_text(blocks[0])


def find_newest(folder: Path, named: str) -> str:
    """Return the newest backup of the form and in the folder that a page names, which has another time."""
    form = "".join(Path(named).suffixes[-2:])
    found = sorted((folder / named).parent.glob(f"*{form}"))
    demand(found, f"no earlier line makes a backup like {named}")
    return str(found[-1].relative_to(folder))
