// The list of alarms: unacknowledged and urgent ones first, marked by shape, word and colour; those that people have hidden below.
import { act, may_engineer, may_operate, open_dialog } from "./alarm_actions.js";
import { explain, format_title, format_value_and_limit } from "./alarm_texts.js";
import { $, create_element, create_icon, set_text, sync_children } from "./dom.js";
import { store } from "./store.js";
import { format_moment, format_number, get_language, has_text, t } from "./texts.js";

export const PRIORITY_ORDER = { urgent: 0, high: 1, medium: 2, low: 3 };
const SEVERITY_ORDER = { critical: 0, warning: 1, info: 2 };
const STATE_ORDER = { raised: 0, gone: 1, acknowledged: 2, latched: 3, clear: 4 };
const is_unacknowledged = (alarm) => alarm.state === "raised" || alarm.state === "gone";
let raised_before = new Set();

export const format_group = (group) => (has_text(`group.${group}`) ? t(`group.${group}`) : group);

/** Return the order of alarms in a list: what explains others stands first. */
export function compare_alarms(a, b) {
  return ((b.consequences?.length > 0) - (a.consequences?.length > 0)) || (is_unacknowledged(b) - is_unacknowledged(a)) || PRIORITY_ORDER[a.priority] - PRIORITY_ORDER[b.priority] || SEVERITY_ORDER[a.severity] - SEVERITY_ORDER[b.severity] || STATE_ORDER[a.state] - STATE_ORDER[b.state] || b.since_ms - a.since_ms;
}

const is_alike = (a, b) => a.state === b.state && a.severity === b.severity && a.is_known === b.is_known;

/** Return the present alarms in their order, each with its title; the same fault of all cameras is one, with their names in `of`. */
export function list_shown() {
  const { alarms = [], cameras = [] } = store.state ?? {};
  const shown = [];
  const taken = new Set();
  for (const alarm of [...alarms].sort(compare_alarms)) {
    if (taken.has(alarm.name)) continue;
    const [kind, subject] = alarm.name.split(":");
    const all = cameras.map(({ name }) => alarms.find((one) => one.name === `${kind}:${name}`));
    const is_common = cameras.length > 1 && cameras.some(({ name }) => name === subject) && all.every((one) => one && is_alike(one, alarm));
    for (const one of is_common ? all : [alarm]) taken.add(one.name);
    shown.push(is_common
      ? { ...alarm, title: `${format_title(kind)}: ${t("alarms.all_cameras")}`, key: `${kind}:*`, of: all.map(({ name }) => name), first: all.some(({ first }) => first), value: null, cause: "", detail: "" }
      : { ...alarm, title: format_title(alarm.name), key: alarm.name, of: [alarm.name] });
  }
  // "came first" says something only beside others of its group
  const members = (group) => shown.filter((one) => one.group === group).length;
  return shown.map((one) => ({ ...one, first: one.first && members(one.group) > 1 }));
}

function create_item(alarm) {
  const button = (name, key, click) => create_element("button", { type: "button", class: name, "data-key": key, on: { click } });
  return create_element("li", { class: "alarm" }, create_icon(alarm.severity), create_element("h3"), create_element("span", { class: "when" }),
    create_element("p", { class: "value" }, create_element("b"), create_element("span")), create_element("p", { class: "tags" }, create_element("span", { class: "priority" }), create_element("span", { class: "first" })), create_element("p", { class: "help" }), create_element("p", { class: "explains" }),
    create_element("div", { class: "acts" }, button("acknowledge", "alarms.acknowledge", () => acknowledge(alarm.key)), button("acknowledge", "alarms.reset", () => act_on_all(alarm.key, "reset")),
      button("more", "alarms.shelve", () => open_dialog(alarm.name, "shelve")), button("more", "alarms.service", () => open_dialog(alarm.name, "out_of_service"))));
}

function update_item(item, alarm) {
  if (item.dataset.severity && item.dataset.severity !== alarm.severity) item.replaceChild(create_icon(alarm.severity), item.firstChild);
  Object.assign(item.dataset, { severity: alarm.severity, state: alarm.state, priority: alarm.priority });
  const [heading, when, value, advice] = ["h3", ".when", ".value", ".help"].map((name) => item.querySelector(name));
  set_text(heading, alarm.title);
  const by = alarm.by && (alarm.state === "acknowledged" || alarm.state === "latched") ? t("alarms.by", { name: alarm.by, time: format_moment(alarm.acknowledged_ms) }) : "";
  set_text(when, alarm.since_ms ? t("alarms.since", { time: format_moment(alarm.since_ms) }) : "");
  set_text(value.firstChild, [t(`severity.${alarm.severity}`), t(`alarm.${alarm.state}`), ...(alarm.is_known === false ? [t("alarms.not_known")] : [])].join(" · "));
  set_text(value.lastChild, ["", format_value_and_limit(alarm), by].filter((part, i) => part || !i).join(" · "));
  set_text(item.querySelector(".priority"), t("alarms.priority", { priority: t(`priority.${alarm.priority}`) }));
  const first = item.querySelector(".first");
  first.hidden = !alarm.first;
  set_text(first, t("alarms.first"));
  first.title = alarm.first ? t("alarms.first_of", { group: format_group(alarm.group) }) : "";
  set_text(advice, explain(alarm));
  const explained = item.querySelector(".explains");
  explained.hidden = !alarm.consequences?.length;
  set_text(explained, explained.hidden ? "" : t("alarms.explains", { alarms: alarm.consequences.map(format_title).join(", ") }));
  item.title = get_language() === "en" ? alarm.detail : "";
  advice.hidden = !advice.textContent;
  update_buttons(item, alarm);
}

function update_buttons(item, alarm) {
  const is_shown = { "alarms.acknowledge": may_operate() && is_unacknowledged(alarm), "alarms.reset": may_operate() && alarm.state === "latched", "alarms.shelve": may_operate() && alarm.of.length === 1, "alarms.service": may_engineer() && alarm.of.length === 1 };
  const labels = { "alarms.acknowledge": "alarms.acknowledge_one", "alarms.reset": "alarms.reset_one", "alarms.shelve": "alarms.shelve_one", "alarms.service": "alarms.service_one" };
  for (const button of item.querySelectorAll("button")) {
    const key = button.dataset.key;
    button.hidden = !is_shown[key];
    button.disabled = store.link === "lost";
    set_text(button, t(key));
    button.setAttribute("aria-label", t(labels[key], { alarm: alarm.title }));
  }
}

function create_hidden(alarm) {
  const end = () => act(alarm.name, alarm.suppression.kind === "shelved" ? "unshelve" : "return_to_service");
  return create_element("li", {}, create_element("h3"), create_element("p"), create_element("button", { type: "button", class: "more", on: { click: end } }));
}

function update_hidden(item, alarm) {
  const [heading, text, button] = item.children;
  const { kind, reason, by, since_ms, until_ms } = alarm.suppression;
  const is_shelved = kind === "shelved";
  set_text(heading, format_title(alarm.name));
  const why = is_shelved ? t("alarms.shelved_until", { time: format_moment(until_ms), by, reason }) : t("alarms.out_of_service", { time: format_moment(since_ms), by, reason });
  const holds = alarm.hidden_state === "raised" || alarm.hidden_state === "acknowledged";
  set_text(text, holds ? `${why} – ${t("alarms.holds")}` : why);
  button.hidden = !(is_shelved ? may_operate() : may_engineer());
  set_text(button, t(is_shelved ? "alarms.unshelve" : "alarms.return"));
  button.setAttribute("aria-label", t(is_shelved ? "alarms.unshelve_one" : "alarms.return_one", { alarm: format_title(alarm.name) }));
}

function render_hidden() {
  const hidden = store.state?.hidden_alarms ?? [];
  $("alarms-hidden").hidden = !hidden.length;
  set_text($("alarms-hidden-count"), t("alarms.hidden", { count: format_number(hidden.length) }));
  sync_children($("alarms-hidden-list"), hidden, (alarm) => `${alarm.name} ${alarm.suppression.kind}`, create_hidden, update_hidden);
}

function render() {
  const is_connected = store.link === "live" || store.link === "stale";
  const alarms = list_shown();
  const unacknowledged = alarms.filter(is_unacknowledged);
  sync_children($("alarms"), alarms, (alarm) => alarm.key, create_item, update_item);
  render_hidden();
  const none = $("alarms-none");
  none.hidden = alarms.length > 0;
  const key = is_connected ? "alarms.none" : "alarms.unknown";
  if (none.dataset.shown !== key + get_language()) none.replaceChildren(...(is_connected ? [create_icon("good")] : []), t(key));
  none.dataset.shown = key + get_language();
  $("alarms-role").hidden = !unacknowledged.length || store.page?.role !== "viewer";
  $("alarms-unsure").hidden = is_connected || !alarms.length;
  $("alarms-count").hidden = !unacknowledged.length;
  set_text($("alarms-count"), t("alarms.count", { count: format_number(unacknowledged.length) }));
  const raised = unacknowledged.filter((alarm) => alarm.state === "raised");
  for (const alarm of raised) if (!raised_before.has(alarm.key)) set_text($("alarms-said"), t("alarms.announce", { alarm: alarm.title }));
  raised_before = new Set(raised.map((alarm) => alarm.key));
  document.title = `${unacknowledged.length ? `(${unacknowledged.length}) ` : ""}${store.page?.plant || t("title")}`;
}

const list_buttons = () => [...$("alarms").querySelectorAll("button.acknowledge:not([hidden])")];

/** Do something to the alarms of an item; return whether any took it. */
async function act_on_all(key, action) {
  const names = list_shown().find((one) => one.key === key)?.of ?? [];
  const done = await Promise.all(names.map((name) => act(name, action)));
  return done.some(Boolean);
}

async function acknowledge(key) {
  const next = list_buttons().find((button) => button.closest("li").dataset.key !== key);
  if (await act_on_all(key, "acknowledge")) (next ?? $("main")).focus({ preventScroll: true });
}

/** Focus the button of the next unacknowledged alarm. */
export function focus_next_alarm() {
  const buttons = list_buttons();
  if (!buttons.length) return;
  const at = buttons.indexOf(document.activeElement);
  buttons[(at + 1) % buttons.length].focus();
}

export function start() {
  for (const subject of ["state", "link", "texts", "page"]) store.on(subject, render);
}
