from collections.abc import Callable, Sequence
from typing import Any

class CSS:
    def __init__(self, *, string: str) -> None: ...

class Page:
    _page_box: Any

class Document:
    pages: Sequence[Page]
    def write_pdf(self) -> bytes: ...

class HTML:
    def __init__(self, *, string: str, url_fetcher: Callable[..., object] = ...) -> None: ...
    def render(self, *, stylesheets: Sequence[CSS] = ...) -> Document: ...
