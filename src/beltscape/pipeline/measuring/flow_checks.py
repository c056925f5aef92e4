"""Checks of the given direction and the encoder against the material's measured motion."""

from __future__ import annotations

from pathlib import Path

from beltscape.core.errors import MeasureError
from beltscape.core.progress import Reporter
from beltscape.measure.flow.meter import BeltFlowMeter
from beltscape.measure.flow.motion_evidence import LEAST_PAIRS, MotionEvidence

_EARLY_PAIRS = 8
"""Number of contradicting pairs that ends a measurement before its last frame."""
_CONSTANT = 0.1
"""A wrong scale or unit gives the same ratio in every pair; registrations by chance scatter by more than this."""
_CONSTANT_APART = 0.03
"""Least number where the encoder excludes an overlap of the two views, so that chance is likelier."""
_FIX = "correct it, or leave --encoder out to measure by the material alone"
_STANDING = 0.02
"""An encoder whose steps are below this share of the material's, and scatter, stands still and jitters."""
_UNITS = {0.001: "metres", 0.01: "decimetres", 0.1: "centimetres", 10.0: "tenths of a millimetre",
          1000.0: "micrometres", 1 / 25.4: "inches"}  # fmt: skip
"""Unit of an encoder by the ratio of its steps to the material's in mm."""
_UNIT_WITHIN = 0.1
"""Relative deviation up to which a ratio is recognised as a unit's."""
_NAMES = {1: "+y", -1: "-y"}


def require_consistent_motion(
    meter: BeltFlowMeter, given: str | None, encoder: Path | None, *, done: bool
) -> None:
    """Refuse a direction or an encoder that most frame pairs contradict.

    Before the end (not ``done``) more pairs are required; a belt that rolls back at the start is no contradiction.

    Raises
    ------
    MeasureError
        One line with the number of contradicting pairs and the fix.
    """
    least = LEAST_PAIRS if done else _EARLY_PAIRS
    message = _direction_error(meter, given, encoder, least) or _encoder_error(meter.evidence, encoder, least)
    if message is not None:
        raise MeasureError(message)


def warn_of_motion_conflicts(meter: BeltFlowMeter, encoder: Path | None, reporter: Reporter) -> None:
    """Warn of contradictions in a minority of frame pairs and of a small error of the encoder's scale."""
    scale, evidence = meter.scale, meter.evidence
    if scale.compared >= LEAST_PAIRS and abs(scale.ratio - 1) > max(0.002, 4 * scale.sigma):
        reporter.warn(
            f"{encoder}: the encoder counts {scale.ratio:.4f} ± {scale.sigma:.4f} of what the material moves: "
            "correct its scale, or the belt slips; the material's motion was used"
        )
    if evidence.conflicting:
        reporter.warn(
            f"{encoder}: in {evidence.conflicting} of {evidence.compared} frame pairs encoder and material differ "
            f"by over a quarter ({_kinds(evidence)}); {_describe_used(evidence)}"
        )
    elif encoder is None and (against := evidence.along(-meter.direction or -1)) and meter.direction:
        reporter.warn(
            f"the material moved against {_NAMES[meter.direction]} in {against} of {evidence.moving} frame pairs: "
            "the belt ran back there, and what passed twice is counted once"
        )


def describe_motion(meter: BeltFlowMeter, given: str | None) -> str:
    """Return a clause that states the direction and its evidence."""
    evidence, direction = meter.evidence, meter.direction
    if not direction:
        return "direction unknown: no frame pair shows material that moves"
    name = _NAMES[direction]
    if not evidence.moving:
        return f"towards {name}" + (" as given; no frame pair shows it" if given else "")
    share = f"in {evidence.along(direction)} of {evidence.moving} frame pairs"
    return f"towards {name}" + (
        f" as given and as the material moves {share}" if given else f": so the material moves {share}"
    )


def _direction_error(meter: BeltFlowMeter, given: str | None, encoder: Path | None, least: int) -> str | None:
    evidence, direction = meter.evidence, meter.direction
    if not direction:
        return None
    against = evidence.along(-direction)
    if encoder is not None:  # a belt that rolls back takes its encoder along
        against = min(against, evidence.opposite)
    if against < least or against <= 2 * evidence.along(direction):
        return None
    name, measured = _NAMES[direction], _NAMES[-direction]
    shown = f"the material moves towards {measured} in {evidence.along(-direction)} of {evidence.moving} frame pairs"
    if given is None:
        return f"direction {name}, measured in the first frames: {shown}; pass --direction {measured}"
    return f"--direction {given}: {shown}; leave the option out or pass --direction {measured}"


def _encoder_error(evidence: MotionEvidence, encoder: Path | None, least: int) -> str | None:
    if encoder is None:
        return None
    if evidence.apart >= least and evidence.apart > 2 * evidence.agreeing:
        if evidence.apart_ratios.spread < _CONSTANT_APART:
            return _scale_error(encoder, evidence.apart_ratios.median, f"in {evidence.apart} frame pairs")
        return None
    if evidence.conflicting < least or evidence.conflicting <= 2 * evidence.agreeing:
        return None
    pairs = f"in {evidence.conflicting} of {evidence.compared} frame pairs"
    if evidence.still > evidence.conflicting / 2:
        return f"{encoder}: the encoder counts on while the material stands still {pairs}; {_FIX}"
    if evidence.ratios.spread < _CONSTANT:
        return _scale_error(encoder, evidence.ratios.median, pairs)
    if abs(evidence.ratios.median) < _STANDING:
        return f"{encoder}: the encoder stands still while the material moves {pairs}; {_FIX}"
    return f"{encoder}: encoder and material differ by over a quarter {pairs} ({_kinds(evidence)}); {_FIX}"


def _scale_error(encoder: Path, ratio: float, pairs: str) -> str:
    unit = next((name for unit, name in _UNITS.items() if abs(ratio / unit - 1) < _UNIT_WITHIN), None)
    cause = f"it looks like {unit} and must be in mm" if unit else "its scale or its unit is wrong"
    return f"{encoder}: belt_position_mm grows by {ratio:.4g} of what the material moves {pairs}: {cause}; {_FIX}"


def _describe_used(evidence: MotionEvidence) -> str:
    """Return whose motion was used in the conflicting pairs."""
    by_material = evidence.conflicting - evidence.by_encoder
    if not evidence.by_encoder:
        return "the material's motion was used"
    chance = "there what the images show is no certain motion"
    if not by_material:
        return f"the encoder's motion was used: {chance}"
    return (
        f"the material's motion was used in {by_material}, the encoder's in {evidence.by_encoder}: {chance}"
    )


def _kinds(evidence: MotionEvidence) -> str:
    counts = {
        "against its direction": evidence.opposite,
        "material still": evidence.still,
        "encoder nearly still": evidence.encoder_still,
        "other length": evidence.other_scale,
    }
    return ", ".join(f"{count} {name}" for name, count in counts.items() if count)
