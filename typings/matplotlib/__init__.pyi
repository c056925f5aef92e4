"""Types of the Matplotlib functions that this project calls; its own leave the keywords of styles untyped."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any

def rc_context(rc: Mapping[str, Any]) -> AbstractContextManager[None]: ...
