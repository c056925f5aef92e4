"""Texts of alarms: the one-line details in English, and those that the plant's engineer writes.

Pages in other languages fill their own lines with the same values. The plant's own texts are a TOML file beside
project.toml, which is checked when it is read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from beltscape.alarms.settings import require_alarm
from beltscape.core.alarm_catalogue import list_keys
from beltscape.core.checks import is_dict
from beltscape.core.errors import InputError
from beltscape.core.translatable_message import reword
from beltscape.files.toml_text import describe_first_error, read_toml

TEXTS = {
    "overload": "{value}, limit {limit}: slow the feed",
    "empty": "load {value}, limit {limit}: check the feed",
    "belt_stopped": "{value}, limit {limit}: start the belt",
    "oversize_lump": "a lump of {value}, limit {limit}: take it off before the next transfer",
    "misaligned_belt": "{value} off the middle, limit {limit}: align the belt",
    "low_coverage": "{value} of the view measured, limit {limit}: check light and dust, and the other alarms",
    "cameras_off": "no camera of the bank gives an image: check supply, network switch and trigger",
    "camera_lost": "{subject} gives no image: check its power, cable and address",
    "camera_skew": "{value}, limit {limit}: check the trigger line and the cameras' clocks",
    "frames_dropped": "{value}, limit {limit}: lower the frame rate or choose a faster preset",
    "disk_full": "the history is not written: free space on its disk, correct its rights, or close what holds it",
    "history_repaired": "the history was damaged or changed from outside and was repaired: find out by what",
    "users_unreadable": "the users' database cannot be read, nobody can sign in: restore users.db from a backup",
    "reports_failing": "reports are not written, mailed or printed: check printer, mail server and disk",
    "recording_paused": "raw frames are not recorded: free space on their disk",
    "gpu_lost": "the processor matches in its place: look into the system's log for the GPU's fault, and restart",
    "encoder_silent": "no reading for {value}, limit {limit}: check the encoder and its line",
    "encoder_wrong": "its readings are impossible: check wiring and settings",
    "no_measurement": "{subject} is no longer measured: check cameras and belt",
    "certificate_expiring": "it ends in {value}: install a new one",
    "material_test_due": "the certificate ends in {value}: repeat the material test",
    "test_certificate_void": "what it applies to has changed: repeat the material test",
}
"""By alarm, without the subject after the colon of its name. ``value`` and ``limit`` include their unit."""


def format_detail(kind: str, subject: str, value: float, limit: float, unit: str) -> str:
    """Return the fault and the fix in one line."""
    return TEXTS[kind].format(
        subject=subject, value=format_amount(value, unit), limit=format_amount(limit, unit)
    )


def format_over(state: str, value: float, limit: float, unit: str) -> str:
    """Return the line of an alarm whose condition has ended: the present value, and what is left to do."""
    now = (
        f"; now {format_amount(value, unit)}, limit {format_amount(limit, unit)}"
        if math.isfinite(value)
        else ""
    )
    return f"it is over{now}: {'reset it' if state == 'latched' else 'acknowledge it'}"


def format_unknown(value: float, limit: float, unit: str) -> str:
    """Return the line of an alarm that rests on a value that is not measured now."""
    last = f"last {format_amount(value, unit)}, limit {format_amount(limit, unit)}"
    return f"not known now, because the value is not measured ({last}): see to the measurement first"


def format_amount(value: float, unit: str) -> str:
    """Return a value with its unit for a text."""
    if not math.isfinite(value):
        return "unknown"
    size = abs(value)
    digits = 0 if size >= 100 else 1 if size >= 10 else 2
    return f"{value:.{digits}f} {unit}".rstrip()


PLACEHOLDERS = ("value", "limit", "subject", "detail")
"""What a text may contain in braces; detail is the program's own line."""
_PLACEHOLDER = re.compile(r"\{(" + "|".join(PLACEHOLDERS) + r")\}")


def _check_line(text: str) -> str:
    """Return the text; ValueError with the placeholders that exist where it has another one, or two lines."""
    if any(ord(letter) < 32 for letter in text):
        raise ValueError("must be one line")
    rest = _PLACEHOLDER.sub("", text)
    if "{" in rest or "}" in rest:
        names = ", ".join(f"{{{name}}}" for name in PLACEHOLDERS)
        raise ValueError(f"braces may only stand around a placeholder; give one of {names}")
    return text


class AlarmText(BaseModel):
    """The texts of an alarm in one language; empty: the program's own."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    title: Annotated[str, Field(max_length=60), AfterValidator(_check_line)] = ""
    """Its name in the list."""
    detail: Annotated[str, Field(max_length=300), AfterValidator(_check_line)] = ""
    """The fault and what to do; 300 characters fit the page and a syslog message."""


@dataclass(frozen=True, slots=True)
class CustomTexts:
    """Texts by language and alarm; without texts the program's own hold."""

    by_language: Mapping[str, Mapping[str, AlarmText]] = field(
        default_factory=dict[str, Mapping[str, AlarmText]]
    )

    def to_mapping(self) -> dict[str, dict[str, dict[str, str]]]:
        """Return title and detail by language and alarm."""
        return {
            language: {name: {"title": text.title, "detail": text.detail} for name, text in alarms.items()}
            for language, alarms in self.by_language.items()
        }

    def compose_detail(self, name: str, subject: str, value: str, limit: str, detail: str) -> str:
        """Return the English line of an alarm: the engineer's, or ``detail``. The key for translations is kept."""
        texts = self.by_language.get("en", {})
        line = next((texts[key].detail for key in list_keys(name) if key in texts and texts[key].detail), "")
        if not line:
            return detail
        values = {"value": value, "limit": limit, "subject": subject, "detail": detail}
        return reword(detail, _PLACEHOLDER.sub(lambda found: values[found[1]], line))


def read_custom_texts(path: Path) -> CustomTexts:
    """Read the file of texts.

    Raises
    ------
    InputError
        One line that names the file, the key and the fix, where the file cannot be read or a text cannot be used.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; [alarms] texts names it")
    return CustomTexts(
        {language: _check_alarms(path, language, alarms) for language, alarms in read_toml(path).items()}
    )


def _check_alarms(path: Path, language: str, alarms: object) -> dict[str, AlarmText]:
    """Return the texts of one language by alarm."""
    if not is_dict(alarms) or not all(map(is_dict, alarms.values())):
        raise InputError(f"{path}: {language}: give a table for each alarm, such as [{language}.overload]")
    texts: dict[str, AlarmText] = {}
    for name, table in alarms.items():
        try:
            texts[require_alarm(name)] = AlarmText.model_validate(table)
        except ValidationError as error:
            raise InputError(
                f"{path}: [{language}.{name}] {describe_first_error(AlarmText, error)}"
            ) from error
        except ValueError as error:
            raise InputError(f"{path}: [{language}.{name}]: {error}") from error
    return texts
