// The newest cross-section above the line of the empty belt; unmeasured parts are hatched.
import { create_svg } from "./dom.js";
import { format_number, format_unit, t } from "./texts.js";

const LEFT = 46, RIGHT = 12, TOP = 10, LOW = 26;
const UNKNOWN = 0xffff;

/** Return {x_mm, height_mm (null: not measured)} of a message of the live stream. */
export function read_section(message) {
  return { x_mm: message.x_mm, height_mm: Array.from(message.counts, (count) => (count === UNKNOWN ? null : (count & 0x7fff) * message.step_mm + message.offset_mm)) };
}

/** Return the area of the measured parts in m². */
export function compute_area_m2({ x_mm, height_mm }) {
  let sum = 0;
  for (let i = 0; i + 1 < x_mm.length; i++) if (height_mm[i] != null && height_mm[i + 1] != null) sum += (height_mm[i] + height_mm[i + 1]) / 2 * (x_mm[i + 1] - x_mm[i]);
  return sum * 1e-6;
}

const STEPS = [1, 2, 5, 10, 20, 50, 100, 200, 250, 500, 1000, 2000, 5000];
export const choose_step = (span, most) => STEPS.find((step) => span / step <= most) ?? 10000;

export class SectionPlot {
  constructor(host) {
    this.host = host;
    this.top_mm = 0;
    this.section = null;
    new ResizeObserver(() => this.draw()).observe(host);
  }

  show(section) {
    this.section = section;
    this.draw();
  }

  draw() {
    const { section, host } = this;
    const [width, height] = [host.clientWidth, host.clientHeight];
    if (!section || width < 80 || height < 60) { host.replaceChildren(); return; }
    const known = section.height_mm.filter((h) => h != null);
    const high = Math.max(60, ...known);
    // the scale grows at once and shrinks only after a large change
    if (high > this.top_mm || high < this.top_mm * 0.55) this.top_mm = high * 1.15;
    const [first, last] = [section.x_mm[0], section.x_mm.at(-1)];
    const base = this.top_mm * -0.06;
    const x = (mm) => LEFT + (mm - first) / (last - first) * (width - LEFT - RIGHT);
    const y = (mm) => height - LOW - (mm - base) / (this.top_mm - base) * (height - LOW - TOP);
    const svg = create_svg("svg", { role: "img", "aria-label": t("section.label", { area: format_unit(format_number(compute_area_m2(section), 4), "m2") }) },
      create_svg("defs", {}, create_svg("pattern", { id: "gaps", width: 7, height: 7, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" }, create_svg("path", { d: "M0 0V7", stroke: "var(--faint)", "stroke-width": 2, opacity: 0.6 }))));
    this.draw_axes(svg, { x, y, first, last, width });
    this.draw_curve(svg, { x, y });
    svg.append(create_svg("path", { class: "zero", d: `M${x(first)} ${y(0)}H${x(last)}` }));
    host.replaceChildren(svg);
  }

  draw_axes(svg, { x, y, first, last, width }) {
    const rise = choose_step(this.top_mm, 4);
    for (let mm = 0; mm <= this.top_mm; mm += rise) {
      if (mm) svg.append(create_svg("path", { class: "axis", d: `M${LEFT} ${y(mm)}H${width - RIGHT}` }));
      svg.append(create_svg("text", { class: "tick", x: LEFT - 8, y: y(mm) + 4, "text-anchor": "end" }, format_number(mm)));
    }
    const across = choose_step(last - first, width > 340 ? 5 : 3);
    for (let mm = Math.ceil(first / across) * across; mm <= last; mm += across)
      svg.append(create_svg("text", { class: "tick", x: x(mm), y: y(this.top_mm * -0.06) + 18, "text-anchor": "middle" }, mm === 0 ? `0 ${t("unit.mm")}` : format_number(mm)));
  }

  draw_curve(svg, { x, y }) {
    const { x_mm, height_mm } = this.section;
    let start = null;
    for (let i = 0; i <= x_mm.length; i++) {
      const known = i < x_mm.length && height_mm[i] != null;
      if (start !== null && (i === x_mm.length || known !== (height_mm[start] != null))) {
        this.draw_piece(svg, start, i, { x, y });
        start = null;
      }
      if (start === null && i < x_mm.length) start = i;
    }
  }

  draw_piece(svg, start, end, { x, y }) {
    const { x_mm, height_mm } = this.section;
    if (height_mm[start] == null) {
      const [from, to] = [x(x_mm[Math.max(start - 1, 0)]), x(x_mm[Math.min(end, x_mm.length - 1)])];
      svg.append(create_svg("rect", { class: "gap", fill: "url(#gaps)", x: from, y: TOP, width: Math.max(to - from, 0), height: Math.max(y(0) - TOP, 0) }));
      return;
    }
    const points = [];
    for (let i = start; i < end; i++) points.push(`${x(x_mm[i]).toFixed(1)} ${y(height_mm[i]).toFixed(1)}`);
    svg.append(create_svg("path", { class: "load", d: `M${x(x_mm[start])} ${y(0)}L${points.join("L")}L${x(x_mm[end - 1])} ${y(0)}z` }));
    svg.append(create_svg("path", { class: "outline", d: `M${points.join("L")}` }));
  }
}
