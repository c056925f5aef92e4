// The view of the alarms: key figures by ISA-18.2, the journal of a period, all alarms with priority and state.
import { compare_alarms, format_group } from "./alarms.js";
import { describe_suppression, format_title, translate_entry } from "./alarm_texts.js";
import { get } from "./api.js";
import { $, create_element, set_text } from "./dom.js";
import { store } from "./store.js";
import { apply_texts, format_date_time, format_number, format_percent, t } from "./texts.js";

const PERIODS = { h1: 3600, h8: 8 * 3600, h24: 24 * 3600, d7: 7 * 86400, d30: 30 * 86400 };
const RELOAD_MS = { h1: 5000, h8: 10000, h24: 10000, d7: 60000, d30: 60000 }; // long periods cost the service time
const ROWS = 300, FLOOD = 10;
let period = "h24", results = null, loaded_ms = -Infinity, is_loading = false, is_built = false, failed = false;
const is_open = () => !$("alarms-view").hidden;

function build() {
  const periods = create_element("div", { class: "segments", role: "group", "data-label": "history.preset", id: "journal-periods" },
    ...Object.keys(PERIODS).map((name) => create_element("button", { type: "button", "data-period": name, "data-text": `chart.${name}`, on: { click: () => choose_period(name) } })));
  const table = (id, key) => create_element("div", { class: "table", tabindex: 0, "data-label": key }, create_element("table", { id }));
  const panel = (name, key, more, ...inside) => create_element("section", { class: `panel ${name}` }, create_element("header", {}, create_element("h2", { "data-text": key }), ...more), ...inside);
  $("alarms-view").append(
    panel("figures", "alarms.figures", [periods], create_element("p", { class: "problem", id: "journal-problem", role: "alert", "data-text": "chart.failed", hidden: true }), create_element("p", { class: "problem", id: "flood", role: "status", hidden: true }),
      create_element("dl", { class: "facts", id: "figures" }), create_element("p", { class: "soft", "data-text": "alarms.figures_help" })),
    panel("top", "alarms.top", [], create_element("dl", { class: "facts", id: "top" }), create_element("p", { class: "nothing", id: "top-none", "data-text": "alarms.nothing" })),
    panel("journal", "alarms.journal", [create_element("a", { class: "plain small", id: "journal-csv", download: true, "data-text": "history.export_csv", "data-hint": "alarms.journal_of" })], table("journal", "alarms.journal")),
    panel("every", "alarms.all", [], table("every-alarm", "alarms.all")));
  apply_texts($("alarms-view"));
  is_built = true;
}

function choose_period(name) {
  period = name;
  loaded_ms = -Infinity;
  for (const button of $("journal-periods").children) button.setAttribute("aria-pressed", String(button.dataset.period === name));
  load();
}

async function load() {
  if (!is_open() || is_loading || performance.now() - loaded_ms < RELOAD_MS[period]) return;
  is_loading = true;
  loaded_ms = performance.now();
  const until_ms = Math.round(Date.now() + store.clock_ms) + 1000;
  const times = { since_ms: until_ms - PERIODS[period] * 1000, until_ms };
  try {
    const [figures, events, alarms] = await Promise.all([get("api/alarms/statistics", times), get("api/alarms/journal", { ...times, limit: ROWS, newest: true }), get("api/alarms")]);
    results = { figures, events, alarms };
    failed = false;
    $("journal-csv").href = `api/alarms/journal.csv?${new URLSearchParams(times)}`;
  } catch {
    failed = true;
  }
  is_loading = false;
  render();
}

function render() {
  if (!is_built || !is_open()) return;
  $("journal-problem").hidden = !failed;
  if (!results) return;
  show_figures(results.figures);
  show_top(results.figures.top);
  show_journal(results.events);
  show_alarms(results.alarms);
}

const list_titles = (names) => names.map(format_title).join(", ") || t("alarms.nothing");
const create_fact = ([name, value, hint, bad]) => create_element("div", { title: hint }, create_element("dt", {}, name), create_element("dd", { class: bad ? "bad" : null }, value));

function show_figures(found) {
  $("flood").hidden = !found.is_flood;
  set_text($("flood"), t("alarms.flood_now", { count: format_number(found.last_10_min) }));
  const priorities = Object.entries(found.by_priority).reverse().filter(([, count]) => count).map(([name, count]) => `${t(`priority.${name}`)} ${format_number(count)}`).join(" · ");
  $("figures").replaceChildren(...[
    [t("alarms.total"), format_number(found.count)],
    [t("alarms.by_priority"), priorities || t("alarms.nothing")],
    [t("alarms.mean"), format_number(found.mean_per_10_min, 2), null, found.mean_per_10_min > 1],
    [t("alarms.peak"), format_number(found.peak_per_10_min), null, found.peak_per_10_min > FLOOD],
    [t("alarms.last"), format_number(found.last_10_min), null, found.last_10_min > FLOOD],
    [t("alarms.flood"), format_percent(found.flood_share, 1), null, found.flood_share > 0],
    [t("alarms.chattering"), list_titles(found.chattering), t("alarms.chattering_help"), found.chattering.length],
    [t("alarms.stale"), list_titles(found.stale), null, found.stale.length],
  ].map(create_fact));
}

function show_top(top) {
  $("top-none").hidden = top.length > 0;
  $("top").replaceChildren(...top.map(({ name, count, share }) => create_fact([format_title(name), t("alarms.top_row", { count: format_number(count), share: format_percent(share) })])));
}

const create_head = (...keys) => create_element("thead", {}, create_element("tr", {}, ...keys.map((key) => create_element("th", { scope: "col" }, t(key)))));

function show_journal(events) {
  const rows = events.map((event) => create_element("tr", {}, create_element("td", { class: "when" }, format_date_time(event.wall_ms, true)), create_element("td", {}, translate_entry(event)), create_element("td", {}, event.by)));
  if (!rows.length) rows.push(create_element("tr", {}, create_element("td", { colspan: 3, class: "when" }, t("alarms.journal_none"))));
  $("journal").replaceChildren(create_head("history.when", "history.what", "history.who"), create_element("tbody", {}, ...rows));
}

function describe_state(alarm) {
  if (!alarm.suppression) return t(`alarm.${alarm.state}`);
  const { kind, reason, until_ms, by } = alarm.suppression;
  if (kind === "by_state") return describe_suppression(reason);
  return kind === "shelved" ? t("alarms.shelved_until", { time: format_date_time(until_ms), by, reason }) : t("action.out_of_service", { reason });
}

function show_alarms(alarms) {
  const rows = [...alarms].sort((a, b) => (b.state !== "clear") - (a.state !== "clear") || compare_alarms(a, b)).map((alarm) => {
    const why = t("alarms.rationale", { consequence: t(`consequence.${alarm.consequence}`), response: t(`response.${alarm.response}`) });
    return create_element("tr", { "data-state": alarm.state }, create_element("td", {}, format_title(alarm.name)), create_element("td", { title: why }, t(`priority.${alarm.priority}`)),
      create_element("td", {}, describe_state(alarm), alarm.first ? ` · ${t("alarms.first")}` : ""), create_element("td", {}, alarm.group ? format_group(alarm.group) : ""));
  });
  $("every-alarm").replaceChildren(create_head("alarms.alarm", "alarms.priority_head", "alarms.state", "alarms.group"), create_element("tbody", {}, ...rows));
}

export function open() {
  if (!is_built) {
    build();
    store.on("texts", render);
    store.on("tick", load);
    store.on("state", load);
  }
  choose_period(period);
}
