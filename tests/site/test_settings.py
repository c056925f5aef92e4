"""site.toml: what does not fit is one line with its fix."""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import pytest

from beltscape.core.errors import InputError
from beltscape.site.app import list_periods
from beltscape.site.settings import read_site
from tests.site.belts import make_site

BELT = '[[belts]]\nname = "a"\nurl = "https://a:8460"\nkey_file = "key"\n'
BALANCE = '[[balances]]\nname = "t"\ninflow = ["a"]\noutflow = ["b"]\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "belts is missing"),
        (BELT.replace("https://", ""), "must be http:// or https://"),
        (BELT.replace("8460", "8460/?page=1"), "must be http:// or https://"),
        (BELT + BELT, "belts: the name 'a' stands twice"),
        (BELT + BALANCE, "there is no belt 'b'; there are a"),
        (BELT + BALANCE.replace('"b"', '"a"'), "stands in inflow or outflow once only"),
        ('time_zone = "Mars/Olympus"\n' + BELT, "no time zone"),
        (BELT + '[[shifts]]\nname = "early"\nbegins = "06:10"\n', "must begin at a quarter of an hour"),
        ("pol_s = 1\n" + BELT, "unknown key pol_s; did you mean poll_s?"),
        (BELT + 'ca = "no.pem"\n', "no.pem: there is no such file"),
        (BELT.replace('"key"', '"no.key"'), "no.key: the key of belt 'a' cannot be read"),
        (BELT.replace('"key"', '"two"'), "its first line must be the key"),
    ],
)
def test_what_does_not_fit_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "key").write_text("abc\n")
    (tmp_path / "two").write_text("abc def\n")
    (tmp_path / "site.toml").write_text(text)
    with pytest.raises(InputError, match=r"site\.toml|no\.|two") as caught:
        read_site(tmp_path / "site.toml")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_total_leaves_out_belts_that_other_belts_fill() -> None:
    balance = {"name": "t", "inflow": ["a", "b"], "outflow": ["c"]}
    site = make_site("a", "b", "c", balances=[balance])
    assert [site.is_in_total(belt) for belt in site.belts] == [True, True, False]


def test_periods_follow_the_time_zone_over_the_change_of_the_clocks() -> None:
    site = make_site("a", time_zone="Europe/Berlin")
    now_s = datetime(2026, 10, 25, 12, 0, tzinfo=UTC).timestamp()  # the clocks went back that night
    shifts = list_periods(site, "shift", now_s, 3)
    assert [name for _, _, name in shifts] == ["late", "night", "early"]
    assert [(end - start) / 3600 for start, end, _ in shifts] == [8, 9, 8]
    days = list_periods(site, "day", now_s, 2)
    assert [(end - start) / 3600 for start, end, _ in days] == [25, 24]
    hours = list_periods(site, "hour", now_s + 1800, 3)
    assert hours[-1][:2] == (now_s, now_s + 3600)
    assert [later[0] - earlier[0] for earlier, later in pairwise(hours)] == [3600, 3600]
