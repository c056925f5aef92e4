// The tables of the production view: batches, shifts and days, reports, the belt scale.
import { get, post } from "./api.js";
import { $, create_element, set_text } from "./dom.js";
import { store } from "./store.js";
import { apply_texts, format_date_time, format_measured, format_number, format_time, format_unit, t } from "./texts.js";

const BATCHES_MS = 30 * 86400000, PERIODS_MS = 7 * 86400000;
let results = null, kind = "shift", has_scale = false;

const now_ms = () => Math.round(Date.now() + store.clock_ms);

export function build(panel) {
  const table = (id, key) => create_element("div", { class: "table", tabindex: 0, "data-label": key }, create_element("table", { id, class: "stacked" }));
  const kinds = create_element("div", { class: "segments", role: "group", id: "period-kinds", "data-label": "production.periods" },
    ...["shift", "day"].map((name) => create_element("button", { type: "button", "data-kind": name, "data-text": `production.${name}s`, on: { click: () => { kind = name; load(); } } })));
  const csv = create_element("a", { class: "plain small", id: "batches-csv", download: true, "data-text": "production.csv" });
  return [panel("batches", "production.batches", create_element("div", { class: "exports" }, csv), table("batches", "production.batches")),
    panel("periods", "production.periods", kinds, table("periods", "production.periods")),
    panel("scale", "production.scale", create_element("p", { class: "soft", "data-text": "production.scale_help" }), table("trends", "production.scale")),
    panel("reports", "production.reports", table("reports", "production.reports")),
    create_element("dialog", { id: "production-dialog", "aria-labelledby": "production-dialog-title" })];
}

export async function load() {
  const until_ms = now_ms();
  $("batches-csv").href = `api/production/batches.csv?${new URLSearchParams({ since_ms: until_ms - 12 * BATCHES_MS, until_ms })}`;
  for (const button of $("period-kinds").children) button.setAttribute("aria-pressed", String(button.dataset.kind === kind));
  try {
    const { has_reports } = await get("api/production");
    const [batches, periods, trends, reports] = await Promise.all([
      get("api/production/batches", { since_ms: until_ms - BATCHES_MS, until_ms, limit: 200 }),
      get("api/production/periods", { since_ms: until_ms - PERIODS_MS, until_ms, kind }),
      get("api/production/trends"), has_reports ? get("api/reports") : []]);
    results = { batches, periods: periods.filter((one) => one.totals.records > 0).reverse(), trends, reports, has_reports };
  } catch {
    return; // the banner tells that the connection is lost
  }
  render();
}

export function show_scale(is_there) {
  has_scale = is_there;
  $("production-scale-title").closest("section").hidden = !is_there;
}

export function render() {
  if (!results) return;
  show_batches();
  show_periods();
  show_trends();
  show_reports();
  apply_texts($("production-view"));
}

export const format_mass = (totals) => (totals.mass_t == null ? "–" : format_unit(with_sigma(totals.mass_t, totals.mass_sigma_t), "t"));
export const format_volume = (totals) => format_unit(with_sigma(totals.volume_m3, totals.sigma_m3), "m3");
const with_sigma = (value, sigma) => (value == null ? "–" : sigma > 0 ? format_measured(value, sigma) : format_number(value, value ? 3 : 0));

/** Return how much of the belt was measured, in words. */
export function describe_belt(totals) {
  const length = totals.valid_m + totals.degraded_m + totals.missing_m;
  return t("production.belt", { length: format_number(length, 1), degraded: format_number(totals.degraded_m, 1), missing: format_number(totals.missing_m, 1) });
}

function fill(id, columns, rows, empty) {
  const head = create_element("tr", {}, ...columns.map((key, i) => create_element("th", { scope: "col", class: i ? "number" : "" }, key ? t(key) : "")));
  const lines = rows.map((cells) => create_element("tr", {}, ...cells.map((cell, i) => create_element("td", i ? { class: "number", "data-name": columns[i] ? t(columns[i]) : "" } : {}, cell))));
  if (!rows.length) lines.push(create_element("tr", {}, create_element("td", { colspan: columns.length, class: "when" }, t(empty))));
  $(id).replaceChildren(create_element("thead", {}, head), create_element("tbody", {}, ...lines));
}

const SCALE_COLUMNS = ["production.weighed", "production.density", "production.moisture", "production.deviation"];

function list_scale_cells(scale) {
  if (!scale || scale.mass_t == null) return [scale?.reason ? t("production.not_weighed") : "–", "–", "–", "–"];
  const deviation = create_element("span", scale.disagrees ? { class: "disagrees" } : {}, with_sigma(scale.deviation_t, scale.deviation_sigma_t) + (scale.disagrees ? ` ${t("production.disagrees")}` : ""));
  return [format_unit(with_sigma(scale.mass_t, scale.sigma_t), "t"), with_sigma(scale.density_kg_m3, scale.sigma_kg_m3), with_sigma(scale.moisture_percent, scale.moisture_sigma_percent), deviation];
}

function show_batches() {
  const columns = ["production.batch", "production.started", "production.stopped", "production.product", "totals.volume", "totals.mass", "standing.missing", ...(has_scale ? [...SCALE_COLUMNS, ""] : [])];
  const rows = results.batches.map((batch) => [create_element("b", {}, batch.name), format_date_time(batch.started_ms),
    batch.ended_ms == null ? t("production.open") : format_date_time(batch.ended_ms) + (batch.complete ? "" : ` (${t("production.in_view")})`),
    batch.by_product.map((one) => one.product).filter(Boolean).join(", ") || "–", format_volume(batch.totals), format_mass(batch.totals), format_unit(format_number(batch.totals.missing_m, 1), "m"),
    ...(has_scale ? [...list_scale_cells(batch.scale), make_scale_button(batch)] : [])]);
  fill("batches", columns, rows, "production.no_batches");
}

function make_scale_button(batch) {
  if (batch.ended_ms == null || store.page?.role === "viewer") return "";
  return create_element("button", { type: "button", class: "plain small", on: { click: () => ask_counter(batch) } }, t("production.type_counter"));
}

function show_periods() {
  const columns = [`production.${kind}`, "production.from", "production.until", "totals.volume", "totals.mass", "standing.valid", "standing.degraded", "standing.missing", ...(has_scale ? SCALE_COLUMNS : [])];
  const rows = results.periods.map((one) => [create_element("b", {}, one.kind === "day" ? one.day : one.name), format_date_time(one.since_ms), one.kind === "day" ? format_date_time(one.until_ms) : format_time(one.until_ms, false), format_volume(one.totals), format_mass(one.totals),
    ...["valid_m", "degraded_m", "missing_m"].map((name) => format_unit(format_number(one.totals[name], 1), "m")), ...(has_scale ? list_scale_cells(one.scale) : [])]);
  fill("periods", columns, rows, kind === "shift" ? "production.no_shifts" : "production.no_days");
}

function show_trends() {
  const rows = results.trends.map((one) => [create_element("b", {}, one.product || "–"), format_number(one.batches), format_number(one.mean_kg_m3, 0),
    one.sigma_per_day_kg_m3 == null ? "–" : with_sigma(one.per_day_kg_m3, one.sigma_per_day_kg_m3)]);
  fill("trends", ["production.product", "production.batches", "production.mean_density", "production.trend"], rows, "production.no_trend");
}

function show_reports() {
  $("production-reports-title").closest("section").hidden = !results.has_reports;
  const link = (key, format) => create_element("a", { class: "plain small", href: `api/reports/${key}?format=${format}`, target: "_blank", rel: "noopener" }, format.toUpperCase());
  const rows = results.reports.map((one) => [create_element("b", {}, one.title), format_date_time(one.since_ms), create_element("span", { class: "links" }, link(one.key, "html"), one.has_pdf ? link(one.key, "pdf") : ""), [one.is_mailed && t("production.mailed"), one.is_printed && t("production.printed")].filter(Boolean).join(", ")]);
  fill("reports", ["production.report", "production.from", "", ""], rows, "production.no_reports");
}

/** Ask before a change is made. */
export function ask(title, help, action, on_yes) {
  show_dialog(title, help, [], action, on_yes);
}

function show_dialog(title, help, fields, action, on_submit) {
  const dialog = $("production-dialog");
  const problem = create_element("p", { class: "problem", role: "alert", hidden: true });
  const form = create_element("form", {}, create_element("h2", { id: "production-dialog-title" }, title), create_element("p", {}, help), ...fields, problem,
    create_element("div", { class: "row" }, create_element("button", { type: "button", class: "plain", on: { click: () => dialog.close() } }, t("keep.cancel")), create_element("button", { class: "plain main" }, action)));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    try {
      await on_submit();
      dialog.close();
    } catch {
      problem.hidden = false;
      set_text(problem, t("production.not_kept", { reason: "" }));
    }
  });
  dialog.replaceChildren(form);
  dialog.showModal();
}

/** Ask for the counter of the scale at begin and end of a batch. */
function ask_counter(batch) {
  const field = (id, key) => [create_element("label", { for: id }, t(key)), create_element("input", { id, type: "number", min: 0, step: "any", required: true, inputmode: "decimal" })];
  const fields = [...field("counter-begin", "production.counter_begin"), ...field("counter-end", "production.counter_end")];
  show_dialog(t("production.counter_title", { name: batch.name }), t("production.counter_help"), fields, t("production.keep"), async () => {
    await post("api/production/scale", { kg: Number($("counter-begin").value), at_ms: batch.started_ms });
    await post("api/production/scale", { kg: Number($("counter-end").value), at_ms: batch.ended_ms });
    await load();
  });
}
