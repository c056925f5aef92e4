"""Types of the YAML functions that this project calls; PyYAML itself has none."""

from collections.abc import Callable
from typing import IO, Any, TypeVar

_T = TypeVar("_T")
_L = TypeVar("_L", bound=SafeLoader)
_D = TypeVar("_D", bound=SafeDumper)

class Mark:
    column: int
    line: int

class YAMLError(Exception): ...

class MarkedYAMLError(YAMLError):
    problem: str | None
    problem_mark: Mark | None

class Node: ...
class MappingNode(Node): ...
class ScalarNode(Node): ...

class SafeLoader:
    @classmethod
    def add_constructor(
        cls: type[_L], tag: str, constructor: Callable[[_L, MappingNode], object]
    ) -> None: ...
    def construct_mapping(self, node: MappingNode, deep: bool = ...) -> dict[Any, Any]: ...

class SafeDumper:
    @classmethod
    def add_representer(
        cls: type[_D], data_type: type[_T], representer: Callable[[_D, _T], Node]
    ) -> None: ...
    def increase_indent(self, flow: bool = ..., indentless: bool = ...) -> None: ...
    def represent_mapping(self, tag: str, mapping: object) -> MappingNode: ...
    def represent_scalar(self, tag: str, value: str, style: str | None = ...) -> ScalarNode: ...

def dump(
    data: object,
    *,
    Dumper: type[SafeDumper],
    sort_keys: bool = ...,
    allow_unicode: bool = ...,
    default_flow_style: bool | None = ...,
    width: int = ...,
) -> str: ...
def load(stream: str | bytes | IO[str], Loader: type[SafeLoader]) -> Any: ...
def safe_load(stream: str | bytes | IO[str] | IO[bytes]) -> Any: ...
