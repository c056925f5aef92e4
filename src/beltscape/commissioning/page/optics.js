// Exposure, focus and aperture: every camera's picture with its histogram and its sharpness over the image.
import { get } from "../page/script/api.js";
import { create_element, create_svg, set_text, sync_children } from "../page/script/dom.js";
import { format_number, format_percent, t } from "../page/script/texts.js";

const PERIOD_MS = 1000;
let timer = 0;
let reports = {};
const best = new Map(); // camera → greatest median sharpness since the page was opened

export function stop_optics() {
  clearTimeout(timer);
  timer = 0;
}

async function read_reports() {
  try { reports = await get("api/commission/optics"); } catch { /* the next reading comes */ }
  timer = setTimeout(read_reports, PERIOD_MS);
}

export function render_optics(host, { live }) {
  if (live.is_open && !timer) read_reports();
  if (!live.is_open) { stop_optics(); host.replaceChildren(); return; }
  if (!host.firstChild) host.append(create_element("p", { class: "soft" }, t("commission.optics_about")), create_element("ul", { class: "eyes" }));
  sync_children(host.lastChild, live.cameras.map((name) => ({ name, report: reports[name] })), ({ name }) => name, create_eye, update_eye);
}

function create_eye({ name }) {
  return create_element("li", { class: "eye" },
    create_element("h3", {}, name, create_element("span", {})),
    create_element("div", { class: "view" }, create_element("img", { alt: t("commission.picture", { camera: name }), on: { load: ({ target }) => { target.dataset.loaded = ""; } } })),
    create_element("div", { class: "chart" }), create_element("p", { class: "tiles" }));
}

function update_eye(eye, { name, report }) {
  if (!report) return;
  const [title, view, bars, text] = eye.children;
  view.querySelector("img").src = `api/commission/pictures/${encodeURIComponent(name)}?${Date.now()}`;
  set_text(title.lastChild, report.fault ? t(`cause.${report.fault}`, report.fault_values) : `${report.size_px[0]}×${report.size_px[1]}`);
  title.lastChild.className = report.fault ? "fault" : "";
  bars.replaceChildren(draw_histogram(report));
  view.querySelector("svg")?.remove();
  view.append(draw_tiles(report));
  const median = report.sharpness_median;
  if (median != null) best.set(name, Math.max(best.get(name) ?? 0, median));
  set_text(text, median == null ? t("commission.sharpness_none") : t("commission.sharpness", { now: format_number(100 * median), best: format_number(100 * best.get(name)), even: format_percent(report.evenness) }));
}

function draw_histogram({ histogram, saturated }) {
  const most = Math.max(...histogram, 1);
  const bars = histogram.map((count, i) => create_svg("rect", { x: i, width: 0.9, y: 1 - Math.sqrt(count / most), height: Math.sqrt(count / most), class: i === histogram.length - 1 ? "top" : "" }));
  const label = t("commission.histogram", { share: format_percent(saturated, 1) });
  return create_svg("svg", { class: "bars", viewBox: `0 0 ${histogram.length} 1`, preserveAspectRatio: "none", role: "img", "aria-label": label }, ...bars);
}

function draw_tiles({ sharpness, size_px: [width, height] }) {
  const [rows, columns] = [sharpness.length, sharpness[0].length];
  const least = Math.min(...sharpness.flat().filter((value) => value != null));
  const marks = sharpness.flatMap((row, v) => row.map((value, u) => value == null ? null : create_svg("text", { class: value === least ? "tile least" : "tile", x: (u + 0.5) * width / columns, y: (v + 0.5) * height / rows + 8, "font-size": width / 28 }, format_number(100 * value)))).filter(Boolean);
  return create_svg("svg", { viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true" }, ...marks);
}
