// Flow now, and the totals.
import { $, calm, draw, make, say, sign } from "./dom.js";
import { store } from "./store.js";
import { day_and_time, moment, number, percent, signed_percent, spread, t, three, unit } from "./texts.js";

let last = null; // the last flow that was current, and when

function show() {
  const state = store.state;
  if (!state) return;
  const { flow, frames } = state;
  const live = store.link === "live";
  if (live && flow.volume_m3_h != null) last = { value: flow.volume_m3_h, wall_ms: state.wall_ms };
  say($("flow-volume"), live ? three(flow.volume_m3_h) : "–");
  say($("flow-sigma"), live && flow.sigma_m3_h != null ? spread(flow.sigma_m3_h) : "");
  const no_density = live && flow.mass_t_h == null && flow.volume_m3_h != null;
  $("flow-mass-line").hidden = no_density;
  $("flow-no-density").hidden = !no_density;
  say($("flow-mass"), live ? three(flow.mass_t_h) : "–");
  say($("flow-mass-sigma"), live && flow.mass_sigma_t_h ? spread(flow.mass_sigma_t_h) : "");
  $("flow-last").hidden = live || !last;
  if (!live && last) say($("flow-last"), t("flow.last", { value: unit(three(last.value), "m3_h"), time: moment(last.wall_ms) }));
  show_standing(live ? flow : null);
  show_trend(live ? flow : null, frames);
  show_rated(live ? flow : null);
  say($("flow-speed"), live ? unit(number(frames.speed_m_s, 2), "m_s") : "–");
  say($("flow-area"), live ? unit(number(flow.area_m2, 4), "m2") : "–");
  say($("flow-coverage"), live ? percent(flow.coverage) : "–");
  say($("flow-took"), live ? unit(number(frames.seconds, 2), "s") : "–");
  say($("flow-dropped"), live ? number(frames.dropped) : "–");
  show_totals(state.totals);
}

function show_standing(flow) {
  const chip = $("flow-standing");
  chip.dataset.standing = flow?.standing ?? "";
  say(chip, flow ? t(`standing.${flow.standing}`) : "");
  chip.title = flow ? t(`standing.${flow.standing}_help`) : "";
}

function show_trend(flow, frames) {
  const stopped = flow && frames.speed_m_s != null && frames.speed_m_s < 0.001;
  const key = !flow ? "" : stopped ? "stopped" : flow.trend;
  const text = !flow ? "" : stopped ? t("flow.stopped") : t(`flow.trend_${flow.trend}`);
  const change = flow && !stopped && flow.change != null && flow.trend !== "unknown" ? `${signed_percent(flow.change)} ${t("flow.against_minute")}` : "";
  const line = $("flow-trend");
  if (line.dataset.trend !== key) line.replaceChildren(...(key ? [sign(key), make("b"), make("span")] : []));
  line.dataset.trend = key;
  if (key) {
    say(line.children[1], text);
    say(line.children[2], change);
  }
}

function show_rated(flow) {
  const full = store.page?.full_m3_h;
  $("flow-rated").hidden = !full || !flow || flow.volume_m3_h == null;
  if ($("flow-rated").hidden) return;
  const share = flow.volume_m3_h / full;
  $("flow-meter").value = Math.min(share, 1);
  say($("flow-share"), t("flow.of_rated", { share: percent(share) }));
}

function show_totals(totals) {
  say($("totals-since"), totals.since_ms ? t("totals.since", { time: day_and_time(totals.since_ms) }) : "");
  const box = $("totals");
  if (!box.firstChild) box.append(...totals_parts());
  const belt_m = totals.valid_m + totals.degraded_m + totals.missing_m;
  say(box.querySelector("#total-volume").firstChild, number(totals.volume_m3, totals.volume_m3 < 1000 ? 1 : 0));
  say(box.querySelector("#total-volume small"), `${t("unit.m3")} ${spread(totals.sigma_m3)}`);
  say(box.querySelector("#total-mass").firstChild, number(totals.mass_t, totals.mass_t < 1000 ? 1 : 0));
  say(box.querySelector("#total-mass small"), t("unit.t"));
  const far = belt_m >= 100000;
  say(box.querySelector("#total-belt").firstChild, number(far ? belt_m / 1000 : belt_m, far ? 1 : 0));
  say(box.querySelector("#total-belt small"), t(far ? "unit.km" : "unit.m"));
  show_ledger(box, totals, belt_m);
}

const STANDINGS = ["valid", "degraded", "missing"];

function totals_parts() {
  const value = (key, id) => [make("dt", { "data-text": key }, t(key)), make("dd", { id }, make("span"), make("small"))];
  const sums = make("dl", { class: "sum" }, ...value("totals.volume", "total-volume"), ...value("totals.mass", "total-mass"), ...value("totals.belt", "total-belt"));
  const bar = draw("svg", { role: "img", preserveAspectRatio: "none", viewBox: "0 0 1000 10" },
    draw("defs", {}, draw("pattern", { id: "missing-hatch", width: 6, height: 6, patternUnits: "userSpaceOnUse" }, draw("path", { d: "M0 6 6 0", stroke: "var(--missing)", "stroke-width": 2 }))),
    ...STANDINGS.map((name) => draw("rect", { class: name, height: 10, ...(name === "missing" ? { fill: "url(#missing-hatch)" } : {}) })));
  const parts = make("dl", { class: "parts" }, ...STANDINGS.map((name) =>
    make("div", {}, make("dt", { class: "standing", "data-standing": name, "data-text": `standing.${name}` }, t(`standing.${name}`)), make("dd", { id: `total-${name}` }, make("span"), make("small")))));
  return [sums, make("div", { class: "ledger" }, bar), parts];
}

function show_ledger(box, totals, belt_m) {
  let x = 0;
  const said = [];
  for (const name of STANDINGS) {
    const metres = totals[`${name}_m`];
    const share = belt_m > 0 ? metres / belt_m : 0;
    // what is there is seen, however little it is
    const width = share > 0 ? Math.max(share * 1000, 4) : 0;
    const rect = box.querySelector(`rect.${name}`);
    rect.setAttribute("x", Math.min(x, 1000 - width));
    rect.setAttribute("width", width);
    x += width;
    const cell = box.querySelector(`#total-${name}`);
    say(cell.firstChild, unit(number(metres, metres < 1000 ? 1 : 0), "m"));
    say(cell.lastChild, percent(share, 1));
    said.push(`${t(`standing.${name}`)} ${percent(share, 1)}`);
  }
  box.querySelector(".ledger svg").setAttribute("aria-label", `${t("totals.share")}: ${said.join(", ")}`);
}

export function start() {
  store.on("state", calm(show));
  for (const subject of ["link", "texts", "page"]) store.on(subject, show);
}
