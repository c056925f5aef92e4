// The history: a period by presets or dates, its curve, sums, days, events and cross-sections, and the tables to take away.
import { title } from "./alarms.js";
import { get } from "./api.js";
import { $, make, say } from "./dom.js";
import { nothing_in, of_series, Plot } from "./plot.js";
import { SectionPlot } from "./section.js";
import { store } from "./store.js";
import { apply, day, day_and_time, number, t, unit } from "./texts.js";

const PRESETS = { h1: 3600, h8: 8 * 3600, h24: 24 * 3600, d7: 7 * 86400, d30: 30 * 86400 };
let plot = null, cut = null, period = null, found = null;

function build() {
  const field = (id, key) => make("label", {}, make("span", { "data-text": key }), make("input", { id, type: "datetime-local", step: "1", required: true }));
  const presets = make("div", { class: "segments", role: "group", "data-label": "history.preset", id: "history-presets" },
    ...Object.keys(PRESETS).map((name) => make("button", { type: "button", "data-preset": name, "data-text": `chart.${name}`, on: { click: () => choose(name) } })));
  const form = make("form", { novalidate: true }, presets, field("history-from", "history.from"), field("history-to", "history.to"), make("button", { class: "plain", "data-text": "history.show" }),
    make("div", { class: "exports" }, make("span", { class: "soft", "data-text": "history.export" }),
      make("a", { class: "plain", id: "export-csv", download: true, "data-text": "history.export_csv", "data-hint": "history.export_of" }),
      make("a", { class: "plain", id: "export-parquet", download: true, "data-text": "history.export_parquet", "data-hint": "history.export_of" })));
  form.addEventListener("submit", (event) => { event.preventDefault(); by_dates(); });
  const panel = (name, key, ...inside) => make("section", { class: `panel ${name}` }, make("header", {}, make("h2", { "data-text": key })), ...inside);
  $("history-view").append(
    make("section", { class: "panel period" }, make("header", {}, make("h2", { "data-text": "history.title" })), form, make("p", { class: "problem", id: "history-problem", role: "alert", hidden: true })),
    panel("curve chart", "chart.title", make("div", { class: "plot", id: "history-chart", role: "img", "data-label": "chart.label" }), make("p", { class: "nothing", id: "history-none", hidden: true })),
    panel("side section", "section.title", make("div", { class: "plot", id: "history-section" }), make("p", { class: "nothing", id: "history-section-none", "data-text": "history.section_help" })),
    panel("events", "history.events", make("div", { class: "table", tabindex: 0, "data-label": "history.events" }, make("table", { id: "history-events" }))),
    panel("days", "history.days", make("div", { class: "table", tabindex: 0, "data-label": "history.days" }, make("table", { id: "history-days" }))),
    panel("sums", "history.sum", make("dl", { class: "facts", id: "history-sums" })));
  apply($("history-view"));
  plot = new Plot($("history-chart"), show_section);
  cut = new SectionPlot($("history-section"));
}

const now_ms = () => Math.round(Date.now() + store.clock_ms);

function choose(name) {
  const until_ms = now_ms();
  for (const button of $("history-presets").children) button.setAttribute("aria-pressed", String(button.dataset.preset === name));
  ask(until_ms - PRESETS[name] * 1000, until_ms);
}

function by_dates() {
  const [since_ms, until_ms] = ["history-from", "history-to"].map((id) => new Date($(id).value).getTime());
  for (const button of $("history-presets").children) button.setAttribute("aria-pressed", "false");
  if (until_ms > since_ms) ask(since_ms, until_ms);
  else problem("history.wrong");
}

function problem(key) {
  $("history-problem").hidden = !key;
  if (key) say($("history-problem"), t(key));
}

function local(ms) {
  const date = new Date(ms - new Date(ms).getTimezoneOffset() * 60000);
  return date.toISOString().slice(0, 19);
}

async function ask(since_ms, until_ms) {
  problem(null);
  period = { since_ms, until_ms };
  [$("history-from").value, $("history-to").value] = [local(since_ms), local(until_ms)];
  for (const format of ["csv", "parquet"]) $(`export-${format}`).href = `/api/export?${new URLSearchParams({ since_ms, until_ms, format })}`;
  const wanted = period;
  try {
    const [series, events, days] = await Promise.all([get("/api/series", { since_ms, until_ms, points: 800 }), get("/api/events", { since_ms, until_ms, limit: 300 }), get("/api/days", { since_ms: Math.max(since_ms - 86400000, 0), until_ms })]);
    if (wanted !== period) return;
    found = { series, events, days };
  } catch {
    if (wanted === period) problem("chart.failed");
    return;
  }
  show();
}

function show() {
  if (!found) return;
  const { series, events, days } = found;
  const columns = of_series(series);
  plot.show(columns, [period.since_ms / 1000, period.until_ms / 1000]);
  $("history-none").hidden = !nothing_in(columns);
  say($("history-none"), t("chart.none"));
  show_sums(series);
  show_events(events);
  show_days(days);
}

const sum = (values) => values.reduce((total, value) => total + (value ?? 0), 0);

function show_sums(series) {
  const rows = [["totals.volume", unit(number(sum(series.volume_m3), 1), "m3")], ["totals.mass", series.mass_t.includes(null) ? "–" : unit(number(sum(series.mass_t), 1), "t")],
    ...["valid", "degraded", "missing"].map((name) => [`standing.${name}`, unit(number(sum(series[`${name}_m`]), 1), "m"), name])];
  $("history-sums").replaceChildren(...rows.map(([key, value, standing]) => make("div", {}, make("dt", standing ? { class: "standing", "data-standing": standing } : {}, t(key)), make("dd", {}, value))));
}

/** What is said of an alarm begins with its state, which has its own word in every language. */
function worded(text) {
  const state = /^(raised|acknowledged|gone|clear)\b/.exec(text)?.[0];
  return state ? t(`alarm.${state}`) + text.slice(state.length) : text;
}

function show_events(events) {
  const head = make("tr", {}, ...["history.when", "history.what", "history.who"].map((key) => make("th", { scope: "col" }, t(key))));
  const rows = events.map((event) => make("tr", {}, make("td", { class: "when" }, day_and_time(event.wall_ms, true)),
    make("td", {}, [event.kind === "alarm" ? title(event.name) : event.name, worded(event.text)].filter(Boolean).join(" – ")), make("td", {}, event.by)));
  if (!rows.length) rows.push(make("tr", {}, make("td", { colspan: 3, class: "when" }, t("history.no_events"))));
  $("history-events").replaceChildren(make("thead", {}, head), make("tbody", {}, ...rows));
}

function show_days(days) {
  const names = ["history.day", "totals.volume", "totals.mass", "standing.valid", "standing.degraded", "standing.missing"];
  const head = make("tr", {}, ...names.map((key, i) => make("th", { scope: "col", class: i ? "number" : "" }, t(key))));
  const rows = [...days].reverse().map((one) => {
    const cells = [[one.volume_m3, "m3"], [one.mass_t, "t"], [one.valid_m, "m"], [one.degraded_m, "m"], [one.missing_m, "m"]];
    return make("tr", {}, make("td", { class: "when" }, day(new Date(`${one.day}T12:00`))), ...cells.map(([value, name]) => make("td", { class: "number" }, unit(number(value, 1), name))));
  });
  $("history-days").replaceChildren(make("thead", {}, head), make("tbody", {}, ...rows));
}

/** The cross-section of the first record from an instant on. */
async function show_section(seconds) {
  const since_ms = Math.round(seconds * 1000 - found.series.width_ms / 2);
  try {
    const [record] = await get("/api/records", { since_ms, until_ms: period.until_ms, limit: 1 });
    const section = await get("/api/section", { number: record.number });
    $("history-section-none").hidden = true;
    cut.show(section);
    say($("history-view").querySelector(".side h2"), t("history.section", { time: day_and_time(record.wall_ms, true) }));
  } catch {
    cut.show(null);
    $("history-section-none").hidden = false;
    say($("history-section-none"), t("section.none"));
  }
}

export function open() {
  if (!plot) {
    build();
    for (const subject of ["theme", "texts"]) store.on(subject, () => { plot.build(); cut.draw(); show(); });
  }
  choose(document.querySelector("#history-presets [aria-pressed=true]")?.dataset.preset ?? "h8");
}
