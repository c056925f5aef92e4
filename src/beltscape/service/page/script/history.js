// The history view: a period chosen by preset or dates, with its curve, sums, days, events, cross-sections and exports.
import { translate_entry } from "./alarm_texts.js";
import { get } from "./api.js";
import { $, create_element, set_text } from "./dom.js";
import { is_empty, Plot, read_series } from "./plot.js";
import { SectionPlot } from "./section.js";
import { store } from "./store.js";
import { apply_texts, format_date_time, format_day, format_measured, format_number, format_unit, get_language, has_text, t } from "./texts.js";

const PRESETS = { h1: 3600, h8: 8 * 3600, h24: 24 * 3600, d7: 7 * 86400, d30: 30 * 86400 };
let plot = null, section_plot = null, period = null, results = null;

function build() {
  const field = (id, key) => create_element("label", {}, create_element("span", { "data-text": key }), create_element("input", { id, type: "datetime-local", step: "1", required: true }));
  const presets = create_element("div", { class: "segments", role: "group", "data-label": "history.preset", id: "history-presets" },
    ...Object.keys(PRESETS).map((name) => create_element("button", { type: "button", "data-preset": name, "data-text": `chart.${name}`, on: { click: () => choose_preset(name) } })));
  const form = create_element("form", { novalidate: true }, presets, field("history-from", "history.from"), field("history-to", "history.to"), create_element("button", { class: "plain", "data-text": "history.show" }),
    create_element("div", { class: "exports" }, create_element("span", { class: "soft", "data-text": "history.export" }),
      create_element("a", { class: "plain", id: "export-csv", download: true, "data-text": "history.export_csv", "data-hint": "history.export_of" }),
      create_element("a", { class: "plain", id: "export-parquet", download: true, "data-text": "history.export_parquet", "data-hint": "history.export_of" })));
  form.addEventListener("submit", (event) => { event.preventDefault(); load_by_dates(); });
  const panel = (name, key, ...inside) => create_element("section", { class: `panel ${name}` }, create_element("header", {}, create_element("h2", { "data-text": key })), ...inside);
  $("history-view").append(
    create_element("section", { class: "panel period" }, create_element("header", {}, create_element("h2", { "data-text": "history.title" })), form, create_element("p", { class: "problem", id: "history-problem", role: "alert", hidden: true })),
    panel("curve chart", "chart.title_unit", create_element("div", { class: "plot", id: "history-chart", role: "img", "data-label": "chart.label" }), create_element("p", { class: "nothing", id: "history-none", hidden: true })),
    panel("side section", "section.title", create_element("div", { class: "plot", id: "history-section" }), create_element("p", { class: "nothing", id: "history-section-none", "data-text": "history.section_help" })),
    panel("events", "history.events", create_element("div", { class: "table", tabindex: 0, "data-label": "history.events" }, create_element("table", { id: "history-events" }))),
    panel("days", "history.days", create_element("div", { class: "table", tabindex: 0, "data-label": "history.days" }, create_element("table", { id: "history-days", class: "stacked" }))),
    panel("sums", "history.sum", create_element("dl", { class: "facts", id: "history-sums" })));
  apply_texts($("history-view"));
  plot = new Plot($("history-chart"), show_section);
  section_plot = new SectionPlot($("history-section"));
}

const now_ms = () => Math.round(Date.now() + store.clock_ms);

function choose_preset(name) {
  const until_ms = now_ms();
  for (const button of $("history-presets").children) button.setAttribute("aria-pressed", String(button.dataset.preset === name));
  load_period(until_ms - PRESETS[name] * 1000, until_ms);
}

function load_by_dates() {
  const [since_ms, until_ms] = ["history-from", "history-to"].map((id) => new Date($(id).value).getTime());
  for (const button of $("history-presets").children) button.setAttribute("aria-pressed", "false");
  if (until_ms > since_ms) load_period(since_ms, until_ms);
  else show_problem("history.wrong");
}

function show_problem(key) {
  $("history-problem").hidden = !key;
  if (key) set_text($("history-problem"), t(key));
}

function format_local(ms) {
  const date = new Date(ms - new Date(ms).getTimezoneOffset() * 60000);
  return date.toISOString().slice(0, 19);
}

async function load_period(since_ms, until_ms) {
  show_problem(null);
  period = { since_ms, until_ms };
  [$("history-from").value, $("history-to").value] = [format_local(since_ms), format_local(until_ms)];
  for (const format of ["csv", "parquet"]) $(`export-${format}`).href = `api/export?${new URLSearchParams({ since_ms, until_ms, format })}`;
  const requested = period;
  try {
    const [series, events, days] = await Promise.all([get("api/series", { since_ms, until_ms, points: 800 }), get("api/events", { since_ms, until_ms, limit: 300 }), get("api/days", { since_ms: Math.max(since_ms - 86400000, 0), until_ms })]);
    if (requested !== period) return;
    results = { series, events, days };
  } catch {
    if (requested === period) show_problem("chart.failed");
    return;
  }
  render();
}

function render() {
  if (!results) return;
  const { series, events, days } = results;
  const columns = read_series(series);
  plot.show(columns, [period.since_ms / 1000, period.until_ms / 1000]);
  $("history-none").hidden = !is_empty(columns);
  set_text($("history-none"), t("chart.none"));
  show_sums(series);
  show_events(events);
  show_days(days);
}

const sum = (values) => values.reduce((total, value) => total + (value ?? 0), 0);

function show_sums(series) {
  const rows = [["totals.volume", format_unit(format_number(sum(series.volume_m3), 1), "m3")], ["totals.mass", series.mass_t.includes(null) ? "–" : format_unit(format_number(sum(series.mass_t), 1), "t")],
    ...["valid", "degraded", "missing"].map((name) => [`standing.${name}`, format_unit(format_number(sum(series[`${name}_m`]), 1), "m"), name])];
  $("history-sums").replaceChildren(...rows.map(([key, value, standing]) => create_element("div", {}, create_element("dt", standing ? { class: "standing", "data-standing": standing } : {}, t(key)), create_element("dd", {}, value))));
}

/** Return an event's text in the chosen language; what a person wrote is kept. */
function translate_event(event) {
  const { kind, name, text, parameters } = event;
  if (kind === "maintenance") return t(`event.maintenance_${name}`, { reason: parameters.reason ?? text, minutes: format_number(parameters.minutes ?? null) });
  if (kind === "zero") return t("event.zero_set", Object.fromEntries(Object.entries(parameters).map(([part, value]) => [part, format_number(value, 2)])));
  if (kind === "product") return t(parameters.before ? "event.product_instead" : "event.product", { name, before: parameters.before });
  if (kind === "batch") return t(`event.batch_${parameters.action ?? "start"}`, { name });
  if (kind === "scale") return t("event.scale", { batch: parameters.batch, deviation: format_measured(parameters.deviation, parameters.sigma) });
  if (kind === "report") return t("event.report", { title: text });
  if (kind === "images") return t("event.images_learn");
  if (kind === "certificate") return parameters.number ? t("event.certificate_in_force", { number: parameters.number }) : t("event.certificate_none");
  if (kind === "settings") return t(`event.settings_${name}`, { changed: parameters.changed || "–", restart: parameters.restart || "–", record: parameters.record });
  if (kind === "exposure") return t("event.exposure_changed", { exposure: format_number(parameters.exposure_us, 0), factor: format_number(parameters.factor, 2), level: format_number(parameters.level, 0) });
  if (kind === "capacity") return t("event.capacity_measured", { rate: format_number(parameters.rate, 1), speed: format_number(parameters.speed, 2) });
  if (kind === "recording") return `${t("event.recording")}: ${text} (${name})`;
  if (kind === "worker") return get_language() === "en" ? `${t("event.worker_replaced")}: ${text}` : t("event.worker_replaced");
  if (kind === "note") return get_language() !== "en" && has_text(`event.note_${name}`) ? t(`event.note_${name}`) : `${name} – ${text}`;
  return kind === "alarm" ? translate_entry(event) : `${name} – ${text}`;
}

function show_events(events) {
  const head = create_element("tr", {}, ...["history.when", "history.what", "history.who"].map((key) => create_element("th", { scope: "col" }, t(key))));
  const rows = events.map((event) => create_element("tr", {}, create_element("td", { class: "when" }, format_date_time(event.wall_ms, true)),
    create_element("td", {}, translate_event(event)), create_element("td", {}, event.by)));
  if (!rows.length) rows.push(create_element("tr", {}, create_element("td", { colspan: 3, class: "when" }, t("history.no_events"))));
  $("history-events").replaceChildren(create_element("thead", {}, head), create_element("tbody", {}, ...rows));
}

function show_days(days) {
  const names = ["history.day", "totals.volume", "totals.mass", "standing.valid", "standing.degraded", "standing.missing"];
  const head = create_element("tr", {}, ...names.map((key, i) => create_element("th", { scope: "col", class: i ? "number" : "" }, t(key))));
  const rows = [...days].reverse().map((one) => {
    const cells = [[one.volume_m3, "m3"], [one.mass_t, "t"], [one.valid_m, "m"], [one.degraded_m, "m"], [one.missing_m, "m"]];
    return create_element("tr", {}, create_element("td", { class: "when" }, format_day(new Date(`${one.day}T12:00`))), ...cells.map(([value, name], i) => create_element("td", { class: "number", "data-name": t(names[i + 1]) }, format_unit(format_number(value, 1), name))));
  });
  $("history-days").replaceChildren(create_element("thead", {}, head), create_element("tbody", {}, ...rows));
}

/** Show the cross-section of the first record from an instant on. */
async function show_section(seconds) {
  const since_ms = Math.round(seconds * 1000 - results.series.width_ms / 2);
  try {
    const [record] = await get("api/records", { since_ms, until_ms: period.until_ms, limit: 1 });
    const section = await get("api/section", { number: record.number });
    $("history-section-none").hidden = true;
    section_plot.show(section);
    set_text($("history-view").querySelector(".side h2"), t("history.section", { time: format_date_time(record.wall_ms, true) }));
  } catch {
    section_plot.show(null);
    $("history-section-none").hidden = false;
    set_text($("history-section-none"), t("section.none"));
  }
}

export function open() {
  if (!plot) {
    build();
    for (const subject of ["theme", "texts"]) store.on(subject, () => { plot.build(); section_plot.draw(); render(); });
  }
  choose_preset(document.querySelector("#history-presets [aria-pressed=true]")?.dataset.preset ?? "h8");
}
