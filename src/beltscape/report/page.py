"""A self-contained HTML page: tiles, charts, pictures, tables and turnable scenes in sections; works offline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from beltscape.report.drawing import markup, palette
from beltscape.report.drawing.charts import Chart, Entry, Key
from beltscape.report.drawing.pictures import Panel
from beltscape.report.drawing.scene import Scene


@dataclass(frozen=True, slots=True)
class Tile:
    """One number that matters."""

    label: str
    value: str
    unit: str = ""
    note: str = ""
    kind: str = "tile"


@dataclass(frozen=True, slots=True)
class Tiles:
    """Numbers side by side."""

    tiles: Sequence[Tile]
    kind: str = "tiles"


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures side by side, in rows of ``columns`` where the screen is wide enough."""

    panels: Sequence[Panel]
    caption: str = ""
    columns: int = 1
    kind: str = "pictures"


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of text under headings; the first column names, the others are numbers."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str | Entry]]
    caption: str = ""
    kind: str = "table"


@dataclass(frozen=True, slots=True)
class Lines:
    """Sentences, one below the other."""

    lines: Sequence[str]
    kind: str = "lines"


@dataclass(frozen=True, slots=True)
class InteractiveScene:
    """A scene that one turns with the mouse or a finger."""

    scene: Scene
    caption: str
    kind: str = "scene"


Item = Tiles | Chart | Key | Pictures | Table | Lines | InteractiveScene


@dataclass(frozen=True, slots=True)
class Section:
    """A heading, a sentence, and what belongs to it."""

    title: str
    intro: str
    items: Sequence[Item]


def render(title: str, verdict: str, sections: Sequence[Section], *, warnings: Sequence[str] = ()) -> str:
    """Return the page as text."""
    return _template().render(title=title, verdict=verdict, sections=sections, warnings=warnings)


@cache
def _template():
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    assets = files("beltscape.report") / "assets"
    environment = Environment(
        loader=FunctionLoader(lambda name: (assets / name).read_text(encoding="utf-8")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update(markup=markup, palette=palette)
    return environment.get_template("page.html")
