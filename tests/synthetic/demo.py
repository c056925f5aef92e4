"""The capture that ships with the demo, and answers of the program about it."""

from __future__ import annotations

import json
from pathlib import Path

import beltscape

DEMO = Path(beltscape.__file__).parent / "data" / "demo"
TRUE_RIG = DEMO / "truth" / "rig.json"


def only_json(text: str) -> dict:
    """The one document on standard output."""
    document = json.loads(text)
    assert isinstance(document, dict)
    return document
