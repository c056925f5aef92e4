"""Declaration and checks of arguments that several commands share."""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Sequence
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from beltscape.core.checks import is_list_or_tuple
from beltscape.core.errors import SettingsError
from beltscape.core.quantities import Quantity, report_oddity

if TYPE_CHECKING:
    from pydantic import BaseModel

    Model = TypeVar("Model", bound=BaseModel)


def _parse_path(text: str) -> Path:
    """Return the path of ``--out``; an empty text, which would mean the working folder, is refused."""
    if not text.strip():
        from argparse import ArgumentTypeError

        raise ArgumentTypeError("is empty; give a name")
    return Path(text)


def add_output_folder(
    parser: ArgumentParser,
    text: str,
    *,
    required: bool = False,
    default: Path | None = None,
    owner: Sequence[str] = (),
) -> None:
    """Declare ``--out DIR``: a folder that the command owns, see `beltscape.cli.output`.

    ``owner``: arguments whose values identify the folder's content, such as a scene's name.
    """
    parser.add_argument(
        "--out", type=_parse_path, metavar="DIR", required=required, default=default, help=text
    )
    parser.set_defaults(output="folder", owner=(parser.prog.removeprefix("beltscape "), *owner))


def add_empty_belt(parser: ArgumentParser) -> None:
    """Declare ``--empty PATH``, the reference against which a load is measured."""
    parser.add_argument(
        "--empty",
        type=Path,
        required=True,
        help="the empty belt: a frame folder, a reconstruction (all its frames), or a belt.json",
    )


CLOUD_FORMATS = ("las", "laz")
"""Formats of point clouds beside PLY: those of `beltscape.files.clouds`, which loads numpy."""


def add_preset(parser: ArgumentParser, where: str) -> None:
    """Declare ``--preset``, one of `beltscape.stereo.settings.Preset`; ``where`` says what it applies to."""
    parser.add_argument("--preset", default="standard", help=f"{where}: fast or standard (default)")


def add_output_file(parser: ArgumentParser, text: str, example: str, *, required: bool = False) -> None:
    """Declare ``--out FILE``; ``example`` is an example of the file's name."""
    parser.add_argument("--out", type=_parse_path, metavar="FILE", required=required, help=text)
    parser.set_defaults(output="file", example=example)


def make_settings(model: type[Model], **options: object) -> Model:
    """Return the settings of options named as its fields; SettingsError with the bounds for an invalid value."""
    from pydantic import ValidationError

    from beltscape.files.toml_text import describe_fault, validate_strictly

    def describe_oddity(field: str, value: float, oddity: str) -> str:
        return f"{_option(field)} {_format_input(value)}: {oddity}"

    try:
        return validate_strictly(model, options, describe_oddity)
    except ValidationError as error:
        first = error.errors()[0]
        raise SettingsError(
            f"{_option(str(first['loc'][0]))} {_format_input(first['input'])}: {describe_fault(first)}"
        ) from error


def _option(field: str) -> str:
    """Return the option that sets a field: ``--profile-every`` for profile_every_mm."""
    return "--" + field.removesuffix("_mm").removesuffix("_deg").replace("_", "-")


def _format_input(value: object) -> str:
    if is_list_or_tuple(value):
        return ",".join(_format_input(part) for part in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def require_ordered_range(option: str, values: Sequence[float] | None) -> tuple[float, float] | None:
    """Return two finite numbers, the smaller one first; None if the option is not given; SettingsError otherwise."""
    if values is None:
        return None
    low, high = values
    if not (isfinite(low) and isfinite(high)):
        raise SettingsError(f"{option} {low:g} {high:g}: both must be finite numbers")
    if not low < high:
        raise SettingsError(f"{option} {low:g} {high:g}: the first number must be the smaller one")
    return low, high


def require_positive_range(option: str, values: Sequence[float] | None) -> tuple[float, float] | None:
    """Return two positive numbers, smaller first; None if the option is not given; SettingsError otherwise."""
    pair = require_ordered_range(option, values)
    if pair is not None and pair[0] <= 0:
        raise SettingsError(f"{option} {pair[0]:g} {pair[1]:g}: both numbers must be positive")
    return pair


def require_positive(option: str, value: float | None) -> float | None:
    """Return a positive number; None if the option is not given; SettingsError otherwise."""
    if value is not None and not 0 < value < inf:
        raise SettingsError(f"{option} {value:g}: must be positive")
    return value


def require_plausible(option: str, value: float | None, quantity: Quantity) -> float | None:
    """Return a number that can be, and report an unusual one; None if the option is not given; else SettingsError."""
    if value is None:
        return None
    if refusal := quantity.find_refusal(value):
        raise SettingsError(f"{option} {value:g}: {refusal}")
    if oddity := quantity.find_oddity(value):
        report_oddity(f"{option} {value:g}: {oddity}")
    return value


def add_workers(parser: ArgumentParser) -> None:
    """Declare ``--workers`` and ``--address``: on how many workers, and on which machines, independent parts run."""
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="parts at a time, in processes with a core each (default: one by one, with all cores)",
    )
    parser.add_argument(
        "--address",
        metavar="HOST",
        help='a Ray cluster: "auto", host:port or ray://host:port (default: this machine)',
    )
