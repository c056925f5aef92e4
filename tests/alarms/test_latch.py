from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from beltscape.alarms.latch import Delay, Latch, Step

CONDITIONS = st.sampled_from(["on", "off", "between", "unknown"])
SECOND = 1_000_000_000
LOOKS = st.lists(st.tuples(CONDITIONS, st.integers(0, 5)), max_size=60)
ACTS = st.lists(st.one_of(st.tuples(CONDITIONS, st.integers(0, 5)), st.just("acknowledge")), max_size=60)
DELAYS = st.tuples(st.integers(0, 8), st.integers(0, 8))
ALLOWED = {
    ("clear", "raised"),
    ("raised", "acknowledged"),
    ("raised", "gone"),
    ("raised", "clear"),
    ("acknowledged", "clear"),
    ("gone", "raised"),
    ("gone", "clear"),
}


def delays(seconds):
    return tuple(Delay(value * SECOND) for value in seconds)


def look(latch, condition, seconds, waits, wall_ns=7, latched=True):
    return latch.look(condition, Step(seconds * SECOND), delays(waits), wall_ns, latched=latched)


@given(ACTS, DELAYS, st.booleans())
def test_only_the_steps_of_the_drawing_are_made(acts, waits, latched):
    latch = Latch()
    for act in acts:
        before = latch.state
        changed = (
            latch.acknowledge("ada") if act == "acknowledge" else look(latch, *act, waits, latched=latched)
        )
        assert changed == (latch.state != before)
        if changed:
            assert (before, latch.state) in ALLOWED
            assert latched or latch.state != "gone"
        assert (latch.since_ns is None) == (latch.state == "clear")
        assert (latch.by == "ada") == (latch.state == "acknowledged")


@given(ACTS, DELAYS)
def test_what_is_unknown_or_between_changes_nothing_at_that_look(acts, waits):
    latch = Latch()
    for act in acts:
        if act == "acknowledge":
            latch.acknowledge("ada")
            continue
        before = latch.state
        look(latch, *act, waits)
        if act[0] in ("unknown", "between"):
            assert latch.state == before
        if act[0] == "on":
            assert latch.state not in ("clear", "gone") or before == latch.state
        if act[0] == "off":
            assert latch.state != "raised" or before == "raised"


@given(LOOKS, DELAYS, st.integers(1, 4))
def test_looking_more_often_in_between_tells_the_same(looks, waits, parts):
    """A look that is split into several of the same condition ends in the same state."""
    few, many = Latch(), Latch()
    before = "unknown"
    for condition, seconds in looks:
        look(few, condition, seconds, waits)
        if condition == before:  # while it lasts, one may look in between
            for _ in range(parts - 1):
                many.look(condition, Step(seconds * SECOND // parts), delays(waits), 7, latched=True)
            rest = seconds * SECOND - (parts - 1) * (seconds * SECOND // parts)
            many.look(condition, Step(rest), delays(waits), 7, latched=True)
        else:
            look(many, condition, seconds, waits)
        before = condition
        assert few.state == many.state


@given(LOOKS, st.integers(1, 8), st.integers(0, 8))
def test_at_most_one_raise_per_delay(looks, on_s, off_s):
    latch = Latch()
    raises, passed = 0, 0
    for condition, seconds in looks:
        passed += seconds
        changed = look(latch, condition, seconds, (on_s, off_s), latched=False)
        raises += changed and latch.state == "raised"
    assert raises <= passed // on_s


@given(st.integers(1, 20))
def test_it_is_raised_when_the_delay_is_over_and_not_before(wait):
    latch = Latch()
    states = [latch.state for second in range(wait + 2) if look(latch, "on", 1, (wait, 0)) or True]
    assert states.index("raised") == wait  # the first look only starts the delay


def test_a_break_starts_the_delay_anew_but_not_knowing_does_not():
    for between, state in (("off", "clear"), ("between", "clear"), ("unknown", "raised")):
        latch = Latch()
        for condition in ("on", "on", between, "on", "on"):
            look(latch, condition, 1, (2, 0))
        assert latch.state == state


def test_between_two_looks_that_say_the_same_it_was_so():
    """A value that is measured every ten seconds, looked at every second."""
    latch = Latch()
    for condition in ("on", *["unknown"] * 9, "between", *["unknown"] * 9, "on", *["unknown"] * 9):
        look(latch, condition, 1, (5, 5))
        assert latch.state == "clear"
    look(latch, "on", 1, (5, 5))
    assert latch.state == "raised"
    for condition in ("off", *["unknown"] * 9):
        look(latch, condition, 1, (5, 5))
        assert latch.state == "raised"
    look(latch, "off", 1, (5, 5))
    assert latch.state == "gone"


def test_millimetres_and_seconds_must_both_have_passed():
    latch = Latch()
    wait = (Delay(2 * SECOND, 100.0), Delay(0, 50.0))
    for step in (Step(), Step(5 * SECOND, 0.0), Step(0, 99.0)):
        latch.look("on", step, wait, 1, latched=True)
    assert latch.state == "clear"
    latch.look("on", Step(0, 1.0), wait, 1, latched=True)
    assert latch.state == "raised"
    for step in (Step(), Step(3600 * SECOND, 0.0)):
        latch.look("off", step, wait, 1, latched=True)
    assert latch.state == "raised"
    latch.look("off", Step(0, 50.0), wait, 1, latched=True)
    assert latch.state == "gone"


@given(st.sampled_from([0, 3]))
def test_acknowledging(off_s):
    latch = Latch()
    assert not latch.acknowledge("ada")
    look(latch, "on", 0, (0, off_s), wall_ns=5)
    assert latch.acknowledge("ada")
    assert not latch.acknowledge("bob")
    assert (latch.state, latch.by, latch.since_ns) == ("acknowledged", "ada", 5)
    look(latch, "off", 0, (0, off_s))
    look(latch, "off", off_s, (0, off_s))
    assert latch.state == "clear"


def test_one_that_is_gone_and_comes_back_must_be_seen_again():
    latch = Latch()
    look(latch, "on", 0, (0, 0), wall_ns=1)
    look(latch, "off", 1, (0, 0), wall_ns=2)
    assert (latch.state, latch.since_ns) == ("gone", 1)
    look(latch, "on", 1, (0, 0), wall_ns=3)
    assert (latch.state, latch.since_ns) == ("raised", 3)
    look(latch, "off", 1, (0, 0))
    assert latch.acknowledge("ada")
    assert latch.state == "clear"
