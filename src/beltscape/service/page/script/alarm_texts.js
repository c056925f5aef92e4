// Texts of alarms: title, value and limit, the fault and the fix; the plant's own texts stand before the page's.
import { store } from "./store.js";
import { format_measured, format_number, format_percent, format_plain, format_significant, get_language, has_text, t } from "./texts.js";

/** Return the plant's own text of an alarm in the chosen language: "title" or "detail"; empty: there is none. */
function find_own(name, part) {
  const texts = store.page?.alarm_texts?.[get_language()] ?? {};
  return texts[name]?.[part] || texts[name.split(":")[0]]?.[part] || "";
}

const fill = (text, values) => text.replace(/\{(\w+)\}/g, (_, key) => values[key] ?? "");

/** Return an alarm's title: "camera_lost:cam2" → "Camera lost: cam2"; an unknown name is kept. */
export function format_title(name) {
  const [kind, ...rest] = name.split(":");
  const subject = rest.join(":");
  const own = find_own(name, "title");
  if (own) return own.includes("{subject}") || !subject || store.page.alarm_texts[get_language()][name]?.title ? fill(own, { subject }) : `${own}: ${subject}`;
  const key = [`alarm.${kind}`, `check.${kind}`].find(has_text);
  const text = key ? t(key) : kind.replaceAll("_", " ");
  return rest.length ? `${text}: ${subject}` : text;
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
  if (unit === "%") return format_percent(limit / 100, Number.isInteger(limit) ? 0 : 1);
  return `${format_plain(limit)}${unit && unit !== "1" ? `\u00a0${unit}` : ""}`;
}

export function format_value_and_limit({ value, limit, unit }) {
  if (value == null) return "";
  return limit == null ? format_value(value, unit) : t("alarms.limit", { value: format_value(value, unit), limit: format_limit(limit, unit) });
}

/** Return a camera's or an alarm's cause in the chosen language; null without a text. */
export function translate_cause(cause, values) {
  if (!cause || !has_text(`cause.${cause}`)) return null;
  const shown = Object.fromEntries(Object.entries(values ?? {}).map(([name, value]) => [name, typeof value === "number" ? format_plain(value) : value]));
  return t(`cause.${cause}`, shown).replaceAll(" %", "\u00a0%");
}

/** Return the fault and the fix in the chosen language: the plant's own text, else the page's, else the program's in English. */
export function explain(alarm) {
  if (alarm.state === "gone") return t("alarms.over");
  if (alarm.state === "latched") return t("alarms.over_reset");
  if (alarm.is_known === false && alarm.limit != null && has_text(`alarm.${alarm.name.split(":")[0]}`)) return t("alarms.not_known_help");
  const own = find_own(alarm.name, "detail");
  if (!own) return explain_by_page(alarm);
  if (get_language() === "en" && alarm.detail) return alarm.detail; // the program has filled it in already
  const [value, limit] = [format_value(alarm.value, alarm.unit), alarm.limit == null ? "" : format_limit(alarm.limit, alarm.unit)];
  return fill(own, { value, limit, subject: alarm.name.split(":").slice(1).join(":"), detail: explain_by_page(alarm) });
}

function explain_by_page({ name, detail, cause, values }) {
  const kind = name.split(":")[0];
  const own = translate_cause(cause, values);
  if (own) return own;
  const help = [`help.${kind}_${cause}`, `help.${kind}`].find(has_text);
  const is_check = has_text(`check.${kind}`) || !help;
  return detail && (is_check && get_language() === "en" || !help) ? detail : t(help);
}

/** Return an entry of the journal in the chosen language: the alarm's change, or what a person did. */
export function translate_entry({ name, text, parameters }) {
  const { action } = parameters;
  if (action === "start") return t("action.start", { hidden: list_titles(parameters.hidden), present: list_titles(parameters.present ?? []) });
  const title = format_title(name);
  if (action && has_text(`action.${action}`)) return `${title} – ${t(`action.${action}`, { reason: parameters.reason, minutes: format_number(parameters.minutes ?? null) })}`;
  const state = parameters.state ?? /^(raised|acknowledged|gone|clear)\b/.exec(text)?.[0]; // of an older version
  if (!state) return `${title} – ${text}`;
  const begin = `${state}${parameters.suppression ? ` (${parameters.suppression}: ${parameters.suppressed_by})` : ""}: `;
  const detail = text.startsWith(begin) ? text.slice(begin.length) : "";
  const help = state !== "raised" ? "" : get_language() === "en" && detail ? detail : explain({ name, detail, cause: parameters.cause, values: parameters.values, value: parameters.value, limit: parameters.limit, unit: parameters.unit });
  const numbers = get_language() === "en" && help ? "" : format_value_and_limit(parameters);
  const changed = [t(`alarm.${state}`), parameters.suppression ? describe_suppression(parameters.suppressed_by) : "", parameters.first ? t("alarms.first") : ""].filter(Boolean).join(", ");
  return `${title} – ${[changed, numbers, help].filter(Boolean).join(": ")}`;
}

function list_titles(names) {
  return names.map(format_title).join(", ") || t("alarms.nothing");
}

/** Return why an alarm is suppressed: a state of the plant, or what a person wrote. */
export function describe_suppression(reason) {
  const key = [`suppression.${reason}`, `alarm.${reason}`, `check.${reason}`].find(has_text);
  return t("alarms.suppressed", { reason: key ? t(key) : reason });
}
