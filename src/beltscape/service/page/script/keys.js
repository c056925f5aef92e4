// Keys for everything, and the list of them.
import { focus_next } from "./alarms.js";
import * as belt from "./belt.js";
import * as chart from "./chart.js";
import { $, make } from "./dom.js";
import { store } from "./store.js";
import * as keep from "./keep.js";
import { choose, chosen, languages, t } from "./texts.js";
import { theme } from "./theme.js";

export function wall() {
  const query = new URLSearchParams(location.search);
  if (query.has("wall")) query.delete("wall"); else query.set("wall", "");
  history.replaceState(null, "", `${location.pathname}${query.size ? `?${query.toString().replace("wall=", "wall")}` : ""}${location.hash}`);
  document.documentElement.classList.toggle("wall", query.has("wall"));
  if (query.has("wall")) location.hash = "#live";
  store.tell("layout");
}

function next_language() {
  const all = languages();
  choose(all[(all.indexOf(chosen()) + 1) % all.length]);
}

const KEYS = {
  l: ["keys.live", () => { location.hash = "#live"; }],
  h: ["keys.history", () => { location.hash = "#history"; }],
  a: ["keys.alarm", () => { location.hash = "#live"; focus_next(); }],
  c: ["keys.range", chart.next],
  b: ["keys.belt", () => { location.hash = "#live"; $("belt").focus(); }],
  r: ["keys.reset", belt.reset],
  k: ["keys.keep", keep.open],
  t: ["keys.theme", () => theme.next()],
  g: ["keys.language", next_language],
  w: ["keys.wall", wall],
  "?": ["keys.help", () => help()],
};

export function help() {
  const dialog = $("keys");
  if (dialog.open) { dialog.close(); return; }
  const list = make("dl", {}, ...Object.entries(KEYS).flatMap(([key, [text]]) => [make("dt", {}, make("kbd", {}, key.toUpperCase())), make("dd", {}, t(text))]));
  dialog.replaceChildren(make("h2", { id: "keys-title" }, t("keys.title")), list, make("p", {}, t("keys.none")), make("button", { type: "button", class: "plain", on: { click: () => dialog.close() } }, t("keys.close")));
  dialog.showModal();
}

export function start() {
  document.addEventListener("keydown", (event) => {
    const typing = event.target.closest?.("input, select, textarea");
    const action = KEYS[event.key.toLowerCase()];
    if (!action || typing || event.ctrlKey || event.metaKey || event.altKey || $("keep-dialog").open || ($("keys").open && event.key !== "?")) return;
    event.preventDefault();
    action[1]();
  });
}
