"""Endpoints of production: products, batches, shifts, the belt scale, and the reports of shifts and days."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, HTTPException, Path, Query
from fastapi.responses import FileResponse, Response
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.errors import InputError, OutputError
from beltscape.production.scale import ScaleReading
from beltscape.production.shifts import PeriodKind
from beltscape.report.production.document import BatchOut, PeriodOut, SumsOut
from beltscape.report.production.texts import make_title
from beltscape.service.access import User, require_role
from beltscape.service.api.common import AppContext, ResponseModel, WallMs, check_period, describe_refusals
from beltscape.service.api.controls import Done
from beltscape.service.api.history import MS_NS, map_history_errors
from beltscape.service.production.figures import ProductionFigures
from beltscape.service.production.reports import ReportWriter
from beltscape.service.production.serving import ServedProduction

Viewer = Annotated[User, Depends(require_role("viewer"))]
Operator = Annotated[User, Depends(require_role("operator"))]
Limit = Annotated[int, Query(ge=1, le=1000, description="Most batches, newest first")]
_LONGEST_MS = 93 * 86_400_000
"""Longest period of shifts or days: a quarter of a year."""
_COLUMNS = (
    *("number", "name", "started_s", "started_by", "ended_s", "ended_by", "complete", "products", "records"),
    *("volume_m3", "sigma_m3", "mass_t", "mass_sigma_t", "valid_m", "degraded_m", "missing_m"),
    *("scale_t", "scale_sigma_t", "density_kg_m3", "density_sigma_kg_m3", "moisture_percent", "disagrees"),
)


class ProductSettingOut(ResponseModel):
    """A product that can be chosen."""

    name: str
    density_kg_m3: float
    sigma_kg_m3: float
    moisture_percent: float | None
    colour: str


class TrendOut(ResponseModel):
    """The trend of a product's density by the belt scale, over its batches."""

    product: str
    batches: int
    mean_kg_m3: float
    per_day_kg_m3: float
    sigma_per_day_kg_m3: Annotated[float | None, Field(description="Null for two batches")]


class ProductionOut(ResponseModel):
    """The present product and batch, and what there is to choose from."""

    product: Annotated[str, Field(description="Empty: none is defined")]
    products: list[ProductSettingOut]
    batch: BatchOut | None
    time_zone: str
    has_shifts: bool
    has_scale: bool
    has_reports: bool


class ChangeProduct(BaseModel):
    """The product that becomes the present one."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: Annotated[str, Field(min_length=1, max_length=60)]


class StartBatch(BaseModel):
    """Name of the batch, and its product if it is not the present one."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: Annotated[str, Field(min_length=1, max_length=60)]
    product: Annotated[str, Field(max_length=60)] = ""


class AddReading(BaseModel):
    """The counter of the belt scale, as a person read it."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    kg: Annotated[float, Field(ge=0, lt=1e15, allow_inf_nan=False)]
    at_ms: Annotated[int | None, Field(ge=0, le=4_102_444_800_000, description="Null: now")] = None


def make_router(context: AppContext) -> APIRouter:
    """Return the routes below /api/production; none where the system counts no production."""
    router = APIRouter(prefix="/api/production", tags=["production"])
    served = context.production
    if served is not None:
        _add_reading_routes(router, served)
        _add_period_routes(router, served.figures)
        _add_changing_routes(router, served)
    return router


def _add_reading_routes(router: APIRouter, served: ServedProduction) -> None:
    control, figures = served.control, served.figures

    @router.get("", responses=describe_refusals(503))
    def production(_: Viewer) -> ProductionOut:
        """The present product and batch, and what there is to choose from."""
        with map_history_errors():
            batch = control.history.open_batch
        return ProductionOut(
            product=control.tag.product,
            products=[ProductSettingOut(**product.model_dump()) for product in control.products],
            batch=None if batch is None else BatchOut.from_batch(batch, None),
            time_zone=control.settings.time_zone,
            has_shifts=bool(control.settings.shifts),
            has_scale=figures.scale is not None,
            has_reports=served.reports is not None,
        )

    @router.get("/batches", responses=describe_refusals(503))
    def batches(_: Viewer, since_ms: WallMs, until_ms: WallMs, limit: Limit = 100) -> list[BatchOut]:
        """The batches that touch a period, newest first."""
        check_period(since_ms, until_ms)
        with map_history_errors():
            return figures.list_batches(since_ms * MS_NS, until_ms * MS_NS, limit)

    @router.get(
        "/batches.csv",
        response_class=Response,
        responses=describe_refusals(503) | {200: {"content": {"text/csv": {}}, "description": "The table"}},
    )
    def batches_csv(_: Viewer, since_ms: WallMs, until_ms: WallMs) -> Response:
        """The batches that touch a period as a table, oldest first."""
        check_period(since_ms, until_ms)
        with map_history_errors():
            found = figures.list_batches(since_ms * MS_NS, until_ms * MS_NS, 100_000)
        headers = {"Content-Disposition": 'attachment; filename="beltscape_batches.csv"'}
        return Response(format_batches(found[::-1]), media_type="text/csv; charset=utf-8", headers=headers)


def _add_period_routes(router: APIRouter, figures: ProductionFigures) -> None:
    @router.get("/periods", responses=describe_refusals(503))
    def periods(_: Viewer, since_ms: WallMs, until_ms: WallMs, kind: PeriodKind = "shift") -> list[PeriodOut]:
        """The shifts or days that touch a period of at most a quarter of a year, oldest first."""
        check_period(since_ms, until_ms)
        if until_ms - since_ms > _LONGEST_MS:
            reason = "more than 93 days after since_ms"
            raise HTTPException(422, [{"loc": ["query", "until_ms"], "msg": reason, "type": "value_error"}])
        with map_history_errors():
            found = figures.list_periods(kind, since_ms * MS_NS, until_ms * MS_NS)
            return [figures.count_period(period) for period in found]

    @router.get("/trends", responses=describe_refusals(503))
    def trends(_: Viewer) -> list[TrendOut]:
        """The trend of every product's density by the belt scale, over its newest batches."""
        with map_history_errors():
            found = figures.fit_trends(time.time_ns())
        return [
            TrendOut(
                product=one.product,
                batches=one.trend.count,
                mean_kg_m3=one.trend.mean_kg_m3,
                per_day_kg_m3=one.trend.per_day_kg_m3,
                sigma_per_day_kg_m3=None if one.trend.count < 3 else one.trend.sigma_per_day_kg_m3,
            )
            for one in found
        ]


def _add_changing_routes(router: APIRouter, served: ServedProduction) -> None:
    control = served.control

    @router.post("/product", responses=describe_refusals(409, 503))
    def change_product(body: ChangeProduct, user: Operator) -> Done:
        """Make a product the present one, from the next record on."""
        with _map_refusals():
            if not control.change_product(body.name, user.name):
                raise HTTPException(409, f"{body.name} is the present product already")
        return Done(by=user.name)

    @router.post("/batch/start", responses=describe_refusals(409, 503))
    def start_batch(body: StartBatch, user: Operator) -> Done:
        """Start a batch with the next record."""
        with _map_refusals():
            control.start_batch(body.name, body.product, user.name)
        return Done(by=user.name)

    @router.post("/batch/stop", responses=describe_refusals(409, 503))
    def stop_batch(user: Operator) -> Done:
        """Stop the open batch; belt that is in view is still counted for it."""
        with _map_refusals():
            control.stop_batch(user.name)
        return Done(by=user.name)

    @router.post("/scale", responses=describe_refusals(409, 503))
    def add_reading(body: AddReading, user: Operator) -> Done:
        """Store the counter of the belt scale."""
        if served.figures.scale is None:
            raise HTTPException(409, "the settings have no [scale]")
        now_ns = time.time_ns()
        at_ns = now_ns if body.at_ms is None else body.at_ms * MS_NS
        if at_ns > now_ns:
            raise HTTPException(409, "at_ms lies in the future")
        with _map_refusals():
            control.history.add_readings([ScaleReading(at_ns, body.kg, "page", user.name)])
        return Done(by=user.name)


@contextmanager
def _map_refusals() -> Generator[None]:
    """Answer what is refused with 409, and what cannot be kept with 503."""
    try:
        yield
    except InputError as error:
        raise HTTPException(409, str(error)) from error
    except OutputError as error:
        raise HTTPException(503, str(error)) from error


def format_batches(batches: Sequence[BatchOut]) -> str:
    """Return batches as CSV; unknown values are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for batch in batches:
        scale = batch.scale
        weighed = (
            [None] * 6
            if scale is None
            else [scale.mass_t, scale.sigma_t, scale.density_kg_m3, scale.sigma_kg_m3,
                  scale.moisture_percent, int(scale.disagrees)]
        )  # fmt: skip
        names = ";".join(one.product for one in batch.by_product if one.product)
        ended_s = None if batch.ended_ms is None else batch.ended_ms / 1000
        totals = [getattr(batch.totals, name) for name in SumsOut.model_fields]
        writer.writerow([
            batch.number, _cell(batch.name), batch.started_ms / 1000, batch.started_by, ended_s, batch.ended_by,
            int(batch.complete), _cell(names), *totals, *weighed,
        ])  # fmt: skip
    return text.getvalue()


def _cell(text: str) -> str:
    """Return a name that no spreadsheet takes for a formula."""
    return f"'{text}" if text[:1] in "=+-@" and text else text


ReportKey = Annotated[str, Path(pattern=r"^\d{8}T\d{4}Z_(shift|day)$", description="Name of a report")]
ReportForm = Literal["html", "pdf", "json"]
_MEDIA: dict[ReportForm, str] = {
    "html": "text/html; charset=utf-8",
    "pdf": "application/pdf",
    "json": "application/json",
}

_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; sandbox"
"""A report is complete in itself, with its style inside; it runs no script and reaches nothing of the page."""


class ReportOut(ResponseModel):
    """A report that was written."""

    key: str
    title: str
    since_ms: int
    until_ms: int
    has_pdf: bool
    is_mailed: bool
    is_printed: bool


def make_reports_router(context: AppContext) -> APIRouter:
    """Return the routes below /api/reports; none where the system counts no production."""
    router = APIRouter(prefix="/api/reports", tags=["production"])
    production = context.production
    if production is None:
        return router

    def require_writer() -> ReportWriter:
        if production.reports is None:
            raise HTTPException(404, "the settings have no [reports]")
        return production.reports

    @router.get("", responses=describe_refusals(404))
    def list_reports(_: Viewer, limit: Annotated[int, Query(ge=1, le=500)] = 60) -> list[ReportOut]:
        """The newest reports, newest first."""
        writer = require_writer()
        return [found for key in writer.list_keys()[:limit] if (found := _describe(writer, key)) is not None]

    @router.get(
        "/{key}",
        response_class=FileResponse,
        responses=describe_refusals(404)
        | {200: {"content": {kind: {} for kind in _MEDIA.values()}, "description": "The report"}},
    )
    def report(
        _: Viewer, key: ReportKey, form: Annotated[ReportForm, Query(alias="format")] = "html"
    ) -> FileResponse:
        """A report as HTML, PDF or its figures as JSON."""
        path = require_writer().find_file(key, f".{form}")
        if path is None:
            raise HTTPException(404, "there is no such report")
        return FileResponse(
            path,
            media_type=_MEDIA[form],
            filename=path.name,
            content_disposition_type="inline",
            headers={"content-security-policy": _POLICY} if form == "html" else None,
        )

    return router


def _describe(writer: ReportWriter, key: str) -> ReportOut | None:
    """Return a report of the list; None where its file is damaged."""
    try:
        document = writer.read(key)
    except InputError:
        return None
    return ReportOut(
        key=key,
        title=make_title(document),
        since_ms=document.period.since_ms,
        until_ms=document.period.until_ms,
        has_pdf=writer.find_file(key, ".pdf") is not None,
        is_mailed=writer.is_mailed(key),
        is_printed=writer.is_printed(key),
    )
