"""Settings of a site's page: site.toml."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from beltscape.core.errors import InputError, describe_cause
from beltscape.files.toml_text import read_toml, validate
from beltscape.production.calendar import open_zone, parse_clock
from beltscape.production.settings import ShiftSettings
from beltscape.service.settings import PageSettings

Name = Annotated[str, Field(min_length=1, max_length=40)]
QUARTER_MIN = 15
"""Sums are kept by quarters of an hour: every time zone differs from UTC by a multiple of it."""


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class SiteBeltSettings(_Table):
    """One belt: an entry of [[belts]]."""

    name: Name
    url: Annotated[str, Field(max_length=500)]
    """Address of the belt's own page, such as "https://belt-a.plant.example:8460"."""
    key_file: Path
    """File whose first line is a key of that machine, made by `beltscape users key`; it allows reading only."""
    ca: Path | None = None
    """PEM file with the authority of its certificate, or the certificate itself; None: the system's authorities."""
    in_total: bool | None = None
    """Whether the site's total counts it; None: unless it is the outflow of a balance, whose inflow counts."""

    @field_validator("url")
    @classmethod
    def _check_url(cls, url: str) -> str:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname or parts.query or parts.fragment:
            raise ValueError(
                "must be http:// or https://, a host and a port, such as https://belt-a:8460, and no query"
            )
        return url.rstrip("/")


class BalanceSettings(_Table):
    """A transfer point, where material goes from belts to other belts: an entry of [[balances]]."""

    name: Name
    inflow: Annotated[tuple[Name, ...], Field(min_length=1)]
    """Belts that bring material to the transfer point."""
    outflow: Annotated[tuple[Name, ...], Field(min_length=1)]
    """Belts that take it away."""
    quantity: Literal["mass", "volume"] = "mass"
    """What is compared; a mass needs the belts' bulk densities, a volume is changed by loosening."""
    delay_s: dict[Name, Annotated[float, Field(ge=0, le=7200)]] = {}
    """Belt → seconds that material takes between its measuring place and the transfer point; without: 0."""
    delay_sigma_s: Annotated[float, Field(ge=0, le=600)] = 1.0
    """One standard deviation of these delays."""
    window_min: Annotated[float, Field(ge=0.05, le=1440)] = 10.0
    """Length of the windows that are balanced, one after the other."""
    sigmas: Annotated[float, Field(ge=1, le=100)] = 3.0
    """An imbalance beyond this many standard deviations raises the alarm."""
    relative_sigma: Annotated[float, Field(ge=0, le=1)] = 0.0
    """One standard deviation of what the belts cannot know, as a share of the throughput: densities, spillage."""
    missing_share: Annotated[float, Field(ge=0, le=1)] = 0.01
    """Share of a belt that may be unmeasured within a window; beyond it the window is not balanced."""

    @model_validator(mode="after")
    def _check_belts(self) -> BalanceSettings:
        names = (*self.inflow, *self.outflow)
        if len(set(names)) != len(names):
            raise ValueError(f"balance {self.name!r}: a belt stands in inflow or outflow once only")
        if unknown := sorted(set(self.delay_s) - set(names)):
            raise ValueError(
                f"balance {self.name!r}: delay_s names {unknown[0]!r}, which is not in this balance"
            )
        return self

    @property
    def belts(self) -> tuple[str, ...]:
        """Return the names of all belts of the balance."""
        return (*self.inflow, *self.outflow)


DAY_AND_NIGHT = (
    ShiftSettings(name="early", begins="06:00"),
    ShiftSettings(name="late", begins="14:00"),
    ShiftSettings(name="night", begins="22:00"),
)
"""Three shifts of eight hours, as most plants have."""


class SiteSettings(_Table):
    """All of site.toml. Paths are relative to its folder."""

    data: Path = Path("data")
    """Folder for the sums, the users and the log of changes."""
    belts: Annotated[tuple[SiteBeltSettings, ...], Field(min_length=1, max_length=64)]
    balances: Annotated[tuple[BalanceSettings, ...], Field(max_length=64)] = ()
    shifts: Annotated[tuple[ShiftSettings, ...], Field(min_length=1, max_length=12)] = DAY_AND_NIGHT
    """They begin at quarters of an hour; a day begins with the first of them."""
    time_zone: Annotated[str, Field(max_length=60)] = "UTC"
    """Time zone of days and shifts, such as "Europe/Berlin"."""
    poll_s: Annotated[float, Field(ge=0.2, le=60)] = 1.0
    """Period at which each belt's state is read."""
    away_s: Annotated[float, Field(ge=1, le=600)] = 5.0
    """A belt without an answer for this time is away."""
    clock_s: Annotated[float, Field(ge=0.5, le=600)] = 2.0
    """A belt whose clock differs by more is in no balance."""
    first_days: Annotated[float, Field(ge=0, le=3660)] = 2.0
    """Days of a belt's ledger that are fetched when the site meets the belt for the first time."""
    keep_days: Annotated[float, Field(ge=1, le=366)] = 7.0
    """Days for which sums are kept by seconds, so that balances can be made up for; those by quarters stay."""
    web: PageSettings = PageSettings()
    """The site's page: the table [web]."""

    @field_validator("time_zone")
    @classmethod
    def _check_zone(cls, name: str) -> str:
        open_zone(name)
        return name

    @field_validator("shifts")
    @classmethod
    def _check_quarters(cls, shifts: tuple[ShiftSettings, ...]) -> tuple[ShiftSettings, ...]:
        for shift in shifts:
            if parse_clock(shift.begins).minute % QUARTER_MIN:
                raise ValueError(
                    f"shift {shift.name!r}: must begin at a quarter of an hour, not at {shift.begins}"
                )
        return shifts

    @model_validator(mode="after")
    def _check_names(self) -> SiteSettings:
        for kind in ("belts", "balances", "shifts"):
            names = Counter(entry.name for entry in getattr(self, kind))
            if twice := [name for name, count in names.items() if count > 1]:
                raise ValueError(f"{kind}: the name {twice[0]!r} stands twice")
        known = [belt.name for belt in self.belts]
        for balance in self.balances:
            if unknown := [name for name in balance.belts if name not in known]:
                raise ValueError(
                    f"balance {balance.name!r}: there is no belt {unknown[0]!r}; there are {', '.join(known)}"
                )
        return self

    def is_in_total(self, belt: SiteBeltSettings) -> bool:
        """Return whether the site's total counts a belt."""
        if belt.in_total is not None:
            return belt.in_total
        return all(belt.name not in balance.outflow for balance in self.balances)


@dataclass(frozen=True, slots=True)
class Site:
    """The path and the settings of a site.toml."""

    path: Path
    settings: SiteSettings

    @property
    def data(self) -> Path:
        """Return the folder of its data."""
        return self.path.parent / self.settings.data


def read_site(path: Path) -> Site:
    """Read and check site.toml.

    Raises
    ------
    InputError
        One line that names the key, its value and the fix.
    """
    settings = validate(path, SiteSettings, read_toml(path))
    folder = path.parent
    belts = tuple(
        belt.model_copy(
            update={"key_file": folder / belt.key_file, "ca": None if belt.ca is None else folder / belt.ca}
        )
        for belt in settings.belts
    )
    for belt in belts:
        read_key(belt)
        if belt.ca is not None and not belt.ca.is_file():
            raise InputError(f"{belt.ca}: there is no such file; belt {belt.name!r} names it as ca")
    tls = {key: getattr(settings.web, key) for key in ("tls_certificate", "tls_key")}
    web = settings.web.model_copy(update={key: file and folder / file for key, file in tls.items()})
    return Site(path, settings.model_copy(update={"belts": belts, "web": web}))


def read_key(belt: SiteBeltSettings) -> str:
    """Return the key of a belt; InputError if its file has none."""
    try:
        lines = belt.key_file.read_text("utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise InputError(
            f"{belt.key_file}: the key of belt {belt.name!r} cannot be read ({describe_cause(error)})"
        ) from error
    key = lines[0].strip() if lines else ""
    if not key or not key.isascii() or len(key.split()) != 1:
        raise InputError(
            f"{belt.key_file}: its first line must be the key of belt {belt.name!r}; make one there by "
            "`beltscape users key`"
        )
    return key
