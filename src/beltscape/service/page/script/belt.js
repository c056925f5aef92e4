// The belt panel: rows move smoothly, drawn in 3-D if WebGL 2 is available, else from above.
import { FlatBelt } from "./belt_flat.js";
import { BeltRows } from "./belt_rows.js";
import { $, set_text } from "./dom.js";
import { Orbit } from "./orbit.js";
import { store } from "./store.js";
import { format_number, format_unit } from "./texts.js";
import { viridis } from "./viridis.js";

const WINDOW_M = 6, FRAME_MS = 33, SOFTWARE_MS = 500;
const HOME = { turn: 0.62, rise: 0.44, zoom: 1 };
const reduced_motion = matchMedia("(prefers-reduced-motion: reduce)");
const rows = new BeltRows();
let scene = null, flat = null, orbit = null;
let edge_row = null;       // the newest edge as displayed, in rows
let high_mm = 100;
let drawn_ms = 0, drawn = "", drawn_view = "", is_visible = true;

function round_up(mm) {
  const steps = [20, 30, 40, 50, 60, 80, 100, 120, 150, 200, 250, 300, 400, 500, 600, 800, 1000, 1500, 2000];
  return steps.find((step) => step >= mm) ?? Math.ceil(mm / 500) * 500;
}

/** Update the height scale: it grows at once and shrinks only after a large change. */
function rescale() {
  const high = rows.find_high_mm(WINDOW_M * 1000 / rows.cell_mm);
  if (high > high_mm || high < high_mm * 0.45) high_mm = round_up(high * 1.05);
  update_legend();
}

function update_legend() {
  set_text($("belt-low"), format_number(0));
  set_text($("belt-high"), format_unit(format_number(high_mm), "mm"));
}

/** Move the displayed edge towards the newest row at the belt's speed, faster if it lags. */
function advance(elapsed_s) {
  if (edge_row === null || edge_row > rows.end || reduced_motion.matches) edge_row = rows.end;
  const speed = ((store.state?.frames.speed_m_s ?? 0) * 1000) / rows.cell_mm;
  const lag = rows.end - edge_row;
  if (lag > Math.max(speed * 3, 200)) edge_row = rows.end;
  else edge_row = Math.min(rows.end, edge_row + elapsed_s * (speed * 0.9 + lag * 0.6));
}

function render_frame(now) {
  requestAnimationFrame(render_frame);
  const is_turned = orbit && [orbit.turn, orbit.rise, orbit.scale].join() !== drawn_view;
  if (now - drawn_ms < (scene?.software && !is_turned ? SOFTWARE_MS : FRAME_MS) || !is_visible || document.hidden || !rows.has_rows || $("live-view").hidden) return;
  advance(Math.min((now - drawn_ms) / 1000, 0.5));
  drawn_ms = now;
  const state = [edge_row.toFixed(2), rows.changes, high_mm, orbit?.turn, orbit?.rise, orbit?.scale, document.documentElement.dataset.theme, $("belt").clientWidth, $("belt").clientHeight].join();
  if (state === drawn) return;
  drawn = state;
  const dark = document.documentElement.dataset.theme === "dark";
  if (flat) flat.draw(rows, { window_m: WINDOW_M, high_mm, dark });
  else if (scene) scene.draw(rows, edge_row, high_mm, orbit);
  if (orbit) drawn_view = [orbit.turn, orbit.rise, orbit.scale].join();
}

export async function start() {
  const canvas = $("belt");
  paint_scale();
  store.on("opened", () => { rows.clear(); edge_row = null; });
  store.on("belt", (message) => {
    rows.add(message);
    scene?.refresh();
    rescale();
    $("belt-none").hidden = true;
  });
  store.on("texts", update_legend);
  store.on("theme", () => scene?.set_theme(document.documentElement.dataset.theme === "dark"));
  new IntersectionObserver((entries) => { is_visible = entries.at(-1).isIntersecting; }).observe(canvas.parentElement);
  await open_view(canvas);
  requestAnimationFrame(render_frame);
}

async function open_view(canvas) {
  try {
    // checked here, because three.js would log an error
    if (!canvas.getContext("webgl2", { antialias: true, alpha: true, powerPreference: "low-power" })) throw new Error("no WebGL 2");
    const { BeltScene } = await import("./belt_scene.js");
    scene = new BeltScene(canvas, WINDOW_M);
    scene.set_theme(document.documentElement.dataset.theme === "dark");
    orbit = new Orbit(canvas, HOME, () => {});
    new ResizeObserver(() => { scene.resize(); drawn = ""; }).observe(canvas);
    $("belt-reset").addEventListener("click", () => orbit.reset());
    $("belt-top").addEventListener("click", () => orbit.show_top());
    canvas.addEventListener("webglcontextrestored", () => { drawn = ""; scene.refresh(); });
  } catch {
    // a canvas that was asked for WebGL gives no 2-D context, so it is replaced
    const replacement = canvas.cloneNode();
    canvas.replaceWith(replacement);
    flat = new FlatBelt(replacement);
    $("belt-flat").hidden = false;
    $("belt-reset").hidden = $("belt-top").hidden = true;
  }
}

function paint_scale() {
  const context = $("belt-scale").getContext("2d");
  for (let i = 0; i < 128; i++) {
    context.fillStyle = `rgb(${viridis(i / 127).map(Math.round).join(" ")})`;
    context.fillRect(i, 0, 1, 1);
  }
}

export const reset = () => orbit?.reset();
