// The list of alarms: unacknowledged and severe ones first, marked by shape, word and colour; acknowledged by button or keys A, Enter.
import { post } from "./api.js";
import { $, create_element, create_icon, set_text, sync_children } from "./dom.js";
import { store } from "./store.js";
import { format_measured, format_moment, format_number, format_percent, format_plain, format_significant, get_language, has_text, t } from "./texts.js";

const SEVERITY_ORDER = { critical: 0, warning: 1, info: 2 };
const STATE_ORDER = { raised: 0, gone: 1, acknowledged: 2, clear: 3 };
const is_unacknowledged = (alarm) => alarm.state === "raised" || alarm.state === "gone";
let raised_before = new Set();

/** Return an alarm's title: "camera_lost:cam2" → "Camera lost: cam2"; an unknown name is kept. */
export function format_title(name) {
  const [kind, ...rest] = name.split(":");
  const key = [`alarm.${kind}`, `check.${kind}`].find(has_text);
  const text = key ? t(key) : kind.replaceAll("_", " ");
  return rest.length ? `${text}: ${rest.join(":")}` : text;
}

export function format_value(value, unit) {
  if (value == null) return "";
  if (unit === "" || unit === "1") return format_significant(value);
  return unit === "%" ? format_percent(value / 100, Math.abs(value) < 9.95 ? 1 : 0) : `${format_significant(value)}\u00a0${unit}`;
}

/** Return a check's value with its standard deviation, if it is known. */
export function format_value_and_sigma(value, sigma, unit) {
  if (!sigma) return format_value(value, unit);
  return `${format_measured(value, sigma)}${unit && unit !== "1" ? `\u00a0${unit}` : ""}`;
}

export function format_limit(limit, unit) {
  return `${format_plain(limit)}${unit && unit !== "1" ? `\u00a0${unit}` : ""}`;
}

function format_value_and_limit(alarm) {
  if (alarm.value == null) return "";
  const value = format_value(alarm.value, alarm.unit);
  return alarm.limit == null ? value : t("alarms.limit", { value, limit: format_limit(alarm.limit, alarm.unit) });
}

/** Return a camera's or an alarm's cause in the chosen language; null without a text. */
export function translate_cause(cause, values) {
  if (!cause || !has_text(`cause.${cause}`)) return null;
  const shown = Object.fromEntries(Object.entries(values ?? {}).map(([name, value]) => [name, typeof value === "number" ? format_plain(value) : value]));
  return t(`cause.${cause}`, shown).replaceAll(" %", "\u00a0%");
}

/** Return the fault and the fix in the chosen language; a check's own text in English. */
export function explain({ name, detail, cause, values }) {
  const kind = name.split(":")[0];
  const own = translate_cause(cause, values);
  if (own) return own;
  const help = [`help.${kind}_${cause}`, `help.${kind}`].find(has_text);
  const is_check = has_text(`check.${kind}`) || !help;
  return detail && (is_check && get_language() === "en" || !help) ? detail : t(help);
}

function create_item(alarm) {
  return create_element("li", { class: "alarm" }, create_icon(alarm.severity), create_element("h3"), create_element("span", { class: "when" }), create_element("p", { class: "value" }, create_element("b"), create_element("span")), create_element("p", { class: "help" }),
    create_element("button", { type: "button", on: { click: () => acknowledge(alarm.name) } }));
}

function update_item(item, alarm) {
  const [, heading, when, value, advice, button] = item.children;
  if (item.dataset.severity && item.dataset.severity !== alarm.severity) item.replaceChild(create_icon(alarm.severity), item.firstChild);
  item.dataset.severity = alarm.severity;
  item.dataset.state = alarm.state;
  set_text(heading, format_title(alarm.name));
  const by = alarm.by && alarm.state === "acknowledged" ? t("alarms.by", { name: alarm.by }) : "";
  set_text(when, alarm.since_ms ? t("alarms.since", { time: format_moment(alarm.since_ms) }) : "");
  set_text(value.firstChild, `${t(`severity.${alarm.severity}`)} · ${t(`alarm.${alarm.state}`)}`);
  set_text(value.lastChild, ["", format_value_and_limit(alarm), by].filter((part, i) => part || !i).join(" · "));
  set_text(advice, explain(alarm));
  item.title = get_language() === "en" ? alarm.detail : "";
  advice.hidden = !advice.textContent;
  button.hidden = !is_unacknowledged(alarm) || store.page?.role === "viewer";
  button.disabled = store.link === "lost";
  set_text(button, t("alarms.acknowledge"));
  button.setAttribute("aria-label", t("alarms.acknowledge_one", { alarm: format_title(alarm.name) }));
}

function render() {
  const is_connected = store.link === "live" || store.link === "stale";
  const alarms = [...(store.state?.alarms ?? [])].sort((a, b) => (is_unacknowledged(b) - is_unacknowledged(a)) || SEVERITY_ORDER[a.severity] - SEVERITY_ORDER[b.severity] || STATE_ORDER[a.state] - STATE_ORDER[b.state] || b.since_ms - a.since_ms);
  const unacknowledged = alarms.filter(is_unacknowledged);
  sync_children($("alarms"), alarms, (alarm) => alarm.name, create_item, update_item);
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
  for (const alarm of raised) if (!raised_before.has(alarm.name)) set_text($("alarms-said"), t("alarms.announce", { alarm: format_title(alarm.name) }));
  raised_before = new Set(raised.map((alarm) => alarm.name));
  document.title = `${unacknowledged.length ? `(${unacknowledged.length}) ` : ""}${store.page?.plant || t("title")}`;
}

async function acknowledge(name) {
  const problem = $("alarms-problem");
  problem.hidden = true;
  const next = [...$("alarms").querySelectorAll("button:not([hidden])")].find((button) => button.parentElement.dataset.key !== name);
  try {
    await post(`/api/alarms/${encodeURIComponent(name)}/acknowledge`);
    (next ?? $("main")).focus({ preventScroll: true });
  } catch (error) {
    if (error.status === 409) return; // another user was faster; the next state shows it
    set_text(problem, t(error.status === 403 || error.status === 401 ? "alarms.role" : "alarms.failed"));
    problem.hidden = false;
  }
}

/** Focus the button of the next unacknowledged alarm. */
export function focus_next_alarm() {
  const buttons = [...$("alarms").querySelectorAll("button:not([hidden])")];
  if (!buttons.length) return;
  const at = buttons.indexOf(document.activeElement);
  buttons[(at + 1) % buttons.length].focus();
}

export function start() {
  for (const subject of ["state", "link", "texts", "page"]) store.on(subject, render);
}
