// Alarms of the site and of its belts in one list, severe ones first; they are acknowledged on the belt's own page.
import { explain, format_title } from "../page/script/alarm_texts.js";
import { $, create_element, create_icon, set_text, sync_children } from "../page/script/dom.js";
import { format_moment, format_number, t } from "../page/script/texts.js";
import { explain_fault } from "./belts.js";

const SILENT = ["unreachable", "timeout"]; // faults of a machine that may go on measuring
const SEVERITY_ORDER = { critical: 0, warning: 1, info: 2 };

function find_help(kind, belt) {
  if (kind === "imbalance") return t("site.help_imbalance");
  const fault = belt?.faults.find(({ key }) => key === kind) ?? belt?.faults[0];
  const text = fault ? explain_fault(fault) : "";
  const is_silent = kind === "away" && (!fault || SILENT.includes(fault.key));
  return is_silent ? `${text} ${t("site.help_away")}`.trim() : text;
}

function list_alarms({ alarms, belts }) {
  const own = alarms.map(({ kind, subject, severity, since_ms }) => ({
    key: `site:${kind}:${subject}`, severity, state: "raised", since_ms, subject,
    title: t(kind === "imbalance" ? "site.alarm_imbalance" : kind === "away" ? "site.away" : "site.alarm_fault"),
    help: find_help(kind, belts.find((belt) => belt.name === subject)),
  }));
  const of_belts = belts.flatMap((belt) => belt.alarms.map((alarm) => ({ ...alarm, key: `${belt.name}:${alarm.name}`, subject: belt.name, title: format_title(alarm.name), help: explain(alarm), url: belt.url })));
  return [...own, ...of_belts].sort((a, b) => SEVERITY_ORDER[a.severity] - SEVERITY_ORDER[b.severity] || (b.since_ms ?? 0) - (a.since_ms ?? 0));
}

function create_item(alarm) {
  return create_element("li", { class: "alarm" }, create_icon(alarm.severity), create_element("h3"), create_element("span", { class: "when" }), create_element("p", { class: "value" }, create_element("b"), create_element("span")), create_element("p", { class: "help" }));
}

function update_item(item, alarm) {
  const [, heading, when, value, help] = item.children;
  item.dataset.severity = alarm.severity;
  item.dataset.state = alarm.state;
  set_text(heading, `${alarm.subject}: ${alarm.title}`);
  set_text(when, alarm.since_ms ? t("alarms.since", { time: format_moment(alarm.since_ms) }) : "");
  set_text(value.firstChild, t(`severity.${alarm.severity}`));
  set_text(value.lastChild, alarm.url ? ` · ${t(`alarm.${alarm.state}`)}` : "");
  set_text(help, alarm.help);
}

export function show_alarms(state) {
  const alarms = list_alarms(state);
  sync_children($("alarms"), alarms, (alarm) => `${alarm.key}:${alarm.severity}`, create_item, update_item);
  $("alarms-none").hidden = alarms.length > 0;
  $("alarms-count").hidden = !alarms.length;
  set_text($("alarms-count"), format_number(alarms.length));
}
