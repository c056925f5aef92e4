"""The alarms' one-line details in English; pages in other languages fill their own lines with the same values."""

from __future__ import annotations

import math

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
    "encoder_silent": "no reading for {value}, limit {limit}: check the encoder and its line",
    "encoder_wrong": "its readings are impossible: check wiring and settings",
    "no_measurement": "{subject} is no longer measured: check cameras and belt",
    "certificate_expiring": "it ends in {value}: install a new one",
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
