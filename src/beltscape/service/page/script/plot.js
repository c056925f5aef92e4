// A curve over time with its uncertainty band, drawn by uPlot; used by the live chart and the history.
import { create_element } from "./dom.js";
import { get_colour } from "./theme.js";
import { format_date_time, format_number, format_short_day, format_significant, format_time, format_unit } from "./texts.js";

const STEPS_S = [1, 2, 5, 10, 15, 30, ...[1, 2, 5, 10, 15, 30, 60, 120, 180, 240, 360, 720].map((min) => min * 60), ...[1, 2, 5, 7, 14, 30, 60, 180].map((days) => days * 86400)];

const get_rem_px = () => parseFloat(getComputedStyle(document.documentElement).fontSize);

export class Plot {
  /** `columns`: [seconds, value, low, high, t/h], null: not known. `on_click` receives the clicked time in seconds. */
  constructor(host, on_click = null) {
    this.host = host;
    this.on_click = on_click;
    this.columns = [[], [], [], [], []];
    this.span = null;
    this.tip = create_element("div", { class: "tip", hidden: true });
    host.append(this.tip);
    this.build();
    new ResizeObserver(() => this.resize()).observe(host);
  }

  /** Rebuild the chart after a change of theme, language or font size. */
  build() {
    this.chart?.destroy();
    const size = get_rem_px();
    const ink = { stroke: get_colour("quiet"), font: `${size * 0.75}px Inter, sans-serif`, grid: { stroke: get_colour("line"), width: 1 }, ticks: { show: false } };
    this.chart = new window.uPlot({
      width: Math.max(this.host.clientWidth, 60), height: Math.max(this.host.clientHeight, 60), padding: [size * 0.5, size * 1.375, 0, 0],
      legend: { show: false },
      cursor: { drag: { x: false, y: false }, points: { size: 8, fill: get_colour("data") }, y: false },
      scales: { x: { time: true, range: () => this.span ?? [0, 1] }, y: { range: (_, __, high) => [0, Math.max(high ?? 0, 1) * 1.08] } },
      axes: [{ ...ink, space: size * 4.5, incrs: STEPS_S, size: size * 1.75, values: (_, splits, __, ___, step) => splits.map((s) => format_tick(s, step)) },
        { ...ink, size: size * 3.4, space: size * 2.5, values: (_, splits) => splits.map((value) => format_number(value, value % 1 ? 1 : 0)) }],
      series: [{}, { stroke: get_colour("data"), width: 2, points: { show: false } }, { width: 0, points: { show: false } }, { width: 0, points: { show: false } }],
      bands: [{ series: [3, 2], fill: get_colour("data-soft") }],
      hooks: { setCursor: [(chart) => this.show_tip(chart)] },
    }, this.columns.slice(0, 4), this.host);
    if (this.on_click) this.chart.over.addEventListener("click", () => { const at = this.chart.cursor.idx; if (at != null) this.on_click(this.columns[0][at]); });
  }

  resize() {
    const [width, height] = [this.host.clientWidth, this.host.clientHeight];
    if (width > 60 && height > 60) this.chart.setSize({ width, height });
  }

  show(columns, span) {
    this.columns = columns;
    this.span = span;
    this.chart.setData(columns.slice(0, 4));
  }

  show_tip(chart) {
    const at = chart.cursor.idx;
    const [seconds, value, low, high, mass] = this.columns.map((column) => (at == null ? null : column[at]));
    this.tip.hidden = value == null || chart.cursor.left < 0;
    if (this.tip.hidden) return;
    const range_text = low != null && high != null && high > low ? ` (${format_significant(low)} – ${format_significant(high)})` : "";
    const lines = [format_date_time(seconds * 1000, true), `${format_unit(format_significant(value), "m3_h")}${range_text}`, ...(mass != null ? [format_unit(format_significant(mass), "t_h")] : [])];
    this.tip.replaceChildren(...lines.flatMap((line) => [line, create_element("br")]).slice(0, -1));
    const left = chart.over.offsetLeft + chart.valToPos(seconds, "x");
    const room = this.host.clientWidth - this.tip.offsetWidth - 4;
    this.tip.style.left = `${Math.max(4, Math.min(left + 12, room))}px`;
    this.tip.style.top = "6px";
  }
}

/** Return a tick's label: the time, or the date at midnight and for steps of days. */
function format_tick(seconds, step) {
  const date = new Date(seconds * 1000);
  const midnight = date.getHours() === 0 && date.getMinutes() === 0 && date.getSeconds() === 0;
  return step >= 86400 || (midnight && step >= 3600) ? format_short_day(seconds * 1000) : format_time(seconds * 1000, step < 60);
}

/** Return the plot's columns from a response of GET /api/series. */
export function read_series(series) {
  const half = series.width_ms / 2;
  return [series.start_ms.map((ms) => (ms + half) / 1000), series.flow_m3_h, series.low_m3_h, series.high_m3_h, series.mass_flow_t_h];
}

export const is_empty = (columns) => columns[1].every((value) => value == null);
