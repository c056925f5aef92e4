"""The cut into pieces: every frame is one piece's own, with enough belt on both sides."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from beltscape.reprocessing.pieces import Overlap, cut_into_pieces, join_recordings
from tests.reprocessing.recordings_made import FRAME_NS, STEP_MM, make_recording
from tests.thorough import examples

OVERLAP = Overlap(lead_in_mm=700.0, lead_out_mm=900.0)


@given(
    lengths=st.lists(st.integers(1, 90), min_size=1, max_size=5),
    most=st.integers(20, 60),
    has_encoder=st.booleans(),
)
@examples(60)
def test_every_frame_is_one_pieces_own(lengths: list[int], most: int, has_encoder: bool) -> None:
    recordings, first = [], 0
    for index, count in enumerate(lengths):
        recordings.append(make_recording(f"r{index}", first, count, has_encoder=has_encoder))
        first += count
    pieces = cut_into_pieces(recordings, OVERLAP, most)
    own = [(piece.recording, one.frame.frame) for piece in pieces for one in piece.own]
    assert own == [(one.name, frame.frame) for one in recordings for frame in one.frames]
    assert all(len(piece.own) <= most for piece in pieces)
    assert len({piece.key for piece in pieces}) == len(pieces)
    for piece in pieces:
        times = [one.frame.time_ns for one in piece.frames]
        assert times == list(range(times[0], times[0] + len(times) * FRAME_NS, FRAME_NS))
    assert [piece.is_continuation for piece in pieces] == [False] + [True] * (len(pieces) - 1)


def test_the_overlap_is_as_long_as_asked_and_reaches_into_other_recordings() -> None:
    one, two = make_recording("a", 0, 50), make_recording("b", 50, 50)
    first, second = cut_into_pieces([one, two], OVERLAP, 100)
    assert len(first.lead_in) == 0
    assert first.lead_out[-1].frame.position_mm == 49 * STEP_MM + OVERLAP.lead_out_mm
    assert first.lead_out[0].place == two.place
    assert (
        second.lead_in[0].frame.position_mm == 50 * STEP_MM - 16 * STEP_MM
    )  # at least the frames of a first motion
    assert second.lead_out == ()


def test_a_pause_a_reset_or_another_clock_ends_a_sequence() -> None:
    base = make_recording("a", 0, 30)
    after_pause = make_recording("b", 60, 30)
    restarted = make_recording("c", 89, 30, clock_ns=10**12)
    assert [len(group) for group in join_recordings([base, after_pause, restarted])] == [1, 1, 1]
    pieces = cut_into_pieces([base, after_pause, restarted], OVERLAP, 100)
    assert [piece.is_continuation for piece in pieces] == [False, False, False]
    assert [piece.previous_mm for piece in pieces] == [None, 29 * STEP_MM, 89 * STEP_MM]


def test_a_reset_encoder_has_no_previous_position() -> None:
    far = make_recording("a", 1000, 30)
    again = make_recording("b", 0, 30, clock_ns=10**12)
    assert cut_into_pieces([far, again], OVERLAP, 100)[1].previous_mm is None


def test_the_key_follows_the_files_and_not_the_other_recordings() -> None:
    def cut(*digests: str):
        recordings = [make_recording(f"r{k}", 50 * k, 50, digest=digest) for k, digest in enumerate(digests)]
        return [piece.key for piece in cut_into_pieces(recordings, OVERLAP, 100)]

    before = cut("a", "b", "c", "d")
    after = cut("a", "b", "c", "changed")
    assert before[:2] == after[:2]
    assert before[2] != after[2]  # its lead-out lies in the changed recording
    assert before[3] != after[3]
    assert cut("a", "b", "c")[:2] == before[:2]


def test_a_standing_belt_does_not_lengthen_a_lead_without_end() -> None:
    still = make_recording("a", 0, 400)
    frames = tuple(type(frame)(frame.frame, frame.time_ns, 7.0, frame.files, {}) for frame in still.frames)
    standing = type(still)(still.name, still.place, frames, None, "x")
    pieces = cut_into_pieces([standing], OVERLAP, 100)
    assert max(len(piece.lead_in) for piece in pieces) == 120
