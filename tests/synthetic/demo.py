"""The capture that ships with the demo, and JSON output of the program."""

from __future__ import annotations

import json
from pathlib import Path

import beltscape

DEMO = Path(beltscape.__file__).parent / "data" / "demo"
TRUE_RIG = DEMO / "truth" / "rig.json"


def parse_json(text: str) -> dict:
    """Parse the single JSON document on standard output."""
    document = json.loads(text)
    assert isinstance(document, dict)
    return document
