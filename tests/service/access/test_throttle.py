"""Throttling of guesses and requests, in bounded memory."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from beltscape.service.access.throttle import (
    ACCOUNT,
    ADDRESS,
    MAX_ENTRIES,
    Throttle,
    TokenBuckets,
    normalise_address,
)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def count_guesses(seconds: float, names: int, addresses: int) -> int:
    """Return how many passwords an attacker can try in that time with the shortest waits."""
    clock = Clock()
    throttle = Throttle(clock)
    tries, end = 0, clock.now + seconds
    while clock.now < end:
        pairs = [(f"n{i % names}", f"a{i % addresses}") for i in range(max(names, addresses))]
        waits = [throttle.wait_s(*pair) for pair in pairs]
        for pair, wait_s in zip(pairs, waits, strict=True):
            if wait_s == 0 and throttle.wait_s(*pair) == 0:
                throttle.count_failure(*pair)
                tries += 1
        clock.now += max(min(waits), 0.01)
    return tries


def test_one_address_can_guess_few_passwords_a_day():
    assert count_guesses(86_400, names=1, addresses=1) < 200
    assert count_guesses(86_400, names=50, addresses=1) < 200


def test_many_addresses_can_guess_one_account_slowly_only():
    # no faster than one a minute after the first few
    assert count_guesses(7200, names=1, addresses=100) < 7200 / ACCOUNT.longest_s + 20


def test_delays_grow_to_a_limit():
    assert [ADDRESS.compute_s(n) for n in (0, 9, 10, 11, 12, 30, 10_000)] == [0, 0, 1, 2, 4, 900, 900]


def test_a_known_address_is_not_locked_out():
    throttle = Throttle(Clock())
    throttle.count_success("anna", "desk")
    for i in range(100):
        throttle.count_failure("anna", f"stranger{i}")
    assert throttle.wait_s("anna", "desk") == 0
    assert throttle.wait_s("anna", "elsewhere") > 0


def test_a_login_does_not_reset_its_address():
    """Otherwise the owner of one account could guess the others' passwords without limit."""
    throttle = Throttle(Clock())
    for _ in range(12):
        throttle.count_failure("anna", "desk")
    throttle.count_success("bert", "desk")
    assert throttle.wait_s("carl", "desk") == ADDRESS.compute_s(12)


def test_failures_are_forgotten():
    clock = Clock()
    throttle = Throttle(clock)
    for _ in range(30):
        throttle.count_failure("anna", "desk")
    clock.now += ADDRESS.forget_s + 1
    assert throttle.wait_s("anna", "desk") == 0


def test_memory_is_bounded():
    throttle, buckets = Throttle(Clock()), TokenBuckets(1, 1, Clock())
    for i in range(3 * MAX_ENTRIES):
        throttle.count_failure(f"n{i}", f"a{i}")
        throttle.count_success(f"m{i}", f"b{i}")
        buckets.take(f"k{i}")
    assert len(throttle._failures) == len(throttle._logged_in) == len(buckets._left) == MAX_ENTRIES


@given(
    st.floats(0.5, 100),
    st.integers(1, 50),
    st.lists(st.floats(0, 5, allow_nan=False), min_size=1, max_size=200),
)
def test_a_bucket_never_exceeds_its_rate(rate_hz, burst, pauses):
    clock = Clock()
    buckets = TokenBuckets(rate_hz, burst, clock)
    allowed = 0
    for pause in pauses:
        clock.now += pause
        wait_s = buckets.take("a")
        allowed += wait_s == 0
        assert 0 <= wait_s <= 1 / rate_hz + 1e-9
    assert allowed <= burst + rate_hz * sum(pauses) + 1e-6
    assert buckets.take("b") == 0, "others are not held up"


def test_addresses_are_normalised():
    assert normalise_address("192.0.2.7") == "192.0.2.7"
    assert normalise_address("::ffff:192.0.2.7") == "192.0.2.7"
    assert normalise_address("2001:db8::1") == normalise_address("2001:db8::ffff:1") == "2001:db8::/64"
    assert normalise_address("fe80::1%eth0") == normalise_address("fe80::2")
    assert normalise_address("no address") == "no address"
