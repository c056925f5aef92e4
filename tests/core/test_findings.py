"""Findings of checks: their effects, combined errors and summaries."""

from __future__ import annotations

from beltscape.core.findings import (
    Finding,
    combine_relative_sigma,
    combine_systematic_mm,
    summarise_faults,
    worst_effect,
)

SOUND = Finding("zero_shift", 0.1, 0.2, 0.5, "mm")
ZERO = Finding("zero_shift", 5.0, 0.2, 0.5, "mm", text="zero is off", effect="degraded", systematic_mm=3.0)
POSE = Finding("camera_pose", 4.0, 0.2, 0.5, "mm", "cam1", "cam1 moved", "missing", 4.0, 0.1)


def test_effect_of_a_frame_is_the_most_severe():
    assert worst_effect([]) == "none"
    assert worst_effect([SOUND, ZERO]) == "degraded"
    assert worst_effect([ZERO, POSE, SOUND]) == "missing"


def test_errors_of_independent_faults_add_in_squares():
    assert combine_systematic_mm([SOUND, ZERO, POSE]) == 5.0
    assert combine_relative_sigma([POSE]) == 0.1
    assert combine_systematic_mm([]) == 0.0


def test_summary_names_each_fault_once_and_the_most_severe_first():
    assert summarise_faults([SOUND, ZERO, POSE, ZERO]) == "cam1 moved; zero is off"
    assert summarise_faults([SOUND]) == ""
