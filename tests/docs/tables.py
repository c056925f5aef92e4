"""TOML blocks of the manual, read by the product's own readers."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beltscape.alarms.texts import read_custom_texts
from beltscape.files.toml_text import validate
from beltscape.pipeline.certifying.material_test import read_test_settings
from beltscape.pipeline.live.project import read_product_density
from beltscape.pipeline.plan import read_plan_settings
from beltscape.pipeline.simulation import read_scenario
from beltscape.service.project import ProjectSettings
from beltscape.service.settings import list_languages
from beltscape.site.settings import SiteSettings
from beltscape.target.board import read_board
from beltscape.target.module import read_module
from tests.docs.blocks import Block
from tests.docs.system import Wrong, demand


def check_table(block: Block, folder: Path) -> None:
    """Read the block as the file that it is.

    Raises
    ------
    Wrong, BeltscapeError
        Where it is none that the product reads.
    """
    values = tomllib.loads(block.text)
    path = folder / "block.toml"
    path.write_text(block.text)
    if named := re.match(r"# (\w+\.toml)\b", block.text):
        (folder / named[1]).write_text(block.text)
    if {"squares", "corners", "tags", "boards"} & set(values):
        read_board(path)
    elif "rig" in values and "empty" in values:
        write_project(block.text, folder)
        validate(path, ProjectSettings, values)
    elif set(values) <= set(ProjectSettings.model_fields):
        check_project_tables(path, values, defaults="# defaults" in block.text)
    else:
        _check_other_file(values, path, folder)


def _check_other_file(values: Mapping[str, Any], path: Path, folder: Path) -> None:
    """Read a file that is neither a board nor a project."""
    if set(values) <= {language.code for language in list_languages()}:
        read_custom_texts(path)
    elif "belts" in values:
        validate(path, SiteSettings, dict(values))
    elif "belt" in values and "camera" in values:
        read_plan_settings(path, {})
    elif "kind" in values:
        read_scenario(str(path), {})
    elif "base" in values:
        read_module(path)
    elif "runs" in values:
        read_test_settings(path)
    elif "coal" in values:
        read_product_density(folder / "products.toml", "coal")
    else:
        raise Wrong(f"no rule of tests/docs/tables.py knows a table with {[*values]}: write one")


def check_project_tables(path: Path, values: Mapping[str, Any], *, defaults: bool) -> None:
    """Some tables of a project.toml, beside a camera that any project needs; defaults as defaults they are these."""
    least = {"cameras": {"devices": {"cam0": "192.168.10.11"}}}
    settings = validate(path, ProjectSettings, {**least, **values})
    if defaults:
        own = ProjectSettings().model_dump()
        documented = settings.model_dump()
        for name in values:
            if name != "cameras":
                demand(
                    documented[name] == own[name],
                    f"[{name}] says to hold defaults: {documented[name]} against {own[name]}",
                )


def write_project(text: str, folder: Path) -> None:
    """Write a project of the manual, and the same with a recorded capture, once and without end."""
    live = recorded_project(text)
    # the images of the tests are narrower than those of the manual's plant
    (folder / "project.toml").write_text(text.replace("width_px = 612", "width_px = 306"))
    (folder / "live.toml").write_text(live)
    once = "\n".join(line for line in live.splitlines() if not line.startswith("loop = "))
    (folder / "recorded.toml").write_text(once)


def recorded_project(text: str) -> str:
    """Return a project with a recorded capture in place of cameras, as its comment has it, on any free port."""
    lines = text.splitlines()
    if not any(line.startswith("[capture]") for line in lines):
        start = next(i for i, line in enumerate(lines) if line.startswith("[cameras"))
        while not lines[start].startswith("# [capture]"):
            del lines[start]
        while lines[start].startswith("# "):
            lines[start] = lines[start].removeprefix("# ")
            start += 1
    return "\n".join(line for line in lines if not line.startswith("width_px = ")).replace(
        "[web]", "[web]\nport = 0"
    )
