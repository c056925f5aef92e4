// The flow chart of the live view: the last minutes from the live stream, longer ranges from the history.
import { get } from "./api.js";
import { $, create_element, set_text, throttle } from "./dom.js";
import { is_empty, Plot, read_series } from "./plot.js";
import { store } from "./store.js";
import { t } from "./texts.js";

const RANGES = { m5: 300, m15: 900, h1: 3600, h8: 8 * 3600, h24: 24 * 3600 };
const LIVE = new Set(["m5", "m15"]);
const KEPT_S = 1000, GAP_S = 5, RELOAD_MS = 15000;
let live = [[], [], [], [], []];
let older = null; // columns from the history
let loaded_ms = -Infinity;
let range = "m5";
let plot = null;

function add_points(message) {
  const rows = message.wall_ms.map((ms, i) => {
    const [value, sigma] = [message.m3_h[i], message.sigma[i]];
    const known = value != null && sigma != null;
    return [ms / 1000, value, known ? Math.max(value - sigma, 0) : null, known ? value + sigma : null, message.t_h[i]];
  });
  if (!rows.length) return;
  // after a reconnection the server repeats its points; a clock that was set back replaces later ones
  const first = rows[0][0];
  const cut = live[0].findIndex((s) => s >= first);
  if (cut >= 0) live = live.map((column) => column.slice(0, cut));
  for (const row of rows) {
    const before = live[0].at(-1);
    if (before !== undefined && row[0] - before > GAP_S) [before + 0.5, null, null, null, null].forEach((value, i) => live[i].push(value));
    row.forEach((value, i) => live[i].push(value));
  }
  const old = live[0].findIndex((s) => s > live[0].at(-1) - KEPT_S);
  if (old > 200) live = live.map((column) => column.slice(old));
}

function render() {
  if (!plot || $("live-view").hidden) return;
  const end = (Date.now() + store.clock_ms) / 1000;
  const columns = LIVE.has(range) ? live : older ?? [[], [], [], [], []];
  plot.show(columns, [end - RANGES[range], end]);
  const failed = !LIVE.has(range) && older === null && loaded_ms > 0 && !is_loading;
  $("chart-none").hidden = !(failed || is_empty(columns)) || (is_loading && !older);
  set_text($("chart-none"), t(failed ? "chart.failed" : "chart.none"));
}

let is_loading = false;

async function load_history() {
  if (LIVE.has(range) || is_loading || $("live-view").hidden || performance.now() - loaded_ms < RELOAD_MS) return;
  is_loading = true;
  loaded_ms = performance.now();
  const [requested, until_ms] = [range, Math.round(Date.now() + store.clock_ms)];
  try {
    const series = await get("api/series", { since_ms: until_ms - RANGES[requested] * 1000, until_ms, points: 480 });
    if (requested === range) older = read_series(series);
  } catch {
    if (requested === range) older = null;
  }
  is_loading = false;
  render();
}

/** Load the minutes before this page, or the program, was started from the history. */
async function backfill() {
  const until_ms = Math.round(Date.now() + store.clock_ms);
  try {
    const before = read_series(await get("api/series", { since_ms: until_ms - RANGES.m15 * 1000, until_ms, points: 180 }));
    const first = live[0][0] ?? until_ms / 1000;
    const end = before[0].findIndex((s) => s >= first);
    live = live.map((column, i) => [...(end < 0 ? before[i] : before[i].slice(0, end)), ...column]);
    render();
  } catch {
    // without the history the chart begins now
  }
}

export function choose_range(name) {
  range = name;
  older = null;
  loaded_ms = -Infinity;
  for (const button of $("chart-ranges").children) button.setAttribute("aria-pressed", String(button.dataset.range === name));
  load_history();
  render();
}

export function next_range() {
  const names = Object.keys(RANGES);
  choose_range(names[(names.indexOf(range) + 1) % names.length]);
}

export function start() {
  for (const name of Object.keys(RANGES))
    $("chart-ranges").append(create_element("button", { type: "button", "data-range": name, "data-text": `chart.${name}`, on: { click: () => choose_range(name) } }));
  plot = new Plot($("chart"));
  let is_filled = false;
  const render_throttled = throttle(render);
  store.on("flow", (message) => {
    add_points(message);
    if (!is_filled) backfill();
    is_filled = true;
    render_throttled();
  });
  for (const subject of ["theme", "texts", "layout"]) store.on(subject, () => { plot.build(); render(); });
  store.on("tick", () => { load_history(); if (store.link !== "live") return; render(); });
  choose_range("m5");
}
