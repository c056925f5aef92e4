// The engineer's view of the system's checks: state, trend and limit of each, and the cameras' pictures with the place of a fault.
import { explain, format_limit, format_title, format_value, format_value_and_sigma } from "./alarm_texts.js";
import { get } from "./api.js";
import { $, create_element, create_icon, create_svg, set_text, sync_children } from "./dom.js";
import { store } from "./store.js";
import { apply_texts, format_date_time, format_duration, t } from "./texts.js";
import * as learn from "./learn.js";
import * as settings from "./settings.js";
import * as drift from "./drift.js";
import * as zero from "./zero.js";

const PERIODS = { h1: 3600, h8: 8 * 3600, h24: 24 * 3600, d7: 7 * 86400, d30: 30 * 86400 };
const RELOAD_MS = 2000, TREND_MS = 30000, POINTS = 240;
const WIDTH = 480, HEIGHT = 72, PAD = 4;
let period = "h8", is_built = false, is_loading = false, is_drawing = false, loaded_ms = -Infinity, checks = null, failed = null;
const trends = new Map(); // series and its loading time by key
const visible = new Set();
const observer = new IntersectionObserver((entries) => {
  for (const entry of entries) if (entry.isIntersecting) visible.add(entry.target); else visible.delete(entry.target);
  load_trends();
});

const get_key = (one) => `${one.check}:${one.subject}`;
const is_open = () => !$("health-view").hidden;
export const is_allowed = () => store.page?.role === "engineer";

function build() {
  const periods = create_element("div", { class: "segments", role: "group", "data-label": "history.preset", id: "health-periods" },
    ...Object.keys(PERIODS).map((name) => create_element("button", { type: "button", "data-period": name, "data-text": `chart.${name}`, on: { click: () => choose_period(name) } })));
  const panel = (name, key, ...inside) => create_element("section", { class: `panel ${name}` }, create_element("header", {}, create_element("h2", { "data-text": key }), ...inside.slice(0, 1)), ...inside.slice(1));
  $("health-view").append(
    create_element("p", { class: "printed", id: "health-printed" }),
    panel("pictures", "health.pictures", create_element("span"), create_element("ul", { id: "health-pictures" }), create_element("p", { class: "nothing", id: "health-pictures-none", "data-text": "cameras.none" })),
    zero.create_panel(),
    learn.create_panel(),
    settings.create_panel(),
    drift.create_panel(),
    panel("checks", "health.checks", periods, create_element("p", { class: "problem", id: "health-problem", role: "alert", hidden: true }), create_element("p", { class: "soft", id: "health-summary" }), create_element("ul", { id: "checks" }), create_element("p", { class: "nothing", id: "health-none", "data-text": "health.none", hidden: true })));
  apply_texts($("health-view"));
  choose_period(period);
  is_built = true;
}

function choose_period(name) {
  period = name;
  trends.clear();
  for (const button of $("health-periods").children) button.setAttribute("aria-pressed", String(button.dataset.period === name));
  load_trends();
}

/** Return the state of a check: missing, degraded, fault, unknown or ok. */
function find_state(one) {
  if (one.fault) return one.effect === "none" ? "fault" : one.effect;
  return one.value == null ? "unknown" : "ok";
}

const ICON = { missing: "critical", degraded: "warning", fault: "warning", unknown: "unknown", ok: "ok" };
const ORDER = ["missing", "degraded", "fault", "ok", "unknown"];

async function load_checks() {
  if (!is_allowed() || is_loading || performance.now() - loaded_ms < RELOAD_MS) return;
  is_loading = true;
  loaded_ms = performance.now();
  try {
    checks = await get("api/checks");
    failed = null;
  } catch (error) {
    failed = error.status === 403 ? "health.role" : "health.failed";
  }
  is_loading = false;
  render();
}

function render() {
  if (!is_built || !is_open()) return;
  $("health-problem").hidden = !failed;
  if (failed) set_text($("health-problem"), t(failed));
  const listed = [...(checks ?? [])].sort((a, b) => ORDER.indexOf(find_state(a)) - ORDER.indexOf(find_state(b)));
  $("health-none").hidden = listed.length > 0 || checks === null;
  const faults = listed.filter((one) => one.fault).length;
  set_text($("health-summary"), listed.length ? t(faults ? "health.faults" : "health.sound", { faults, checks: listed.length }) : "");
  sync_children($("checks"), listed, get_key, create_check, update_check);
  zero.show(listed);
  set_text($("health-printed"), `${store.page?.plant || t("title")} · ${format_date_time(Date.now() + store.clock_ms)}`);
  show_pictures();
  load_trends();
}

function create_check() {
  const item = create_element("li", { class: "check" }, create_element("div", { class: "about" }, create_element("h3"), create_element("span", { class: "state" }, create_icon("ok"), create_element("span")), create_element("p", { class: "value" }), create_element("p", { class: "soft help" })),
    create_element("div", { class: "trend-plot" }));
  observer.observe(item);
  return item;
}

function update_check(item, one) {
  const state = find_state(one);
  const [heading, chip, value, help] = item.firstChild.children;
  set_text(heading, format_title(get_key(one).replace(/:$/, "")));
  if (item.dataset.state !== state) chip.replaceChild(create_icon(ICON[state]), chip.firstChild);
  item.dataset.state = state;
  set_text(chip.lastChild, t(`health.${state}`));
  const parts = [one.value == null ? "" : format_value_and_sigma(one.value, one.sigma, one.unit),
    one.limit == null ? "" : t("health.limit", { limit: format_limit(one.limit, one.unit) }), one.value != null && one.age_s > 10 ? t("health.age", { age: format_duration(one.age_s) }) : ""];
  set_text(value, parts.filter(Boolean).join(" · "));
  set_text(help, one.fault ? explain({ name: get_key(one), detail: one.text, cause: one.cause, values: one.values }) : "");
  help.hidden = !one.fault;
  item.check = one;
}

async function load_trends() {
  if (!is_built || is_drawing || !is_open()) return;
  is_drawing = true;
  const chosen = period;
  const stored = await list_stored();
  // the others follow once, so that a printed page is complete
  const others = [...$("checks").children].filter((item) => item.check && !visible.has(item) && !trends.has(get_key(item.check)));
  for (const item of [...visible, ...others]) {
    const one = item.check;
    if (!one || chosen !== period || !is_open()) continue;
    const key = get_key(one);
    const known = trends.get(key);
    if (!known || performance.now() - known.loaded_ms > TREND_MS) {
      const series = stored.has(key) ? await load_series(one, chosen) ?? known?.series : null;
      if (chosen !== period) break;
      trends.set(key, { series, loaded_ms: performance.now() });
      draw(item.lastChild, series, one);
    } else if (!item.lastChild.firstChild) draw(item.lastChild, known.series, one);
  }
  is_drawing = false;
  if (chosen !== period) load_trends();
}

/** Return the keys of the checks that have a series. */
async function list_stored() {
  try {
    return new Set((await get("api/checks/stored")).map(get_key));
  } catch {
    return new Set();
  }
}

/** Return the series of a check over a period until now; null if it cannot be read at the moment. */
async function load_series({ check, subject }, name) {
  const until_ms = Math.round(Date.now() + store.clock_ms);
  try {
    return await get("api/checks/series", { check, subject, since_ms: until_ms - PERIODS[name] * 1000, until_ms, points: POINTS });
  } catch {
    return null;
  }
}

const is_number = (value) => value != null;

/** Draw the trend with its range, its limit and marks where it was a fault. */
function draw(host, series, one) {
  const known = (series?.mean ?? []).some(is_number);
  if (!known) { host.replaceChildren(create_element("p", { class: "soft" }, t("health.no_trend"))); return; }
  const limits = series.limit.filter(is_number);
  const all = [...series.low, ...series.high].filter(is_number);
  const [least, most] = [Math.min(...all), Math.max(...all)];
  // a limit far from the values is shown at the edge
  const span = Math.max(most - least, Math.abs(most) * 0.02, 1e-9);
  const near = limits.filter((limit) => limit < most + 3 * span && limit > least - 3 * span);
  const [low, high] = [Math.min(least, ...near) - span * 0.1, Math.max(most, ...near) + span * 0.1];
  const x = (i) => PAD + i / Math.max(series.mean.length - 1, 1) * (WIDTH - 2 * PAD);
  const y = (value) => PAD + (high - value) / (high - low) * (HEIGHT - 2 * PAD);
  const svg = create_svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none", role: "img", "aria-label": t("health.trend", { check: format_title(get_key(one)) }) });
  series.faults.forEach((count, i) => { if (count) svg.append(create_svg("rect", { class: "fault", x: x(i) - 1, y: 0, width: Math.max(WIDTH / series.mean.length, 2), height: HEIGHT })); });
  for (const piece of split_pieces(series)) {
    const band = [...piece.map((i) => `${x(i)} ${y(series.high[i])}`), ...piece.toReversed().map((i) => `${x(i)} ${y(series.low[i])}`)];
    svg.append(create_svg("path", { class: "band", d: `M${band.join("L")}z` }), create_svg("path", { class: "outline", d: `M${piece.map((i) => `${x(i)} ${y(series.mean[i])}`).join("L")}h.01` }));
  }
  if (near.length) svg.append(create_svg("path", { class: "limit", d: `M0 ${y(near.at(-1))}H${WIDTH}` }));
  const scale = create_element("p", { class: "soft scale" }, create_element("span", {}, `${format_value(least, one.unit)} – ${format_value(most, one.unit)}`), create_element("span", {}, t("totals.since", { time: format_date_time(series.start_ms[0]) })));
  host.replaceChildren(svg, scale);
}

/** Return the runs of measured intervals; short gaps are bridged, because unchanged values are stored rarely. */
function split_pieces(series) {
  const longest = Math.max(1, Math.ceil(30000 / series.width_ms));
  const pieces = [];
  let last = -Infinity;
  series.mean.forEach((value, i) => {
    if (value == null) return;
    if (i - last > longest) pieces.push([]);
    pieces.at(-1).push(i);
    last = i;
  });
  return pieces;
}

function show_pictures() {
  const cameras = store.state?.cameras ?? [];
  $("health-pictures-none").hidden = cameras.length > 0;
  sync_children($("health-pictures"), cameras, (camera) => camera.name, create_picture, update_picture);
}

function create_picture(camera) {
  return create_element("li", { class: "picture" }, create_element("figure", {}, create_element("img", { alt: "", decoding: "async" }), create_svg("svg", { viewBox: "0 0 1 1", preserveAspectRatio: "none", "aria-hidden": "true" })), create_element("p", {}, create_element("b", {}, camera.name), create_element("span")));
}

function update_picture(item, camera) {
  const [image, overlay] = item.firstChild.children;
  const faults = (checks ?? []).filter((one) => one.subject === camera.name && one.fault);
  image.alt = t("cameras.picture", { name: camera.name });
  if (camera.picture !== null && image.dataset.frame !== camera.picture && performance.now() - Number(image.dataset.loaded ?? -RELOAD_MS) >= RELOAD_MS) {
    image.dataset.frame = camera.picture;
    image.dataset.loaded = performance.now();
    image.src = `api/cameras/${encodeURIComponent(camera.name)}/picture?frame=${encodeURIComponent(camera.picture)}`;
  }
  overlay.replaceChildren(...faults.filter((one) => one.place).map(({ place: [left, top, right, bottom] }) => create_svg("rect", { x: left, y: top, width: right - left, height: bottom - top, "vector-effect": "non-scaling-stroke" })));
  item.dataset.state = faults.length ? "fault" : "ok";
  set_text(item.lastChild.lastChild, faults.length ? ` ${faults.map((one) => format_title(one.check)).join(", ")}` : ` ${t(`camera.${camera.state}`)}`);
}

export function open() {
  if (!is_allowed()) return;
  if (!is_built) build();
  loaded_ms = -Infinity;
  load_checks();
}

export function start() {
  store.on("tick", () => { if (is_open() && !document.hidden) load_checks(); });
  for (const subject of ["texts", "theme"]) store.on(subject, () => { trends.clear(); render(); });
}
