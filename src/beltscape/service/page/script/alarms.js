// Alarms: the worst and the unseen first, told by shape, word and colour; acknowledged by a button or the key A, then Enter.
import { post } from "./api.js";
import { $, keep, make, say, sign } from "./dom.js";
import { store } from "./store.js";
import { chosen, has, moment, number, percent, t, three } from "./texts.js";

const GRAVE = { critical: 0, warning: 1, info: 2 };
const SEEN = { raised: 0, gone: 1, acknowledged: 2, clear: 3 };
const unseen = (alarm) => alarm.state === "raised" || alarm.state === "gone";
let before = new Set();

/** "camera_lost:cam2" → "Camera lost: cam2"; a name that nobody knows is shown as it is. */
export function title(name) {
  const [kind, ...rest] = name.split(":");
  const known = has(`alarm.${kind}`) ? t(`alarm.${kind}`) : kind.replaceAll("_", " ");
  return rest.length ? `${known}: ${rest.join(":")}` : known;
}

function amount(value, unit) {
  if (value == null) return "";
  if (unit === "" || unit === "1") return three(value);
  return unit === "%" ? percent(value / 100) : `${three(value)}\u00a0${unit}`;
}

function judged_by(alarm) {
  if (alarm.value == null) return "";
  const value = amount(alarm.value, alarm.unit);
  return alarm.limit == null ? value : t("alarms.limit", { value, limit: amount(alarm.limit, alarm.unit) });
}

function help(alarm) {
  const key = `help.${alarm.name.split(":")[0]}`;
  return has(key) ? t(key) : alarm.detail;
}

function create(alarm) {
  return make("li", { class: "alarm" }, sign(alarm.severity), make("h3"), make("span", { class: "when" }), make("p", { class: "value" }, make("b"), make("span")), make("p", { class: "help" }),
    make("button", { type: "button", on: { click: () => acknowledge(alarm.name) } }));
}

function update(item, alarm) {
  const [, heading, when, value, advice, button] = item.children;
  if (item.dataset.severity && item.dataset.severity !== alarm.severity) item.replaceChild(sign(alarm.severity), item.firstChild);
  item.dataset.severity = alarm.severity;
  item.dataset.state = alarm.state;
  say(heading, title(alarm.name));
  const by = alarm.by && alarm.state === "acknowledged" ? t("alarms.by", { name: alarm.by }) : "";
  say(when, alarm.since_ms ? t("alarms.since", { time: moment(alarm.since_ms) }) : "");
  say(value.firstChild, `${t(`severity.${alarm.severity}`)} · ${t(`alarm.${alarm.state}`)}`);
  say(value.lastChild, ["", judged_by(alarm), by].filter((part, i) => part || !i).join(" · "));
  say(advice, help(alarm));
  item.title = alarm.detail;
  advice.hidden = !advice.textContent;
  button.hidden = !unseen(alarm) || store.page?.role === "viewer";
  button.disabled = store.link === "lost";
  say(button, t("alarms.acknowledge"));
  button.setAttribute("aria-label", t("alarms.acknowledge_one", { alarm: title(alarm.name) }));
}

function show() {
  const known = store.link === "live" || store.link === "stale";
  const alarms = [...(store.state?.alarms ?? [])].sort((a, b) => (unseen(b) - unseen(a)) || GRAVE[a.severity] - GRAVE[b.severity] || SEEN[a.state] - SEEN[b.state] || b.since_ms - a.since_ms);
  const fresh = alarms.filter(unseen);
  keep($("alarms"), alarms, (alarm) => alarm.name, create, update);
  const none = $("alarms-none");
  none.hidden = alarms.length > 0;
  const key = known ? "alarms.none" : "alarms.unknown";
  if (none.dataset.shown !== key + chosen()) none.replaceChildren(...(known ? [sign("good")] : []), t(key));
  none.dataset.shown = key + chosen();
  $("alarms-role").hidden = !fresh.length || store.page?.role !== "viewer";
  $("alarms-unsure").hidden = known || !alarms.length;
  $("alarms-count").hidden = !fresh.length;
  say($("alarms-count"), t("alarms.count", { count: number(fresh.length) }));
  const raised = fresh.filter((alarm) => alarm.state === "raised");
  for (const alarm of raised) if (!before.has(alarm.name)) say($("alarms-said"), t("alarms.announce", { alarm: title(alarm.name) }));
  before = new Set(raised.map((alarm) => alarm.name));
  document.title = `${fresh.length ? `(${fresh.length}) ` : ""}${store.page?.plant || t("title")}`;
}

async function acknowledge(name) {
  const problem = $("alarms-problem");
  problem.hidden = true;
  const next = [...$("alarms").querySelectorAll("button:not([hidden])")].find((button) => button.parentElement.dataset.key !== name);
  try {
    await post(`/api/alarms/${encodeURIComponent(name)}/acknowledge`);
    (next ?? $("main")).focus({ preventScroll: true });
  } catch (error) {
    if (error.status === 409) return; // somebody else was faster; the next state says so
    say(problem, t(error.status === 403 || error.status === 401 ? "alarms.role" : "alarms.failed"));
    problem.hidden = false;
  }
}

/** Put the focus on the next alarm that nobody has seen. */
export function focus_next() {
  const buttons = [...$("alarms").querySelectorAll("button:not([hidden])")];
  if (!buttons.length) return;
  const at = buttons.indexOf(document.activeElement);
  buttons[(at + 1) % buttons.length].focus();
}

export function start() {
  for (const subject of ["state", "link", "texts", "page"]) store.on(subject, show);
}
