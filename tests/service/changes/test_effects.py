"""The manual says of every setting when a change takes effect, and says it as the program does."""

from __future__ import annotations

import re
from pathlib import Path

from beltscape.service.changes import AT_ONCE, RESTART, find_effect, list_effects

PAGE = Path(__file__).resolve().parents[3] / "docs" / "howto" / "change_without_stop.md"


def read_rows() -> list[tuple[list[str], str]]:
    """Return the keys of each row of the manual's table, and its text."""
    table = PAGE.read_text("utf-8").partition("<!-- effects -->")[2].partition("\n\n")[0]
    rows = [line.split("|")[1:3] for line in table.splitlines() if line.startswith("| `")]
    return [(re.findall(r"`([\w.]+)`", keys), text.strip()) for keys, text in rows]


def test_the_manual_names_every_setting_with_its_effect() -> None:
    rows = read_rows()
    stated = {key: text for keys, text in rows for key in keys}
    for one in list_effects():
        parts = one.key.split(".")
        named = [".".join(parts[:n]) for n in range(len(parts), 0, -1) if ".".join(parts[:n]) in stated]
        assert named, one.key
        assert stated[named[0]].startswith(one.effect), one.key


def test_the_manual_names_no_other() -> None:
    keys = {key for keys, _ in read_rows() for key in keys}
    assert {*AT_ONCE, *RESTART} <= keys | {"web.limits"}
    for key in keys:
        assert find_effect(key) in ("at once", "restart")
