"""Self-contained HTML report pages of tiles, charts, pictures, tables and 3-D scenes; they work offline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, cast

from beltscape.report.drawing import markup, palette
from beltscape.report.drawing.charts import Chart, ChartKey, KeyEntry
from beltscape.report.drawing.pictures import Panel
from beltscape.report.drawing.scene import Scene

if TYPE_CHECKING:
    from jinja2 import Template


@dataclass(frozen=True, slots=True)
class Tile:
    """A key figure."""

    label: str
    value: str
    unit: str = ""
    note: str = ""
    kind: str = "tile"


@dataclass(frozen=True, slots=True)
class Tiles:
    """Key figures beside each other."""

    tiles: Sequence[Tile]
    kind: str = "tiles"


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures in rows of ``columns`` on a wide screen."""

    panels: Sequence[Panel]
    caption: str = ""
    columns: int = 1
    kind: str = "pictures"


@dataclass(frozen=True, slots=True)
class Table:
    """A table; its first column contains names, the others numbers."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str | KeyEntry]]
    caption: str = ""
    kind: str = "table"


@dataclass(frozen=True, slots=True)
class Properties:
    """Names and what they are, in words: all columns are left-aligned."""

    columns: tuple[str, str]
    rows: Sequence[tuple[str, str]]
    kind: str = "properties"


@dataclass(frozen=True, slots=True)
class Lines:
    """Sentences on separate lines."""

    lines: Sequence[str]
    kind: str = "lines"


@dataclass(frozen=True, slots=True)
class InteractiveScene:
    """A 3-D scene that is rotated with the mouse or a finger."""

    scene: Scene
    caption: str
    kind: str = "scene"


Item = Tiles | Chart | ChartKey | Pictures | Table | Properties | Lines | InteractiveScene


@dataclass(frozen=True, slots=True)
class Section:
    """A heading, an introductory sentence, and the items below."""

    title: str
    intro: str
    items: Sequence[Item]


def render(
    title: str,
    verdict: str,
    sections: Sequence[Section],
    *,
    warnings: Sequence[str] = (),
    language: str = "en",
    warnings_title: str = "Worth knowing",
) -> str:
    """Return the page as text; ``language`` is that of its texts."""
    return _template().render(
        title=title,
        verdict=verdict,
        sections=sections,
        warnings=warnings,
        language=language,
        warnings_title=warnings_title,
    )


@cache
def _template() -> Template:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    assets = files("beltscape.report") / "assets"
    environment = Environment(
        loader=FunctionLoader(lambda name: (assets / name).read_text(encoding="utf-8")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    cast("dict[str, Any]", environment.globals).update(markup=markup, palette=palette)
    return environment.get_template("page.html")
