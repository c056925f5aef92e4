"""A self-contained HTML page: tiles, pictures, tables and turnable scenes in sections; works offline."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from beltscape.core.frames import Image
from beltscape.files.images import encode_image
from beltscape.report.scene import Scene


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
class Figure:
    """A picture with its caption."""

    source: str
    """A data URI."""
    caption: str
    wide: bool = True
    kind: str = "figure"

    @classmethod
    def of(cls, image: Image, caption: str, *, wide: bool = True) -> Figure:
        """From pixels: JPEG where it looks like a photograph, so that pages stay small."""
        return cls("data:image/jpeg;base64," + b64encode(encode_image(image, ".jpg")).decode(), caption, wide)

    @classmethod
    def png(cls, data: bytes, caption: str, *, wide: bool = True) -> Figure:
        """From an encoded PNG."""
        return cls("data:image/png;base64," + b64encode(data).decode(), caption, wide)


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of text under headings; the first column names, the others are numbers."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    kind: str = "table"


@dataclass(frozen=True, slots=True)
class Lines:
    """Sentences, one below the other."""

    lines: Sequence[str]
    kind: str = "lines"


@dataclass(frozen=True, slots=True)
class Turnable:
    """A scene that one turns with the mouse."""

    scene: Scene
    caption: str
    kind: str = "scene"


Item = Tiles | Figure | Table | Lines | Turnable


@dataclass(frozen=True, slots=True)
class Section:
    """A heading, a sentence, and what belongs to it."""

    title: str
    intro: str
    items: Sequence[Item]


def render(title: str, verdict: str, sections: Sequence[Section], *, warnings: Sequence[str] = ()) -> str:
    """The page as text."""
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
    return environment.get_template("page.html")
