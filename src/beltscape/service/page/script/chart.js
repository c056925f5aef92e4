// Flow over time on the live view: the last minutes as they come, longer ranges from the history.
import { get } from "./api.js";
import { $, calm, make, say } from "./dom.js";
import { nothing_in, of_series, Plot } from "./plot.js";
import { store } from "./store.js";
import { t } from "./texts.js";

const RANGES = { m5: 300, m15: 900, h1: 3600, h8: 8 * 3600, h24: 24 * 3600 };
const LIVE = new Set(["m5", "m15"]);
const KEPT_S = 1000, GAP_S = 5, ASK_MS = 15000;
let live = [[], [], [], [], []];
let older = null; // columns from the history
let asked_ms = -Infinity;
let range = "m5";
let plot = null;

function add(message) {
  const rows = message.wall_ms.map((ms, i) => {
    const [value, sigma] = [message.m3_h[i], message.sigma[i]];
    const known = value != null && sigma != null;
    return [ms / 1000, value, known ? Math.max(value - sigma, 0) : null, known ? value + sigma : null, message.t_h[i]];
  });
  if (!rows.length) return;
  // after a reconnection the server tells again what is here already; a clock that was set back replaces what lies after it
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

function show() {
  if (!plot || $("live-view").hidden) return;
  const end = (Date.now() + store.clock_ms) / 1000;
  const columns = LIVE.has(range) ? live : older ?? [[], [], [], [], []];
  plot.show(columns, [end - RANGES[range], end]);
  const failed = !LIVE.has(range) && older === null && asked_ms > 0 && !asking;
  $("chart-none").hidden = !(failed || nothing_in(columns)) || (asking && !older);
  say($("chart-none"), t(failed ? "chart.failed" : "chart.none"));
}

let asking = false;

async function ask() {
  if (LIVE.has(range) || asking || $("live-view").hidden || performance.now() - asked_ms < ASK_MS) return;
  asking = true;
  asked_ms = performance.now();
  const [wanted, until_ms] = [range, Math.round(Date.now() + store.clock_ms)];
  try {
    const series = await get("/api/series", { since_ms: until_ms - RANGES[wanted] * 1000, until_ms, points: 480 });
    if (wanted === range) older = of_series(series);
  } catch {
    if (wanted === range) older = null;
  }
  asking = false;
  show();
}

/** What was before this page, or the program behind it, was opened: from the history. */
async function backfill() {
  const until_ms = Math.round(Date.now() + store.clock_ms);
  try {
    const before = of_series(await get("/api/series", { since_ms: until_ms - RANGES.m15 * 1000, until_ms, points: 180 }));
    const first = live[0][0] ?? until_ms / 1000;
    const end = before[0].findIndex((s) => s >= first);
    live = live.map((column, i) => [...(end < 0 ? before[i] : before[i].slice(0, end)), ...column]);
    show();
  } catch {
    // the chart then begins now
  }
}

export function choose(name) {
  range = name;
  older = null;
  asked_ms = -Infinity;
  for (const button of $("chart-ranges").children) button.setAttribute("aria-pressed", String(button.dataset.range === name));
  ask();
  show();
}

export function next() {
  const names = Object.keys(RANGES);
  choose(names[(names.indexOf(range) + 1) % names.length]);
}

export function start() {
  for (const name of Object.keys(RANGES))
    $("chart-ranges").append(make("button", { type: "button", "data-range": name, "data-text": `chart.${name}`, on: { click: () => choose(name) } }));
  plot = new Plot($("chart"));
  let filled = false;
  const calmly = calm(show);
  store.on("flow", (message) => {
    add(message);
    if (!filled) backfill();
    filled = true;
    calmly();
  });
  for (const subject of ["theme", "texts", "layout"]) store.on(subject, () => { plot.build(); show(); });
  store.on("tick", () => { ask(); if (store.link !== "live") return; show(); });
  choose("m5");
}
