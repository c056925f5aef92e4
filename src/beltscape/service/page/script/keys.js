// Keyboard shortcuts, and the dialog that lists them.
import { focus_next_alarm } from "./alarms.js";
import * as belt from "./belt.js";
import * as chart from "./chart.js";
import { $, create_element } from "./dom.js";
import * as maintenance from "./maintenance.js";
import { store } from "./store.js";
import * as recording from "./recording.js";
import { get_language, list_languages, set_language, t } from "./texts.js";
import { theme } from "./theme.js";

export function toggle_wall() {
  const query = new URLSearchParams(location.search);
  if (query.has("wall")) query.delete("wall"); else query.set("wall", "");
  history.replaceState(null, "", `${location.pathname}${query.size ? `?${query.toString().replace("wall=", "wall")}` : ""}${location.hash}`);
  document.documentElement.classList.toggle("wall", query.has("wall"));
  if (query.has("wall")) location.hash = "#live";
  store.emit("layout");
}

function next_language() {
  const all = list_languages().map(({ code }) => code);
  set_language(all[(all.indexOf(get_language()) + 1) % all.length]);
}

const KEYS = {
  l: ["keys.live", () => { location.hash = "#live"; }],
  h: ["keys.history", () => { location.hash = "#history"; }],
  a: ["keys.alarm", () => { location.hash = "#live"; focus_next_alarm(); }],
  c: ["keys.range", chart.next_range],
  b: ["keys.belt", () => { location.hash = "#live"; $("belt").focus(); }],
  r: ["keys.reset", belt.reset],
  k: ["keys.keep", recording.open],
  t: ["keys.theme", () => theme.next()],
  g: ["keys.language", next_language],
  w: ["keys.wall", toggle_wall],
  m: ["keys.maintenance", maintenance.open],
  "?": ["keys.help", () => toggle_help()],
};

export function toggle_help() {
  const dialog = $("keys");
  if (dialog.open) { dialog.close(); return; }
  const list = create_element("dl", {}, ...Object.entries(KEYS).flatMap(([key, [text]]) => [create_element("dt", {}, create_element("kbd", {}, key.toUpperCase())), create_element("dd", {}, t(text))]));
  dialog.replaceChildren(create_element("h2", { id: "keys-title" }, t("keys.title")), list, create_element("p", {}, t("keys.none")), create_element("button", { type: "button", class: "plain", on: { click: () => dialog.close() } }, t("keys.close")));
  dialog.showModal();
}

export function start() {
  document.addEventListener("keydown", (event) => {
    const typing = event.target.closest?.("input, select, textarea");
    const action = KEYS[event.key.toLowerCase()];
    if (!action || typing || event.ctrlKey || event.metaKey || event.altKey || $("keep-dialog").open || $("maintenance-dialog").open || $("alarm-dialog").open || ($("keys").open && event.key !== "?")) return;
    event.preventDefault();
    action[1]();
  });
}
