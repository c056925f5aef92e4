"""TOML read into settings: values, and the first invalid key."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import pytest
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.errors import InputError
from beltscape.core.quantities import LOAD_HEIGHT, receive_oddities
from beltscape.files.toml_text import read_toml, validate


class Ring(BaseModel):
    model_config = ConfigDict(extra="forbid")
    diameter_mm: float = Field(gt=0)


class Settings(BaseModel):
    model_config = ConfigDict(extra="forbid")
    width_mm: float
    count: int = 3
    size_px: tuple[int, int] = (1, 1)
    lit: bool = False
    pause_s: float = Field(default=1.0, gt=0, le=600)
    load_mm: Annotated[float, LOAD_HEIGHT] = 400.0
    ring: Ring | None = None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "width_mm is missing"),
        ("width_mn = 3", "unknown key width_mn; did you mean width_mm?"),
        (
            "width_mm = 3\ncolour = 1",
            "unknown key colour; known: width_mm, count, size_px, lit, pause_s, load_mm, ring",
        ),
        ('width_mm = "wide"', "width_mm = 'wide': must be a number"),
        ('width_mm = "30"', "width_mm = '30': must be a number, without quotation marks"),
        ("width_mm = true", "width_mm = true: must be a number"),
        ("width_mm = 3\nsize_px = [true, 4]", "size_px[0] = true: must be a whole number"),
        (
            'width_mm = 3\nsize_px = [3, "4"]',
            "size_px[1] = '4': must be a whole number, without quotation marks",
        ),
        ("width_mm = 3\n[ring]\ndiameter_mm = true", "ring.diameter_mm = true: must be a number"),
        ("width_mm = 3\nlit = 1", "lit = 1: must be true or false"),
        ('width_mm = 3\nlit = "yes"', "lit = 'yes': must be true or false"),
        ("width_mm = 3\ncount = 1.5", "count = 1.5: must be a whole number"),
        ("width_mm = 3\ncount = [true]", "count = [true]: must be a whole number"),
        (
            "width_mm = 3\npause_s = 3000",
            "pause_s = 3000: must be less than or equal to 600; in milliseconds? write 3",
        ),
        ("width_mm = 3\npause_s = -1", "pause_s = -1: must be greater than 0"),
        (
            "width_mm = 3\nload_mm = 0.2",
            "load_mm = 0.2: cannot be the height of a load in mm (2 to 5000); in metres? write 200",
        ),
        ("width_mm = 3\nsize_px = 4", "size_px = 4: must be a list"),
        ("width_mm = 3\nsize_px = [4]", "size_px[1] is missing"),
        ("width_mm = 3\nsize_px = [4, 5, 6]", "size_px = [4, 5, 6]: must have 2 values, not 3"),
        ("width_mm = 3\n[ring]\ndiameter_mm = -1", "ring.diameter_mm = -1: must be greater than 0"),
    ],
)
def test_first_invalid_value_is_named(tmp_path, text, message):
    path = tmp_path / "project.toml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        validate(path, Settings, read_toml(path))
    assert str(error.value) == f"{path}: {message}"


def test_valid_values_are_returned(tmp_path):
    path = tmp_path / "project.toml"
    path.write_bytes(b"\xef\xbb\xbfwidth_mm = 3\n[ring]\ndiameter_mm = 2.5\n")
    assert validate(path, Settings, read_toml(path)) == Settings(width_mm=3, ring=Ring(diameter_mm=2.5))


def test_invalid_toml_is_refused_with_its_position(tmp_path):
    path = tmp_path / "board.toml"
    path.write_text('kind = "charuco"\nsquares = [5, 4\n')
    with pytest.raises(InputError) as error:
        read_toml(path)
    assert str(error.value) == f"{path}: not TOML (Unclosed array (at end of document))"


def test_missing_files_folders_and_other_encodings_are_refused_by_name(tmp_path):
    (tmp_path / "latin.toml").write_bytes(b'name = "\xe9"')
    for path, message in [
        (tmp_path / "none.toml", "no such file"),
        (tmp_path, "cannot be read (Is a directory)"),
        (tmp_path / "latin.toml", "not UTF-8 text"),
    ]:
        with pytest.raises(InputError) as error:
            read_toml(path)
        assert str(error.value) == f"{path}: {message}"


class Inner(BaseModel):
    model_config = ConfigDict(extra="forbid")
    height_mm: float = 1.0
    aim_mm: float = 0.0


class Outer(BaseModel):
    model_config = ConfigDict(extra="forbid")
    rig: Inner = Inner()
    faults: tuple[Inner, ...] = ()
    tof: Inner | None = None


@pytest.mark.parametrize("table", ["rig", "tof"])
def test_unknown_key_in_a_table_is_refused_with_the_tables_own_keys(table):
    with pytest.raises(InputError, match=rf"unknown key {table}\.heigth_mm; did you mean height_mm\?"):
        validate(Path("scene.toml"), Outer, {table: {"heigth_mm": 3}})


def test_unknown_key_in_a_list_of_tables_is_refused():
    with pytest.raises(InputError, match=r"unknown key faults\[1\]\.zzz; known: height_mm, aim_mm"):
        validate(Path("scene.toml"), Outer, {"faults": [{"aim_mm": 1}, {"zzz": 3}]})


def test_unusual_values_are_remarked_on():
    lines: list[str] = []
    with receive_oddities(lines.append):
        for _ in range(2):
            assert validate(Path("project.toml"), Settings, {"width_mm": 3, "load_mm": 10}).load_mm == 10
    validate(Path("project.toml"), Settings, {"width_mm": 3, "load_mm": 11})  # nobody receives it
    assert lines == [
        "project.toml: load_mm = 10: is unusual for the height of a load in mm (20 to 1500); in centimetres? write "
        "100; in inches? write 254"
    ]


class Encoder(BaseModel):
    model_config = ConfigDict(extra="forbid")
    folder: str = ""


class Project(BaseModel):
    model_config = ConfigDict(extra="forbid")
    encoder: Encoder = Encoder()
    tof: Inner = Inner()


@pytest.mark.parametrize(
    ("key", "fix"),
    [
        ("folder", "it is a key of [encoder]"),  # not "did you mean encoder?"
        ("aim_nm", "did you mean aim_mm?"),
        ("encoder", "known: height_mm, aim_mm"),
    ],
)
def test_only_a_near_name_is_suggested_or_the_table_that_has_it(key, fix):
    with pytest.raises(InputError) as error:
        validate(Path("project.toml"), Project, {"tof": {key: 1}})
    assert str(error.value) == f"project.toml: unknown key tof.{key}; {fix}"
