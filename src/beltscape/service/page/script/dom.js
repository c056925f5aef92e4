// Helpers for the DOM: elements, SVG, icons, texts, lists.
export const $ = (id) => document.getElementById(id);

export function create_element(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "on") for (const [event, listener] of Object.entries(value)) element.addEventListener(event, listener);
    else if (value !== undefined && value !== null && value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

const SVG = "http://www.w3.org/2000/svg";

export function create_svg(tag, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

const stroke = (d) => create_svg("path", { d, fill: "none", stroke: "currentColor", "stroke-width": 1.8, "stroke-linecap": "round", "stroke-linejoin": "round" });
const fill_path = (d) => create_svg("path", { d, fill: "currentColor" });
const cut_out = (d) => create_svg("path", { d, fill: "none", stroke: "var(--panel)", "stroke-width": 2.2, "stroke-linecap": "round", "stroke-linejoin": "round" });

const ICONS = {
  critical: () => [fill_path("M8 2h8l6 6v8l-6 6H8l-6-6V8z"), cut_out("M12 7v6M12 16.6v.1")],
  warning: () => [fill_path("M12 2.5 23 21.5H1z"), cut_out("M12 9.5v5M12 18v.1")],
  info: () => [create_svg("circle", { cx: 12, cy: 12, r: 10.5, fill: "currentColor" }), cut_out("M12 11v6M12 7.2v.1")],
  good: () => [stroke("M12 2.5a9.5 9.5 0 1 0 0 19 9.5 9.5 0 0 0 0-19zM7.5 12.4l3 3 6-6.6")],
  rising: () => [stroke("M4 19 19 5M9 5h10v10")],
  falling: () => [stroke("M4 5l15 14M19 9v10H9")],
  steady: () => [stroke("M3 12h17M14 6l6 6-6 6")],
  unknown: () => [stroke("M5 12h.1M12 12h.1M19 12h.1")],
  ok: () => [stroke("M5 12.5l4.5 4.5L19 7")],
  lost: () => [stroke("M6 6l12 12M18 6 6 18")],
  waiting: () => [stroke("M12 3a9 9 0 1 0 9 9M12 7v5l3.5 2")],
  unusable: () => [stroke("M12 4 21.5 20h-19zM12 10v4M12 17v.1")],
  system: () => [stroke("M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18z"), fill_path("M12 3a9 9 0 0 1 0 18z")],
  light: () => [stroke("M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8zM12 2.5v2M12 19.5v2M2.5 12h2M19.5 12h2M5.3 5.3l1.4 1.4M17.3 17.3l1.4 1.4M5.3 18.7l1.4-1.4M17.3 6.7l1.4-1.4")],
  dark: () => [stroke("M20 14.5A8.5 8.5 0 0 1 9.5 4a8.5 8.5 0 1 0 10.5 10.5z")],
  wall: () => [stroke("M3 4.5h18v12H3zM8.5 20.5h7M12 16.5v4")],
  keys: () => [stroke("M2.5 6.5h19v11h-19zM6 10h.1M9.5 10h.1M13 10h.1M16.5 10h1.5M6 14h.1M9.5 14h5M18 14h.1")],
};

/** Return an icon of 24 × 24 in the colour of the text. */
export function create_icon(name) {
  return create_svg("svg", { viewBox: "0 0 24 24", "aria-hidden": "true" }, ...(ICONS[name] ?? ICONS.unknown)());
}

/** Set a text only if it differs, so that screen readers do not repeat it. */
export function set_text(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

const THROTTLE_MS = 450; // faster changes cannot be read

/** Return `action` limited to one run per THROTTLE_MS; the last call always runs. */
export function throttle(action) {
  let [timer, last_ms, values] = [0, -Infinity, []];
  const run = () => { timer = 0; last_ms = performance.now(); action(...values); };
  return (...latest) => {
    values = latest;
    const wait_ms = last_ms + THROTTLE_MS - performance.now();
    if (wait_ms <= 0) run();
    else if (!timer) timer = setTimeout(run, wait_ms);
  };
}

/** Match children to items: each child is created once per key and updated on every call. */
export function sync_children(parent, items, key, create, update) {
  const existing = new Map([...parent.children].map((child) => [child.dataset.key, child]));
  items.forEach((item, i) => {
    const name = key(item);
    let child = existing.get(name);
    if (!child) {
      child = create(item);
      child.dataset.key = name;
    }
    existing.delete(name);
    update(child, item);
    if (parent.children[i] !== child) parent.insertBefore(child, parent.children[i] ?? null);
  });
  for (const child of existing.values()) child.remove();
}
