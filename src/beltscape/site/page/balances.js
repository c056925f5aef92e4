// Transfer points: what comes in against what goes out, with the limit and the newest windows.
import { $, create_element, create_icon, create_svg, set_text, sync_children } from "../page/script/dom.js";
import { format_duration, format_measured, format_number, format_time, format_unit, t } from "../page/script/texts.js";

const ICONS = { balanced: "ok", imbalance: "critical", incomplete: "warning", none: "waiting" };

function create_item() {
  return create_element("li", { class: "balance" },
    create_element("div", {}, create_element("h3"), create_element("p", { class: "ways" }), create_element("p", { class: "verdict" })),
    create_element("dl"),
    create_svg("svg", { class: "windows", viewBox: "0 0 240 60", preserveAspectRatio: "none", role: "img" }),
    create_element("p", { class: "waits", hidden: true }));
}

function update_item(item, balance) {
  const { last } = balance;
  const state = last?.state ?? "none";
  const [title, list, chart, waits] = item.children;
  set_text(title.children[0], balance.name);
  set_text(title.children[1], `${balance.inflow.join(" + ")} → ${balance.outflow.join(" + ")}`);
  const verdict = title.children[2];
  if (item.dataset.state !== state) verdict.replaceChildren(create_icon(ICONS[state]), create_element("span"));
  item.dataset.state = state;
  set_text(verdict.lastChild, describe_state(last));
  list.replaceChildren(...list_values(balance));
  draw_windows(chart, balance);
  waits.hidden = balance.waits_for.length === 0;
  if (!waits.hidden) set_text(waits, t("site.waits_for", { belts: balance.waits_for.join(", ") }));
}

function describe_state(last) {
  if (!last) return t("site.balance_none");
  if (last.state !== "incomplete") return t(`site.balance_${last.state}`);
  return t("site.balance_incomplete", { belt: last.belt, reason: t(`site.reason.${last.reason}`) });
}

function list_values({ last, unit, sigmas, window_min }) {
  const rows = [["site.window", last ? `${format_time(last.start_ms, window_min < 2)}–${format_time(last.end_ms, window_min < 2)}` : format_duration(window_min * 60)]];
  if (last?.difference != null) {
    const digits = last.inflow < 100 ? 2 : 1;
    rows.push(["site.inflow", format_unit(format_number(last.inflow, digits), unit)], ["site.outflow", format_unit(format_number(last.outflow, digits), unit)]);
    rows.push(["site.difference", format_unit(last.sigma > 0 ? format_measured(Math.abs(last.difference) < last.sigma / 100 ? 0 : last.difference, last.sigma) : format_number(last.difference, digits), unit)]);
    rows.push(["site.limit", format_unit(`± ${format_number(sigmas * last.sigma, digits)}`, unit)]);
  }
  return rows.flatMap(([key, value]) => [create_element("dt", {}, t(key)), create_element("dd", {}, value)]);
}

/** Draw inflow − outflow of the newest windows in parts of the limit; the band is the limit. */
function draw_windows(chart, { windows, sigmas }) {
  const middle = 30;
  const unit = 14; // of the drawing, for one limit
  const width = 240 / 24;
  const bars = windows.map((one, i) => {
    const x = (24 - windows.length + i) * width + 1;
    if (one.difference == null) return create_svg("rect", { class: "incomplete", x, y: 0, width: width - 2, height: 60 });
    const limit = sigmas * one.sigma || 1e-9;
    const length = Math.max(-middle, Math.min(middle, (one.difference / limit) * unit));
    return create_svg("rect", { class: one.state, x, y: middle - Math.max(length, 0), width: width - 2, height: Math.max(Math.abs(length), 1) });
  });
  chart.replaceChildren(create_svg("rect", { class: "band", x: 0, y: middle - unit, width: 240, height: 2 * unit }), ...bars, create_svg("line", { class: "mean", x1: 0, x2: 240, y1: middle, y2: middle }));
  chart.setAttribute("aria-label", t("site.windows_label"));
}

export function show_balances(balances) {
  $("balances-none").hidden = balances.length > 0;
  sync_children($("balances"), balances, (balance) => balance.name, create_item, update_item);
}
