"""Settings of products, timetable, shifts, reports and the belt scale: tables of project.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from beltscape.core.quantities import DENSITY, DENSITY_SIGMA, MOISTURE, SCALE_SIGMA, require_host
from beltscape.production.calendar import open_zone, parse_clock

Name = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^\S(.*\S)?$")]
"""Name of a product, a shift or a batch: one line without blanks at its ends."""
Weekday = Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]
WEEKDAYS: tuple[Weekday, ...] = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")


def _check_clock(text: str) -> str:
    parse_clock(text)
    return text


def _check_zone(name: str) -> str:
    open_zone(name)
    return name


Clock = Annotated[str, AfterValidator(_check_clock)]
"""A local time of day, such as "06:00"."""


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class ProductSettings(_Table):
    """A bulk material that the belt carries: a table [[products]]."""

    name: Name
    density_kg_m3: Annotated[float, DENSITY]
    """Bulk density as it lies on the belt, with its usual moisture."""
    sigma_kg_m3: Annotated[float, DENSITY_SIGMA] = 0.0
    """One standard deviation of it."""
    moisture_percent: Annotated[float, MOISTURE] | None = None
    """Share of water in the mass at that density."""
    colour: Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")] = "#6b7280"
    """Colour on the page and in reports."""


class TimetableSettings(_Table):
    """A regular change of the product: a table [[production.timetable]]."""

    at: Clock
    """Local time."""
    product: Name
    days: Annotated[tuple[Weekday, ...], Field(min_length=1)] = WEEKDAYS
    """Days of the week; without it every day."""


class ShiftSettings(_Table):
    """A shift, which ends where the next one begins: a table [[production.shifts]]."""

    name: Name
    begins: Clock
    """Local time."""


class ProductionSettings(_Table):
    """Time zone, first product, timetable and shifts: the table [production]."""

    time_zone: Annotated[str, AfterValidator(_check_zone)] = "UTC"
    """IANA name of the zone of all local times, such as "Europe/Berlin"."""
    product: Name | None = None
    """Product at the first start; without it the first of [[products]]."""
    timetable: Annotated[tuple[TimetableSettings, ...], Field(max_length=200)] = ()
    shifts: Annotated[tuple[ShiftSettings, ...], Field(max_length=24)] = ()

    @model_validator(mode="after")
    def _distinct_shifts(self) -> ProductionSettings:
        for key in ("name", "begins"):
            values = [getattr(shift, key) for shift in self.shifts]
            twice = next((value for value in values if values.count(value) > 1), None)
            if twice is not None:
                raise ValueError(f"shifts: {key} = {twice!r} is given twice; every shift has its own")
        return self


class MailSettings(_Table):
    """Reports by mail: the table [reports.mail]."""

    host: Annotated[str, Field(max_length=253), AfterValidator(require_host)]
    """SMTP server."""
    port: Annotated[int, Field(ge=1, le=65_535)] | None = None
    """Without it 587 for "starttls", 465 for "tls", 25 for "none"."""
    security: Literal["starttls", "tls", "none"] = "starttls"
    """How the connection is encrypted; "none" sends the reports readable, and no password."""
    tls_ca: Path | None = None
    """PEM file with the certificate authority of the server; without it those of the system."""
    user: Annotated[str, Field(max_length=200)] = ""
    password_file: Path | None = None
    """File whose first line is the password."""
    sender: Annotated[str, Field(pattern=r"^[^@\s]+@[^@\s]+$", max_length=254)]
    to: Annotated[
        tuple[Annotated[str, Field(pattern=r"^[^@\s]+@[^@\s]+$", max_length=254)], ...],
        Field(min_length=1, max_length=50),
    ]
    """Recipients."""
    retry_s: Annotated[float, Field(ge=1, le=86_400)] = 300.0
    """Wait after a failure; the mail is offered until the server takes it."""

    @model_validator(mode="after")
    def _whole_sign_in(self) -> MailSettings:
        if bool(self.user) != (self.password_file is not None):
            raise ValueError("user and password_file belong together: give both or neither")
        if self.user and self.security == "none":
            raise ValueError('security = "none" would send the password readable; give "starttls" or "tls"')
        return self

    @property
    def server_port(self) -> int:
        """Return the port, given or usual."""
        return self.port or {"starttls": 587, "tls": 465, "none": 25}[self.security]


class ReportSettings(_Table):
    """Reports of shifts and days: the table [reports]."""

    folder: Path = Path("reports")
    """Folder of the reports, in the data folder unless it is absolute."""
    shifts: bool = True
    """Whether every shift gets a report."""
    days: bool = True
    """Whether every day gets a report; it begins with the first shift."""
    pdf: bool = False
    """Whether each is also written as PDF; needs beltscape[reports]."""
    language: Annotated[str, Field(pattern=r"^[a-z]{2}(-[A-Z]{2})?$")] = "en"
    """Code of a language that reports have, such as "de"."""
    keep_days: Annotated[int, Field(ge=1, le=36_500)] = 3650
    """Age at which reports are removed."""
    printer: Annotated[str, Field(pattern=r"^[^\s#/,-][^\s#/,]*$", max_length=127)] | None = None
    """Printer of CUPS that prints every PDF, or "default"; its characters are those that CUPS admits in a name."""
    mail: MailSettings | None = None

    @model_validator(mode="after")
    def _printed_pdf(self) -> ReportSettings:
        if self.printer is not None and not self.pdf:
            raise ValueError("printer: prints the PDF; give pdf = true as well")
        return self


class ScaleModbusSettings(_Table):
    """The counter of a belt scale as registers of its controller: the table [scale.modbus]."""

    host: Annotated[str, Field(max_length=253), AfterValidator(require_host)]
    port: Annotated[int, Field(ge=1, le=65_535)] = 502
    unit: Annotated[int, Field(ge=0, le=255)] = 1
    address: Annotated[int, Field(ge=0, le=65_535)]
    """Of the first register, counted from 0."""
    kind: Literal["holding", "input"] = "holding"
    form: Literal["uint16", "uint32", "uint64", "float32", "float64"] = "uint32"
    words: Literal["big", "little"] = "big"
    """Order of the 16-bit words."""
    kg_per_count: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] = 1.0


class ScaleSettings(_Table):
    """A belt scale beside the measurement: the table [scale]."""

    sigma_percent: Annotated[float, SCALE_SIGMA] = 0.5
    """One standard deviation of a weighed mass, percent; a class 1 scale (OIML R 50) keeps ±1 % in service."""
    resolution_kg: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)] = 1.0
    """Step of the counter."""
    rolls_over_kg: Annotated[float, Field(gt=0, le=1e15, allow_inf_nan=False)] | None = None
    """Mass at which the counter begins at 0 again; without it a lower reading is a counter that was reset."""
    every_s: Annotated[float, Field(ge=1, le=3600)] = 10.0
    """Interval at which csv or modbus is read."""
    csv: Path | None = None
    """Growing table ``timestamp_s,kg``: the counter at times since 1970."""
    modbus: ScaleModbusSettings | None = None

    @model_validator(mode="after")
    def _one_source(self) -> ScaleSettings:
        if self.csv is not None and self.modbus is not None:
            raise ValueError("csv and modbus: read the counter in one way; remove one")
        return self


def check_products(products: tuple[ProductSettings, ...], production: ProductionSettings) -> str:
    """Return what is wrong with the products that the settings name, in one line; empty if all is right."""
    names = [product.name for product in products]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        return f"[[products]] name = {twice!r} is given twice; every product has its own"
    wanted = [("[production] product", production.product)] if production.product is not None else []
    wanted += [("[[production.timetable]] product", entry.product) for entry in production.timetable]
    for key, name in wanted:
        if name not in names:
            there = f"there are {', '.join(names)}" if names else "give it a table [[products]]"
            return f"{key} = {name!r}: no such product; {there}"
    return ""
