"""The plant's own texts of alarms: read, checked, filled in, and carried with the key for translations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.alarms.board import AlarmBoard
from beltscape.alarms.texts import AlarmText, CustomTexts, read_custom_texts
from beltscape.core.errors import InputError
from beltscape.core.findings import Finding
from beltscape.core.translatable_message import Message, get_key
from tests.alarms.plant import BAD, GOOD, SETTINGS, Plant

TEXTS = """
[en.overload]
title = "Belt 4 overloaded"
detail = "{value} on belt 4, limit {limit}: call 4711"
[en."camera_lost:cam2"]
detail = "{detail}. North gangway, camera {subject}"
[en.camera_lost]
detail = "camera {subject}"
[de.overload]
title = "Band 4 überladen"
"""


def read(folder: Path, text: str) -> CustomTexts:
    path = folder / "alarm-texts.toml"
    path.write_text(text, encoding="utf-8")
    return read_custom_texts(path)


def make_plant(texts: CustomTexts) -> Plant:
    plant = Plant()
    plant.board = AlarmBoard(SETTINGS, texts)
    plant.run(GOOD, 5)
    return plant


def test_own_texts_are_filled_in_and_the_most_specific_one_holds(tmp_path: Path) -> None:
    texts = read(tmp_path, TEXTS)
    (alarm,) = make_plant(texts).run(replace(GOOD, **BAD["overload"]), 5)
    assert alarm.detail == "120 % on belt 4, limit 100 %: call 4711"
    (lost,) = make_plant(texts).run(replace(GOOD, **BAD["camera_lost:cam2"]), 5)
    assert lost.detail == "silent for 1.0 s; check its cable. North gangway, camera cam2"
    (empty,) = make_plant(texts).run(replace(GOOD, **BAD["empty"]), 20)
    assert empty.detail.startswith("load 0.50 %")
    assert texts.to_mapping()["de"]["overload"] == {"title": "Band 4 überladen", "detail": ""}


def test_an_own_text_keeps_the_key_of_the_program_s(tmp_path: Path) -> None:
    plant = make_plant(read(tmp_path, '[en.projector]\ndetail = "{detail} (Moeller, 0171)"'))
    text = Message("the projector is off", "projector_off", contrast=0, light=1)
    dark = Finding("projector", 0.0, 0.1, 1.0, "", text=text, effect="missing")
    (raised,) = plant.run(replace(GOOD, findings=[dark]), 5)
    assert raised.detail == "the projector is off (Moeller, 0171)"
    assert get_key(raised.detail) == "projector_off"


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("[en.overlaod]", "did you mean overload"),
        ('[en.overload]\ndetial = "x"', r"\[en.overload\] unknown key detial; did you mean detail"),
        ('[en.overload]\ndetail = "{volume}"', r"give one of \{value\}, \{limit\}, \{subject\}, \{detail\}"),
        ('[en.overload]\ndetail = "{value.__class__}"', "braces"),
        ('[en.overload]\ndetail = "{value"', "braces"),
        ('[en.overload]\ndetail = "{value!r:>99999}"', "braces"),
        ('[en.overload]\ndetail = """a\nb"""', "one line"),
        ('[en.overload]\ntitle = "' + "x" * 61 + '"', "title"),
        ("[en.overload]\ntitle = 3", "title"),
        ('en = "x"', r"give a table for each alarm, such as \[en.overload\]"),
        ('[en]\noverload = "x"', r"give a table for each alarm"),
        ("[en", "not TOML"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(tmp_path: Path, text: str, match: str) -> None:
    with pytest.raises(InputError, match=match) as caught:
        read(tmp_path, text)
    assert "alarm-texts.toml" in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml: there is no such file; \[alarms\] texts names it"):
        read_custom_texts(tmp_path / "none.toml")


SOME_TEXT = st.text("{}|%$value detail\\\n", max_size=40)


@given(SOME_TEXT, SOME_TEXT)
def test_values_are_not_taken_for_placeholders(value: str, detail: str) -> None:
    texts = CustomTexts({"en": {"overload": AlarmText(detail="{value}|{detail}")}})
    assert texts.compose_detail("overload", "", value, "", detail) == f"{value}|{detail}"
