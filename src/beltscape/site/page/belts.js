// One card for each belt: its flow, load and health, or since when it is away.
import { $, create_element, create_icon, set_text, sync_children } from "../page/script/dom.js";
import { format_duration, format_measured, format_moment, format_number, format_percent, format_significant, format_uncertainty, format_unit, t } from "../page/script/texts.js";

const FACTS = ["speed", "area", "coverage", "cameras", "total"];
const LABELS = { speed: "flow.speed", area: "flow.area", coverage: "flow.coverage", cameras: "cameras.title", total: "totals.title" };
const ICONS = { live: "ok", stopped: "steady", stale: "warning", maintenance: "info", away: "lost" };

/** Return a fault of a belt and its fix in the chosen language. */
export function explain_fault({ key, values }) {
  const shown = Object.fromEntries(Object.entries(values).map(([name, value]) => [name, name.endsWith("_s") ? format_duration(Math.abs(value)) : value]));
  return t(`site.fault.${key}`, shown);
}

function find_state(belt) {
  if (belt.is_away) return "away";
  if (belt.maintenance != null) return "maintenance";
  if (belt.speed_m_s != null && Math.abs(belt.speed_m_s) < 0.001) return "stopped";
  return belt.flow?.volume_m3_h == null ? "stale" : "live";
}

function create_card(belt) {
  const facts = FACTS.map((name) => create_element("div", {}, create_element("dt", { "data-text": LABELS[name] }, t(LABELS[name])), create_element("dd", { "data-fact": name })));
  return create_element("li", { class: "panel card" },
    create_element("header", {}, create_element("a", { href: belt.url, target: "_blank", rel: "noopener" }), create_element("span", { class: "chip" })),
    create_element("p", { class: "big" }, create_element("output", { "aria-live": "off" }), create_element("span", { class: "unit" })),
    create_element("p", { class: "second" }),
    create_element("dl", { class: "facts" }, ...facts),
    create_element("div", { class: "faults" }));
}

function update_card(card, belt) {
  const state = find_state(belt);
  const [header, big, second, , faults] = card.children;
  set_text(header.children[0], belt.name);
  const chip = header.children[1];
  if (card.dataset.state !== state) chip.replaceChildren(create_icon(ICONS[state]), create_element("span"));
  card.dataset.state = state;
  set_text(chip.lastChild, state === "away" && belt.age_s != null ? t("site.away_for", { age: format_duration(belt.age_s) }) : t(`site.${state}`));
  show_flow(big, second, belt);
  const { flow } = belt;
  const values = {
    speed: format_unit(format_number(belt.speed_m_s, 2), "m_s"),
    area: format_unit(format_number(flow?.area_m2, 4), "m2"),
    coverage: format_percent(flow?.coverage),
    cameras: belt.cameras ? `${format_number(belt.cameras.ok)} / ${format_number(belt.cameras.all)}` : "–",
    total: format_total(belt.totals),
  };
  for (const cell of card.querySelectorAll("dd")) set_text(cell, values[cell.dataset.fact]);
  const lines = belt.faults.map(explain_fault);
  if (belt.is_away && belt.last_ms) lines.unshift(t("site.away_line", { time: format_moment(belt.last_ms) }));
  if (belt.waiting > 500) lines.push(t("site.catching_up", { count: format_number(belt.waiting) }));
  sync_children(faults, lines, (line) => line, () => create_element("p", { class: "fault" }), (item, line) => set_text(item, line));
}

/** Show the mass flow, or the volume flow where the density is not known. */
function show_flow(big, second, { flow }) {
  const has_mass = flow?.mass_t_h != null;
  set_text(big.children[0], format_significant(has_mass ? flow.mass_t_h : flow?.volume_m3_h));
  set_text(big.children[1], t(has_mass ? "unit.t_h" : "unit.m3_h"));
  const sigma = has_mass ? flow.mass_sigma_t_h : flow?.sigma_m3_h;
  const volume = has_mass ? format_unit(format_significant(flow.volume_m3_h), "m3_h") : "";
  set_text(second, [flow ? format_uncertainty(sigma) : "", volume].filter(Boolean).join(" · "));
}

function format_total(totals) {
  if (!totals) return "–";
  if (totals.mass_t != null) return format_unit(format_number(totals.mass_t, totals.mass_t < 1000 ? 1 : 0), "t");
  return `${totals.sigma_m3 ? format_measured(totals.volume_m3, totals.sigma_m3) : format_number(totals.volume_m3, 1)}\u00a0${t("unit.m3")}`;
}

export function show_belts(belts) {
  sync_children($("belts"), belts, (belt) => belt.name, create_card, update_card);
}
