"""The finding of the check of the encoder against the material."""

from __future__ import annotations

import math

from beltscape.core.live.findings import Finding
from beltscape.core.live.translatable_message import Message
from beltscape.measure.flow.motion.belt_motion import BeltPosition
from beltscape.measure.flow.motion.encoder_check import EncoderCheck, Kind

CHECK = "encoder_motion"
_TEXTS: dict[Kind, str] = {
    "still": "the encoder stands still while the material moves: check its wheel and its cable",
    "standing": "the encoder counts while the material stands still: check its wheel, and the images for frozen ones",
    "reversed": "the encoder counts against the material's motion: exchange its channels A and B",
    "scale": "encoder and material move by different lengths: check the wheel for slip and jumps, and mm_per_count",
    "jump": "the encoder's reading jumps: check its supply and its cable",
    "unmatched": "the material is not where the encoder predicts it: check the wheel and its cable",
    "silent": "the encoder gives no more readings: check its supply and its cable",
    "resumed": "the encoder stood still while the empty belt went on: check its wheel and its cable",
}
_SLIP = 0.002
"""Slow slip that is named although it is within the tolerance: calibrated rigs measure lengths within 0.0005."""
_SIGMAS = 3.0
"""Number of σ by which slip must differ from 0 to be named; most of σ is a bias, not noise with its tails."""
_NAN = float("nan")


def make_encoder_finding(check: EncoderCheck, before: BeltPosition | None, place: BeltPosition) -> Finding:
    """Return the finding of a frame at a position; ``before`` is that of the frame before."""
    is_measured = place.source == "material"
    step = 0.0 if before is None else abs(place.position_mm - before.position_mm)
    relative_sigma = min(1.0, place.sigma_mm / max(step, 1.0))
    contradiction = check.contradiction
    if contradiction is None:
        value, sigma = check.deviation if is_measured else (_NAN, _NAN)
        return Finding(CHECK, value, sigma, check.tolerance, "", text=_describe_slip(value, sigma))
    value, sigma = check.deviation
    if math.isnan(value):  # too few intervals since the contradiction
        value, sigma = contradiction.value, contradiction.sigma
    source = "the material" if is_measured else "the material's last speed"
    return Finding(
        CHECK,
        value,
        sigma,
        check.tolerance,
        "",
        text=Message(
            f"{_TEXTS[contradiction.kind]}; the metres are counted by {source}",
            f"encoder_{contradiction.kind}",
        ),
        effect="degraded",
        relative_sigma=0.0 if is_measured else relative_sigma,
    )


def make_stall_finding(encoder_mm: float, tolerance: float) -> Finding:
    """Return the finding of a frame that shows the material where it was, while the encoder counted ``encoder_mm``.

    Either the images repeat, or the belt stands and the encoder is wrong: the frame is not measured, and its belt is
    missing unless other frames show it.
    """
    metres = round(encoder_mm / 1000, 2)
    text = Message(
        f"the encoder counts {metres:.2f} m while the material stands still (0.00 m), and it is not known which is "
        "right: restart cameras that repeat their images, or check the encoder's wheel",
        "encoder_stalled",
        metres=metres,
    )
    return Finding(CHECK, 100.0, _NAN, tolerance, "", text=text, effect="missing", is_momentary=True)


def _describe_slip(value: float, sigma: float) -> str:
    """Return the text of slow slip, which harms no record as long as it is within the tolerance."""
    if not abs(value) > max(_SLIP, _SIGMAS * sigma):
        return ""
    share, spread = round(100 * value, 2), round(100 * sigma, 2)
    return Message(
        f"over the last metres the encoder counts {share:+.2f} ± {spread:.2f} % against the material: the belt slips "
        "on the wheel, the wheel wears, or mm_per_count is wrong",
        "encoder_slip",
        slip=share,
        sigma=spread,
    )
