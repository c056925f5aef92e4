"""All of project.toml, the page included."""

from __future__ import annotations

from pathlib import Path

from beltscape.pipeline.live.project import Project, RunSettings, read_project
from beltscape.service.settings import WebSettings


class ProjectSettings(RunSettings):
    """The whole tree."""

    web: WebSettings = WebSettings()
    """The operator's page: the table [web]."""


def open_project(path: Path) -> Project[ProjectSettings]:
    """Read and check project.toml; InputError with one line that names the key, its value and the mend."""
    return read_project(path, ProjectSettings)
