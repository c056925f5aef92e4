"""What the alarms' settings refer to: cameras of banks, the file of own texts and its languages."""

from __future__ import annotations

from pathlib import Path

import pytest

from beltscape.core.errors import InputError
from beltscape.pipeline.live.project import (
    Project,
    RunSettings,
    describe_alarms,
    read_alarm_texts,
    require_cameras_of_banks,
)
from beltscape.service.project import open_project
from beltscape.service.settings import list_languages

CAMERAS = ("cam0", "cam1", "cam2")


def make_project(folder: Path, **alarms: object) -> Project[RunSettings]:
    return Project(folder / "project.toml", RunSettings.model_validate({"alarms": alarms}))


def test_a_bank_has_cameras_of_the_rig(tmp_path: Path) -> None:
    right = make_project(tmp_path, cameras_off={"banks": {"left": ["cam0", "cam1"]}})
    require_cameras_of_banks(right, CAMERAS)
    wrong = make_project(tmp_path, cameras_off={"banks": {"left": ["cam0", "cam7"]}})
    with pytest.raises(
        InputError, match=r"banks\.left: the rig has no camera 'cam7'; give some of cam0, cam1, cam2"
    ):
        require_cameras_of_banks(wrong, CAMERAS)


def test_own_texts_are_counted_by_language(tmp_path: Path) -> None:
    assert describe_alarms(make_project(tmp_path), CAMERAS) == "own texts: none"
    (tmp_path / "texts.toml").write_text('[de.overload]\ntitle = "Band 4"\n[de.empty]\ntitle = "Leer"')
    project = make_project(tmp_path, texts="texts.toml")
    assert describe_alarms(project, CAMERAS) == "own texts: 2 in de"
    assert set(read_alarm_texts(project).by_language["de"]) == {"overload", "empty"}


def test_a_language_that_the_page_does_not_have_is_refused(tmp_path: Path) -> None:
    for name in ("rig.json", "belt.json"):
        (tmp_path / name).write_text("{}")
    (tmp_path / "texts.toml").write_text('[dee.overload]\ntitle = "Band 4"')
    project = tmp_path / "project.toml"
    project.write_text('[capture]\nfolder = "belt"\n[alarms]\ntexts = "texts.toml"\n')
    known = ", ".join(language.code for language in list_languages())
    with pytest.raises(InputError, match=rf"texts\.toml: there is no language 'dee'; give one of {known}"):
        open_project(project)
