"""Write the table of nodes into docs/howto/opcua.md, between ``nodes`` and ``end``.

python tools/write_opcua_nodes.py
"""

from __future__ import annotations

import re
from pathlib import Path

from beltscape.protocols.opcua.belt import FACTS
from beltscape.protocols.opcua.quantities import QUANTITIES, RECORD_QUANTITIES

PAGE = Path(__file__).parents[1] / "docs/howto/opcua.md"
_MARKED = re.compile(r"(<!-- nodes -->\n).*?(?=<!-- end -->)", re.S)


def fill_page(text: str) -> str:
    """Return the page with the table of all nodes that have a value."""
    nodes = [(one.path, one.unit, one.text) for one in (*QUANTITIES, *RECORD_QUANTITIES)]
    nodes += [(path, "", meaning) for path, _, _, meaning in FACTS]
    lines = ["| node below `Belt.` | unit | value |", "|---|---|---|"]
    lines += [f"| `{path.removeprefix('Belt.')}` | {unit} | {meaning} |" for path, unit, meaning in nodes]
    return _MARKED.sub(lambda found: found[1] + "\n".join(lines) + "\n", text)


if __name__ == "__main__":
    PAGE.write_text(fill_page(PAGE.read_text("utf-8")), "utf-8")
