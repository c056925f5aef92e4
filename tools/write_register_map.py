"""Write the table of registers into docs/howto/modbus.md, between ``registers`` and ``end``.

python tools/write_register_map.py
"""

from __future__ import annotations

import re
from pathlib import Path

from beltscape.protocols.modbus_registers import place_registers
from beltscape.protocols.settings import ModbusSettings

PAGE = Path(__file__).parents[1] / "docs/howto/modbus.md"
_MARKED = re.compile(r"(<!-- registers -->\n).*?(?=<!-- end -->)", re.S)


def fill_page(text: str) -> str:
    """Return the page with the table of the default map."""
    lines = ["| address | name | form | unit | meaning |", "|---|---|---|---|---|"]
    lines += [
        f"| {one.address} | `{one.name}` | {one.form} | {one.unit} | {one.meaning} |"
        for one in place_registers(ModbusSettings())
    ]
    return _MARKED.sub(lambda found: found[1] + "\n".join(lines) + "\n", text)


if __name__ == "__main__":
    PAGE.write_text(fill_page(PAGE.read_text("utf-8")), "utf-8")
