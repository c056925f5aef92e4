"""The state machine of one alarm: allowed transitions, delays, acknowledgement."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from beltscape.alarms.state_machine import AlarmDelay, AlarmStateMachine, Elapsed

CONDITIONS = st.sampled_from(["on", "off", "between", "unknown"])
SECOND = 1_000_000_000
UPDATES = st.lists(st.tuples(CONDITIONS, st.integers(0, 5)), max_size=60)
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


def delays(seconds: tuple[int, int]) -> tuple[AlarmDelay, AlarmDelay]:
    on, off = seconds
    return AlarmDelay(on * SECOND), AlarmDelay(off * SECOND)


def update(machine, condition, seconds, waits, wall_ns=7, latched=True):
    return machine.update(condition, Elapsed(seconds * SECOND), delays(waits), wall_ns, latched=latched)


@given(ACTS, DELAYS, st.booleans())
def test_state_machine_makes_only_allowed_transitions(acts, waits, latched):
    machine = AlarmStateMachine()
    for act in acts:
        before = machine.state
        if act == "acknowledge":
            changed = machine.acknowledge("ada")
        else:
            condition, seconds = act
            changed = update(machine, condition, seconds, waits, latched=latched)
        assert changed == (machine.state != before)
        if changed:
            assert (before, machine.state) in ALLOWED
            assert latched or machine.state != "gone"
        assert (machine.since_ns is None) == (machine.state == "clear")
        assert (machine.by == "ada") == (machine.state == "acknowledged")


@given(ACTS, DELAYS)
def test_unknown_or_between_changes_nothing_at_that_update(acts, waits):
    machine = AlarmStateMachine()
    for act in acts:
        if act == "acknowledge":
            machine.acknowledge("ada")
            continue
        before = machine.state
        condition, seconds = act
        update(machine, condition, seconds, waits)
        if condition in ("unknown", "between"):
            assert machine.state == before
        if condition == "on":
            assert machine.state not in ("clear", "gone") or before == machine.state
        if condition == "off":
            assert machine.state != "raised" or before == "raised"


@given(UPDATES, DELAYS, st.integers(1, 4))
def test_more_frequent_updates_end_in_the_same_state(updates, waits, parts):
    """A update that is split into several of the same condition ends in the same state."""
    few, many = AlarmStateMachine(), AlarmStateMachine()
    before = "unknown"
    for condition, seconds in updates:
        update(few, condition, seconds, waits)
        if condition == before:  # while it lasts, one may update in between
            for _ in range(parts - 1):
                many.update(condition, Elapsed(seconds * SECOND // parts), delays(waits), 7, latched=True)
            rest = seconds * SECOND - (parts - 1) * (seconds * SECOND // parts)
            many.update(condition, Elapsed(rest), delays(waits), 7, latched=True)
        else:
            update(many, condition, seconds, waits)
        before = condition
        assert few.state == many.state


@given(UPDATES, st.integers(1, 8), st.integers(0, 8))
def test_alarm_is_raised_at_most_once_per_delay(updates, on_s, off_s):
    machine = AlarmStateMachine()
    raises, passed = 0, 0
    for condition, seconds in updates:
        passed += seconds
        changed = update(machine, condition, seconds, (on_s, off_s), latched=False)
        raises += changed and machine.state == "raised"
    assert raises <= passed // on_s


@given(st.integers(1, 20))
def test_alarm_is_raised_exactly_at_the_end_of_its_delay(wait):
    machine = AlarmStateMachine()
    states = [machine.state for second in range(wait + 2) if update(machine, "on", 1, (wait, 0)) or True]
    assert states.index("raised") == wait  # the first update only starts the delay


def test_break_restarts_the_delay_and_unknown_does_not():
    for between, state in (("off", "clear"), ("between", "clear"), ("unknown", "raised")):
        machine = AlarmStateMachine()
        for condition in ("on", "on", between, "on", "on"):
            update(machine, condition, 1, (2, 0))
        assert machine.state == state


def test_condition_lasts_between_two_equal_updates():
    """A value that is measured every ten seconds, looked at every second."""
    machine = AlarmStateMachine()
    for condition in ("on", *["unknown"] * 9, "between", *["unknown"] * 9, "on", *["unknown"] * 9):
        update(machine, condition, 1, (5, 5))
        assert machine.state == "clear"
    update(machine, "on", 1, (5, 5))
    assert machine.state == "raised"
    for condition in ("off", *["unknown"] * 9):
        update(machine, condition, 1, (5, 5))
        assert machine.state == "raised"
    update(machine, "off", 1, (5, 5))
    assert machine.state == "gone"


def test_delay_needs_both_millimetres_and_seconds():
    machine = AlarmStateMachine()
    wait = (AlarmDelay(2 * SECOND, 100.0), AlarmDelay(0, 50.0))
    for step in (Elapsed(), Elapsed(5 * SECOND, 0.0), Elapsed(0, 99.0)):
        machine.update("on", step, wait, 1, latched=True)
    assert machine.state == "clear"
    machine.update("on", Elapsed(0, 1.0), wait, 1, latched=True)
    assert machine.state == "raised"
    for step in (Elapsed(), Elapsed(3600 * SECOND, 0.0)):
        machine.update("off", step, wait, 1, latched=True)
    assert machine.state == "raised"
    machine.update("off", Elapsed(0, 50.0), wait, 1, latched=True)
    assert machine.state == "gone"


@given(st.sampled_from([0, 3]))
def test_alarm_is_acknowledged_once(off_s):
    machine = AlarmStateMachine()
    assert not machine.acknowledge("ada")
    update(machine, "on", 0, (0, off_s), wall_ns=5)
    assert machine.acknowledge("ada")
    assert not machine.acknowledge("bob")
    assert (machine.state, machine.by, machine.since_ns) == ("acknowledged", "ada", 5)
    update(machine, "off", 0, (0, off_s))
    update(machine, "off", off_s, (0, off_s))
    assert machine.state == "clear"


def test_alarm_that_returns_must_be_acknowledged_again():
    machine = AlarmStateMachine()
    update(machine, "on", 0, (0, 0), wall_ns=1)
    update(machine, "off", 1, (0, 0), wall_ns=2)
    assert (machine.state, machine.since_ns) == ("gone", 1)
    update(machine, "on", 1, (0, 0), wall_ns=3)
    assert (machine.state, machine.since_ns) == ("raised", 3)
    update(machine, "off", 1, (0, 0))
    assert machine.acknowledge("ada")
    assert machine.state == "clear"
