// A curve with its band over time, by uPlot, in the page's colours; the same for the live chart and the history.
import { make } from "./dom.js";
import { colour } from "./theme.js";
import { day_and_time, number, short_day, t, three, time, unit } from "./texts.js";

const STEPS_S = [1, 2, 5, 10, 15, 30, ...[1, 2, 5, 10, 15, 30, 60, 120, 180, 240, 360, 720].map((min) => min * 60), ...[1, 2, 5, 7, 14, 30, 60, 180].map((days) => days * 86400)];

const rem = () => parseFloat(getComputedStyle(document.documentElement).fontSize);

export class Plot {
  /** ``columns``: [seconds, value, low, high, t/h], nulls where nothing is known. ``chosen`` hears clicks in seconds. */
  constructor(host, chosen = null) {
    this.host = host;
    this.chosen = chosen;
    this.columns = [[], [], [], [], []];
    this.span = null;
    this.tip = make("div", { class: "tip", hidden: true });
    host.append(this.tip);
    this.build();
    new ResizeObserver(() => this.fit()).observe(host);
  }

  /** Draw anew in other colours, another language or another size of type. */
  build() {
    this.chart?.destroy();
    const size = rem();
    const ink = { stroke: colour("quiet"), font: `${size * 0.75}px Inter, sans-serif`, grid: { stroke: colour("line"), width: 1 }, ticks: { show: false } };
    this.chart = new window.uPlot({
      width: Math.max(this.host.clientWidth, 60), height: Math.max(this.host.clientHeight, 60), padding: [size * 0.5, size * 1.375, 0, 0],
      legend: { show: false },
      cursor: { drag: { x: false, y: false }, points: { size: 8, fill: colour("data") }, y: false },
      scales: { x: { time: true, range: () => this.span ?? [0, 1] }, y: { range: (_, __, high) => [0, Math.max(high ?? 0, 1) * 1.08] } },
      axes: [{ ...ink, space: size * 4.5, incrs: STEPS_S, size: size * 1.75, values: (_, splits, __, ___, step) => splits.map((s) => label(s, step)) },
        { ...ink, size: size * 3.4, space: size * 2.5, values: (_, splits) => splits.map((value) => number(value, value % 1 ? 1 : 0)) }],
      series: [{}, { stroke: colour("data"), width: 2, points: { show: false } }, { width: 0, points: { show: false } }, { width: 0, points: { show: false } }],
      bands: [{ series: [3, 2], fill: colour("data-soft") }],
      hooks: { setCursor: [(chart) => this.point(chart)] },
    }, this.columns.slice(0, 4), this.host);
    if (this.chosen) this.chart.over.addEventListener("click", () => { const at = this.chart.cursor.idx; if (at != null) this.chosen(this.columns[0][at]); });
  }

  fit() {
    const [width, height] = [this.host.clientWidth, this.host.clientHeight];
    if (width > 60 && height > 60) this.chart.setSize({ width, height });
  }

  show(columns, span) {
    this.columns = columns;
    this.span = span;
    this.chart.setData(columns.slice(0, 4));
  }

  point(chart) {
    const at = chart.cursor.idx;
    const [seconds, value, low, high, mass] = this.columns.map((column) => (at == null ? null : column[at]));
    this.tip.hidden = value == null || chart.cursor.left < 0;
    if (this.tip.hidden) return;
    const spread = low != null && high != null && high > low ? ` (${three(low)} – ${three(high)})` : "";
    const lines = [day_and_time(seconds * 1000, true), `${unit(three(value), "m3_h")}${spread}`, ...(mass != null ? [unit(three(mass), "t_h")] : [])];
    this.tip.replaceChildren(...lines.flatMap((line) => [line, make("br")]).slice(0, -1));
    const left = chart.over.offsetLeft + chart.valToPos(seconds, "x");
    const room = this.host.clientWidth - this.tip.offsetWidth - 4;
    this.tip.style.left = `${Math.max(4, Math.min(left + 12, room))}px`;
    this.tip.style.top = "6px";
  }
}

/** Text at a tick: the time, and at midnight, or with days between ticks, the day. */
function label(seconds, step) {
  const date = new Date(seconds * 1000);
  const midnight = date.getHours() === 0 && date.getMinutes() === 0 && date.getSeconds() === 0;
  return step >= 86400 || (midnight && step >= 3600) ? short_day(seconds * 1000) : time(seconds * 1000, step < 60);
}

/** Columns of what GET /api/series answers. */
export function of_series(series) {
  const half = series.width_ms / 2;
  return [series.start_ms.map((ms) => (ms + half) / 1000), series.flow_m3_h, series.low_m3_h, series.high_m3_h, series.mass_flow_t_h];
}

export const nothing_in = (columns) => columns[1].every((value) => value == null);
export const none_text = () => t("chart.none");
