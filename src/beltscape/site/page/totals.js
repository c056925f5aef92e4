// Totals by hours, shifts or days: a row for each period, a column for each belt and one for the site.
import { get } from "../page/script/api.js";
import { $, create_element } from "../page/script/dom.js";
import { format_number, format_short_day, format_time, t } from "../page/script/texts.js";

const KINDS = { hour: 24, shift: 12, day: 31 };
const PERIOD_MS = 15_000;
let kind = "hour";
let shown = null;

async function read_totals() {
  try {
    shown = await get("api/site/totals", { kind, count: KINDS[kind] });
    show_totals();
  } catch { /* the link's lamp shows it; the next reading comes */ }
}

function choose_kind(chosen) {
  kind = chosen;
  for (const button of $("kinds").children) button.setAttribute("aria-pressed", String(button.dataset.kind === kind));
  return read_totals();
}

function format_period({ start_ms, end_ms, name }) {
  const day = format_short_day(start_ms);
  if (kind === "day") return day;
  const times = `${format_time(start_ms, false)}–${format_time(end_ms, false)}`;
  return name ? `${day} · ${name} · ${times}` : `${day} · ${times}`;
}

/** Return a cell: the mass in t, or the volume in m³ where a density is not known. */
function create_cell(sums, column) {
  const is_known = sums.mass_t != null || sums.volume_m3 != null;
  const is_nothing = !sums.is_complete && sums.records === 0;
  const text = !is_known || is_nothing ? "–" : sums.mass_t != null ? `${format_number(sums.mass_t, 1)} ${t("unit.t")}` : `${format_number(sums.volume_m3, 1)} ${t("unit.m3")}`;
  const is_open = !sums.is_complete;
  return create_element("td", { class: `number ${column} ${is_open ? "open" : ""}`, title: is_open ? t("site.not_complete") : null }, is_open && text !== "–" ? `≥ ${text}` : text);
}

export function show_totals() {
  for (const button of $("kinds").children) button.textContent = t(`site.kind_${button.dataset.kind}`);
  if (!shown) return;
  const names = shown.belts.map((belt) => belt.name);
  const counted = shown.belts.filter((belt) => belt.in_total).map((belt) => belt.name).join(" + ");
  const heads = [create_element("th", {}, t("site.period")), ...names.map((name) => create_element("th", { class: "number" }, name)), create_element("th", { class: "number of-site", title: counted }, t("site.site"))];
  $("totals").tHead.replaceChildren(create_element("tr", {}, ...heads));
  $("totals").tBodies[0].replaceChildren(...shown.periods.map((period) => create_element("tr", { class: period.is_running ? "running" : "" },
    create_element("td", { class: "when" }, format_period(period)), ...names.map((name) => create_cell(period.belts[name], "")), create_cell(period.site, "of-site"))));
}

export async function start_totals() {
  $("kinds").append(...Object.keys(KINDS).map((name) => create_element("button", { type: "button", "data-kind": name, on: { click: () => choose_kind(name) } })));
  show_totals();
  await choose_kind(kind);
  setInterval(read_totals, PERIOD_MS);
}
