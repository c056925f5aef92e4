// Small tools: elements by id, elements made, shapes for signs.
export const $ = (id) => document.getElementById(id);

export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "on") for (const [event, listener] of Object.entries(value)) element.addEventListener(event, listener);
    else if (value !== undefined && value !== null && value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

const SVG = "http://www.w3.org/2000/svg";

export function draw(tag, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

const line = (d) => draw("path", { d, fill: "none", stroke: "currentColor", "stroke-width": 1.8, "stroke-linecap": "round", "stroke-linejoin": "round" });
const solid = (d) => draw("path", { d, fill: "currentColor" });
const cut = (d) => draw("path", { d, fill: "none", stroke: "var(--panel)", "stroke-width": 2.2, "stroke-linecap": "round", "stroke-linejoin": "round" });

const SIGNS = {
  critical: () => [solid("M8 2h8l6 6v8l-6 6H8l-6-6V8z"), cut("M12 7v6M12 16.6v.1")],
  warning: () => [solid("M12 2.5 23 21.5H1z"), cut("M12 9.5v5M12 18v.1")],
  info: () => [draw("circle", { cx: 12, cy: 12, r: 10.5, fill: "currentColor" }), cut("M12 11v6M12 7.2v.1")],
  good: () => [line("M12 2.5a9.5 9.5 0 1 0 0 19 9.5 9.5 0 0 0 0-19zM7.5 12.4l3 3 6-6.6")],
  rising: () => [line("M4 19 19 5M9 5h10v10")],
  falling: () => [line("M4 5l15 14M19 9v10H9")],
  steady: () => [line("M3 12h17M14 6l6 6-6 6")],
  unknown: () => [line("M5 12h.1M12 12h.1M19 12h.1")],
  ok: () => [line("M5 12.5l4.5 4.5L19 7")],
  lost: () => [line("M6 6l12 12M18 6 6 18")],
  waiting: () => [line("M12 3a9 9 0 1 0 9 9M12 7v5l3.5 2")],
  unusable: () => [line("M12 4 21.5 20h-19zM12 10v4M12 17v.1")],
  system: () => [line("M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18z"), solid("M12 3a9 9 0 0 1 0 18z")],
  light: () => [line("M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8zM12 2.5v2M12 19.5v2M2.5 12h2M19.5 12h2M5.3 5.3l1.4 1.4M17.3 17.3l1.4 1.4M5.3 18.7l1.4-1.4M17.3 6.7l1.4-1.4")],
  dark: () => [line("M20 14.5A8.5 8.5 0 0 1 9.5 4a8.5 8.5 0 1 0 10.5 10.5z")],
  wall: () => [line("M3 4.5h18v12H3zM8.5 20.5h7M12 16.5v4")],
  keys: () => [line("M2.5 6.5h19v11h-19zM6 10h.1M9.5 10h.1M13 10h.1M16.5 10h1.5M6 14h.1M9.5 14h5M18 14h.1")],
};

/** A sign by shape: 24 × 24, in the colour of the text. */
export function sign(name) {
  return draw("svg", { viewBox: "0 0 24 24", "aria-hidden": "true" }, ...(SIGNS[name] ?? SIGNS.unknown)());
}

/** Change a text only where it differs, so that screen readers are left in peace. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

const CALM_MS = 450; // what changes faster cannot be read

/** ``draw`` that runs no more often than one can read; the last call is never lost. */
export function calm(draw) {
  let [timer, last_ms, values] = [0, -Infinity, []];
  const run = () => { timer = 0; last_ms = performance.now(); draw(...values); };
  return (...given) => {
    values = given;
    const wait_ms = last_ms + CALM_MS - performance.now();
    if (wait_ms <= 0) run();
    else if (!timer) timer = setTimeout(run, wait_ms);
  };
}

/** Bring children into line with items: made once per key, updated every time. */
export function keep(parent, items, key, create, update) {
  const there = new Map([...parent.children].map((child) => [child.dataset.key, child]));
  items.forEach((item, i) => {
    const name = key(item);
    let child = there.get(name);
    if (!child) {
      child = create(item);
      child.dataset.key = name;
    }
    there.delete(name);
    update(child, item);
    if (parent.children[i] !== child) parent.insertBefore(child, parent.children[i] ?? null);
  });
  for (const left of there.values()) left.remove();
}
