"""References of the alarms' settings: the file of the plant's own texts, and the cameras of the rig."""

from __future__ import annotations

from collections.abc import Collection

from beltscape.alarms.management.custom_texts import CustomTexts, read_custom_texts
from beltscape.core.errors import InputError
from beltscape.pipeline.live.project import Project, RunSettings


def read_alarm_texts(project: Project[RunSettings]) -> CustomTexts:
    """Return the plant's own texts of alarms; InputError with one line where their file cannot be used."""
    texts = project.settings.alarms.texts
    return CustomTexts() if texts is None else read_custom_texts(project.resolve(texts))


def require_cameras_of_banks(project: Project[RunSettings], cameras: Collection[str]) -> None:
    """Raise InputError where a bank of [alarms.cameras_off] has a camera that the rig does not have."""
    for bank, names in project.settings.alarms.cameras_off.banks.items():
        for name in names:
            if name not in cameras:
                raise InputError(
                    f"{project.path}: [alarms.cameras_off] banks.{bank}: the rig has no camera {name!r}; "
                    f"give some of {', '.join(cameras)}"
                )


def describe_alarms(project: Project[RunSettings], cameras: Collection[str]) -> str:
    """Return a line about the settings of the alarms; InputError where they refer to what does not exist."""
    require_cameras_of_banks(project, cameras)
    texts = read_alarm_texts(project).by_language
    counts = ", ".join(f"{len(alarms)} in {language}" for language, alarms in texts.items())
    return f"own texts: {counts or 'none'}"
