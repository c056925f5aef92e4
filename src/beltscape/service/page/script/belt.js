// The belt's panel: rows as they come, run smoothly, drawn in 3-D where the screen can, else from above.
import { FlatBelt } from "./belt_flat.js";
import { BeltRows } from "./belt_rows.js";
import { $, say } from "./dom.js";
import { Orbit } from "./orbit.js";
import { store } from "./store.js";
import { number, t, unit } from "./texts.js";
import { viridis } from "./viridis.js";

const WINDOW_M = 6, FRAME_MS = 33, SOFTWARE_MS = 500;
const HOME = { turn: 0.62, rise: 0.44, zoom: 1 };
const still = matchMedia("(prefers-reduced-motion: reduce)");
const rows = new BeltRows();
let scene = null, flat = null, orbit = null;
let at = null;       // the newest edge as shown, in rows
let high_mm = 100;
let drawn_ms = 0, drawn = "", aimed = "", seen = true;

function nice(mm) {
  const steps = [20, 30, 40, 50, 60, 80, 100, 120, 150, 200, 250, 300, 400, 500, 600, 800, 1000, 1500, 2000];
  return steps.find((step) => step >= mm) ?? Math.ceil(mm / 500) * 500;
}

/** The scale follows upwards at once, and downwards only after a real change. */
function rescale() {
  const high = rows.high_mm(WINDOW_M * 1000 / rows.cell_mm);
  if (high > high_mm || high < high_mm * 0.45) high_mm = nice(high * 1.05);
  legend();
}

function legend() {
  say($("belt-low"), number(0));
  say($("belt-high"), unit(number(high_mm), "mm"));
}

/** Move the shown edge at the belt's speed towards the newest row; catch up when it lags. */
function run(elapsed_s) {
  if (at === null || at > rows.end || still.matches) at = rows.end;
  const speed = ((store.state?.frames.speed_m_s ?? 0) * 1000) / rows.cell_mm;
  const lag = rows.end - at;
  if (lag > Math.max(speed * 3, 200)) at = rows.end;
  else at = Math.min(rows.end, at + elapsed_s * (speed * 0.9 + lag * 0.6));
}

function frame(now) {
  requestAnimationFrame(frame);
  const turned = orbit && [orbit.turn, orbit.rise, orbit.scale].join() !== aimed;
  if (now - drawn_ms < (scene?.software && !turned ? SOFTWARE_MS : FRAME_MS) || !seen || document.hidden || !rows.there || $("live-view").hidden) return;
  run(Math.min((now - drawn_ms) / 1000, 0.5));
  drawn_ms = now;
  const state = [at.toFixed(2), rows.changes, high_mm, orbit?.turn, orbit?.rise, orbit?.scale, document.documentElement.dataset.theme, $("belt").clientWidth, $("belt").clientHeight].join();
  if (state === drawn) return;
  drawn = state;
  const dark = document.documentElement.dataset.theme === "dark";
  if (flat) flat.draw(rows, { window_m: WINDOW_M, high_mm, dark });
  else if (scene) scene.draw(rows, at, high_mm, orbit);
  if (orbit) aimed = [orbit.turn, orbit.rise, orbit.scale].join();
}

export async function start() {
  const canvas = $("belt");
  paint_scale();
  store.on("opened", () => { rows.clear(); at = null; });
  store.on("belt", (message) => {
    rows.take(message);
    scene?.refresh();
    rescale();
    $("belt-none").hidden = true;
  });
  store.on("texts", legend);
  store.on("theme", () => scene?.dress(document.documentElement.dataset.theme === "dark"));
  new IntersectionObserver((entries) => { seen = entries.at(-1).isIntersecting; }).observe(canvas.parentElement);
  await open(canvas);
  requestAnimationFrame(frame);
}

async function open(canvas) {
  try {
    // asked here, for three.js would complain aloud
    if (!canvas.getContext("webgl2", { antialias: true, alpha: true, powerPreference: "low-power" })) throw new Error("no WebGL 2");
    const { BeltScene } = await import("./belt_scene.js");
    scene = new BeltScene(canvas, WINDOW_M);
    scene.dress(document.documentElement.dataset.theme === "dark");
    orbit = new Orbit(canvas, HOME, () => {});
    new ResizeObserver(() => { scene.fit(); drawn = ""; }).observe(canvas);
    $("belt-reset").addEventListener("click", () => orbit.reset());
    $("belt-top").addEventListener("click", () => orbit.top());
    canvas.addEventListener("webglcontextrestored", () => { drawn = ""; scene.refresh(); });
  } catch {
    // a canvas asked for WebGL gives no 2-D: a fresh one takes its place
    const fresh = canvas.cloneNode();
    canvas.replaceWith(fresh);
    flat = new FlatBelt(fresh);
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
