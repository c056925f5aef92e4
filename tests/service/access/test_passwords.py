"""Password hashes, and the rules for new passwords."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.errors import InputError
from beltscape.service.access import passwords
from beltscape.service.access.passwords import (
    ScryptCost,
    hash_password,
    make_unmatched_hash,
    validate_password,
    verify_password,
)
from tests.thorough import examples

CHEAP = ScryptCost(log2_n=4, r=8, p=1)


@given(st.text(max_size=40), st.text(max_size=40))
@examples(30)
def test_only_the_same_password_is_accepted(one, other):
    kept = hash_password(one, CHEAP)
    assert verify_password(one, kept)
    if other != one:
        import unicodedata

        same = unicodedata.normalize("NFKC", one) == unicodedata.normalize("NFKC", other)
        assert verify_password(other, kept) == same


def test_hashes_are_salted_and_hide_the_password():
    kept = {hash_password("coal on the belt", CHEAP) for _ in range(4)}
    assert len(kept) == 4
    assert not any("coal" in one for one in kept)
    assert all(re.fullmatch(r"scrypt\$4\$8\$1\$[\w+/]{22}==\$[\w+/]{43}=", one) for one in kept)


def test_an_unmatched_hash_costs_as_much_as_that_of_a_password(monkeypatch):
    costs = []
    scrypt = passwords.hashlib.scrypt

    def count(*given, n, r, p, **more):
        costs.append((n, r, p))
        return scrypt(*given, n=n, r=r, p=p, **more)

    monkeypatch.setattr(passwords.hashlib, "scrypt", count)
    unmatched = make_unmatched_hash(CHEAP)
    assert costs == []
    assert not verify_password("coal on the belt", unmatched)
    own = hash_password("coal on the belt", CHEAP)
    assert costs == [(16, 8, 1)] * 2
    assert re.sub(r"[\w+/]", "x", own) == re.sub(r"[\w+/]", "x", unmatched)
    assert unmatched != make_unmatched_hash(CHEAP)


def test_hashes_carry_their_costs():
    assert verify_password("coal on the belt", hash_password("coal on the belt", ScryptCost(5, 4, 2)))


def test_umlauts_match_in_every_unicode_form():
    assert verify_password("fo\u0308rderband 12", hash_password("f\u00f6rderband 12", CHEAP))


def test_default_cost_is_what_owasp_recommends():
    """OWASP's password storage sheet: N = 2^15, r = 8, p = 3 is one of its least settings."""
    assert ScryptCost() == ScryptCost(log2_n=15, r=8, p=3)


@pytest.mark.parametrize(
    ("password", "line"),
    [
        ("short", "10 to 200 characters, not 5"),
        ("x" * 201, "not 201"),
        ("aaaabbbbcccc", "at least 5"),
        ("I-am-MEIER-12", "user's name"),
    ],
)
def test_weak_passwords_are_refused_without_repeating_them(password, line):
    with pytest.raises(InputError, match=line) as raised:
        validate_password(password, "meier")
    assert password not in str(raised.value)
