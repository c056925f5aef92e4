// The current flow and the totals.
import { $, create_element, create_icon, create_svg, set_text, throttle } from "./dom.js";
import { store } from "./store.js";
import { format_date_time, format_moment, format_number, format_percent, format_signed_percent, format_significant, format_uncertainty, format_unit, t } from "./texts.js";

// a flow without a record newer than the allowed age, also between two messages
const UNKNOWN = { volume_m3_h: null, sigma_m3_h: null, mass_t_h: null, mass_sigma_t_h: null, area_m2: null, coverage: null, trend: "unknown", change: null, standing: "missing" };
let last = null; // the last flow that was current, and when

function render() {
  const state = store.state;
  if (!state) return;
  const { frames } = state;
  const live = store.link === "live";
  const is_old = store.flow_age_s == null || store.flow_age_s > store.stale_s;
  const flow = is_old ? { ...state.flow, ...UNKNOWN } : state.flow;
  if (live && flow.volume_m3_h != null) last = { value: flow.volume_m3_h, wall_ms: state.wall_ms };
  set_text($("flow-volume"), live ? format_significant(flow.volume_m3_h) : "–");
  set_text($("flow-sigma"), live && flow.sigma_m3_h != null ? format_uncertainty(flow.sigma_m3_h) : "");
  const no_density = live && flow.mass_t_h == null && flow.volume_m3_h != null;
  $("flow-mass-line").hidden = no_density;
  $("flow-no-density").hidden = !no_density;
  set_text($("flow-mass"), live ? format_significant(flow.mass_t_h) : "–");
  set_text($("flow-mass-sigma"), live && flow.mass_sigma_t_h ? format_uncertainty(flow.mass_sigma_t_h) : "");
  const is_shown = live && flow.volume_m3_h != null;
  $("flow-last").hidden = is_shown || !last;
  if (!is_shown && last) set_text($("flow-last"), t("flow.last", { value: format_unit(format_significant(last.value), "m3_h"), time: format_moment(last.wall_ms) }));
  show_standing(live ? flow : null);
  const is_stopped = frames.speed_m_s != null && Math.abs(frames.speed_m_s) < 0.001;
  show_trend(is_shown || (live && is_stopped) ? flow : null, is_stopped);
  show_rated(live ? flow : null);
  set_text($("flow-speed"), live ? format_unit(format_number(frames.speed_m_s, 2), "m_s") : "–");
  set_text($("flow-area"), live ? format_unit(format_number(flow.area_m2, 4), "m2") : "–");
  set_text($("flow-coverage"), live ? format_percent(flow.coverage) : "–");
  set_text($("flow-took"), live ? format_unit(format_number(frames.seconds, 2), "s") : "–");
  set_text($("flow-capacity"), live ? format_unit(format_significant(frames.capacity_m_s), "m_s") : "–");
  set_text($("flow-dropped"), live ? format_number(frames.dropped) : "–");
  show_totals(state.totals);
}

function show_standing(flow) {
  const chip = $("flow-standing");
  const maintained = Boolean(store.state.maintenance);
  const standing = flow && (flow.volume_m3_h == null ? "missing" : flow.standing);
  chip.dataset.standing = standing ?? "";
  set_text(chip, maintained ? t("maintenance.title") : standing ? t(`standing.${standing}`) : "");
  chip.title = standing ? t(`standing.${standing}_help`) : "";
}

function show_trend(flow, is_stopped) {
  const stopped = flow && is_stopped;
  const key = !flow ? "" : stopped ? "stopped" : flow.trend;
  const text = !flow ? "" : stopped ? t("flow.stopped") : t(`flow.trend_${flow.trend}`);
  const change = flow && !stopped && flow.change != null && flow.trend !== "unknown" ? `${format_signed_percent(flow.change)} ${t("flow.against_minute")}` : "";
  const line = $("flow-trend");
  if (line.dataset.trend !== key) line.replaceChildren(...(key ? [create_icon(key), create_element("b"), create_element("span")] : []));
  line.dataset.trend = key;
  if (key) {
    set_text(line.children[1], text);
    set_text(line.children[2], change);
  }
}

function show_rated(flow) {
  const full = store.page?.full_m3_h;
  $("flow-rated").hidden = !full || !flow || flow.volume_m3_h == null;
  if ($("flow-rated").hidden) return;
  const share = flow.volume_m3_h / full;
  $("flow-meter").value = Math.min(share, 1);
  set_text($("flow-share"), t("flow.of_rated", { share: format_percent(share) }));
}

function show_totals(totals) {
  set_text($("totals-since"), totals.since_ms ? t("totals.since", { time: format_date_time(totals.since_ms) }) : "");
  const box = $("totals");
  if (!box.firstChild) box.append(...create_totals());
  const belt_m = totals.valid_m + totals.degraded_m + totals.missing_m;
  set_text(box.querySelector("#total-volume").firstChild, format_number(totals.volume_m3, totals.volume_m3 < 1000 ? 1 : 0));
  set_text(box.querySelector("#total-volume small"), `${t("unit.m3")} ${format_uncertainty(totals.sigma_m3)}`);
  set_text(box.querySelector("#total-mass").firstChild, format_number(totals.mass_t, totals.mass_t < 1000 ? 1 : 0));
  set_text(box.querySelector("#total-mass small"), t("unit.t"));
  const in_km = belt_m >= 100000;
  set_text(box.querySelector("#total-belt").firstChild, format_number(in_km ? belt_m / 1000 : belt_m, in_km ? 1 : 0));
  set_text(box.querySelector("#total-belt small"), t(in_km ? "unit.km" : "unit.m"));
  show_ledger(box, totals, belt_m);
}

const STANDINGS = ["valid", "degraded", "missing"];

function create_totals() {
  const value = (key, id) => [create_element("dt", { "data-text": key }, t(key)), create_element("dd", { id }, create_element("span"), create_element("small"))];
  const sums = create_element("dl", { class: "sum" }, ...value("totals.volume", "total-volume"), ...value("totals.mass", "total-mass"), ...value("totals.belt", "total-belt"));
  const bar = create_svg("svg", { role: "img", preserveAspectRatio: "none", viewBox: "0 0 1000 10" },
    create_svg("defs", {}, create_svg("pattern", { id: "missing-hatch", width: 6, height: 6, patternUnits: "userSpaceOnUse" }, create_svg("path", { d: "M0 6 6 0", stroke: "var(--missing)", "stroke-width": 2 }))),
    ...STANDINGS.map((name) => create_svg("rect", { class: name, height: 10, ...(name === "missing" ? { fill: "url(#missing-hatch)" } : {}) })));
  const parts = create_element("dl", { class: "parts" }, ...STANDINGS.map((name) =>
    create_element("div", {}, create_element("dt", { class: "standing", "data-standing": name, "data-text": `standing.${name}` }, t(`standing.${name}`)), create_element("dd", { id: `total-${name}` }, create_element("span"), create_element("small")))));
  return [sums, create_element("div", { class: "ledger" }, bar), parts];
}

function show_ledger(box, totals, belt_m) {
  let x = 0;
  const labels = [];
  for (const name of STANDINGS) {
    const metres = totals[`${name}_m`];
    const share = belt_m > 0 ? metres / belt_m : 0;
    // a share above zero stays visible
    const width = share > 0 ? Math.max(share * 1000, 4) : 0;
    const rect = box.querySelector(`rect.${name}`);
    rect.setAttribute("x", Math.min(x, 1000 - width));
    rect.setAttribute("width", width);
    x += width;
    const cell = box.querySelector(`#total-${name}`);
    set_text(cell.firstChild, format_unit(format_number(metres, metres < 1000 ? 1 : 0), "m"));
    set_text(cell.lastChild, format_percent(share, 1));
    labels.push(`${t(`standing.${name}`)} ${format_percent(share, 1)}`);
  }
  box.querySelector(".ledger svg").setAttribute("aria-label", `${t("totals.share")}: ${labels.join(", ")}`);
}

export function start() {
  store.on("state", throttle(render));
  for (const subject of ["link", "texts", "page"]) store.on(subject, render);
  store.on("tick", () => { if (store.link === "live" && store.flow_age_s > store.stale_s) render(); });
}
