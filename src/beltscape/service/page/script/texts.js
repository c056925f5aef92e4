// All texts of the page in the chosen language, from its file; numbers and times in the user's locale.
import { store } from "./store.js";

let languages = new Map(); // code → name, locale, tag, table of texts; in the order of the menu
let language = "en";
let table = {};
const formats = new Map();

const fetch_json = async (path) => (await fetch(path)).json();

/** Load every language, so that one can be chosen without a connection as well. */
export async function load_texts(fallback) {
  const found = await fetch_json("page/languages.json");
  const tables = await Promise.all(found.map(({ code }) => fetch_json(`page/languages/${code}.json`)));
  languages = new Map(found.map((one, i) => [one.code, { ...one, table: tables[i] }]));
  const wanted = [new URLSearchParams(location.search).get("lang"), localStorage.getItem("language"), fallback];
  set_language(wanted.find((code) => languages.has(code)) ?? "en", false);
}

export function set_language(code, remember = true) {
  language = code;
  table = languages.get(code).table;
  formats.clear();
  if (remember) localStorage.setItem("language", code);
  document.documentElement.lang = languages.get(code).tag;
  apply_texts(document);
  store.emit("texts");
}

/** Return the languages in the order of the menu, each with its code and its name in itself. */
export const list_languages = () => [...languages.values()];
export const get_language = () => language;

/** Return the text of a key with {names} filled in; an unknown key is returned as it is. */
export function t(key, values = {}) {
  const text = table[key] ?? key;
  return text.replace(/\{(\w+)\}/g, (_, name) => values[name] ?? "");
}

export const has_text = (key) => key in table;

/** Apply data-text, data-label, data-hint and data-title (hint and label) below an element. */
export function apply_texts(root) {
  for (const element of root.querySelectorAll("[data-text]")) element.textContent = t(element.dataset.text);
  for (const element of root.querySelectorAll("[data-label]")) element.setAttribute("aria-label", t(element.dataset.label));
  for (const element of root.querySelectorAll("[data-hint]")) element.title = t(element.dataset.hint);
  for (const element of root.querySelectorAll("[data-title]")) {
    element.title = t(element.dataset.title);
    element.setAttribute("aria-label", t(element.dataset.title));
  }
}

/** Return the user's own locale if it is of the chosen language, else that language's default. */
function get_locale() {
  return navigator.languages.find((name) => name.split("-")[0] === language) ?? languages.get(language).locale;
}

function get_format(kind, options) {
  const key = kind + JSON.stringify(options);
  if (!formats.has(key)) formats.set(key, new Intl[kind](get_locale(), options));
  return formats.get(key);
}

const NONE = "–";

export function format_number(value, digits = 0) {
  if (value == null || !Number.isFinite(value)) return NONE;
  return get_format("NumberFormat", { minimumFractionDigits: digits, maximumFractionDigits: digits }).format(value);
}

/** Return a number with three significant digits. */
export function format_significant(value) {
  if (value == null || !Number.isFinite(value)) return NONE;
  const size = Math.abs(value);
  return format_number(value, size >= 99.5 || size === 0 ? 0 : size >= 9.95 ? 1 : size >= 0.995 ? 2 : 3);
}

/** Return a number that was given or is rounded already, without zeros at its end. */
export const format_plain = (value) => get_format("NumberFormat", { maximumSignificantDigits: 4 }).format(value);

/** Return a value with its uncertainty: this has two significant digits, and the value ends where it does. */
export function format_measured(value, sigma) {
  const digits = Math.min(Math.max(1 - Math.floor(Math.log10(sigma)), 0), 4);
  return `${format_number(value, digits)}\u00a0±\u00a0${format_number(sigma, digits)}`;
}

/** Return an uncertainty with two significant digits. */
export function format_uncertainty(value) {
  if (value == null || !Number.isFinite(value)) return "";
  const size = Math.abs(value);
  return `±\u00a0${format_number(value, size >= 9.95 ? 0 : size >= 0.995 ? 1 : 2)}`;
}

export const format_percent = (share, digits = 0) =>
  share == null || !Number.isFinite(share) ? NONE : get_format("NumberFormat", { style: "percent", minimumFractionDigits: digits, maximumFractionDigits: digits }).format(share);

export const format_signed_percent = (share) =>
  get_format("NumberFormat", { style: "percent", maximumFractionDigits: 0, signDisplay: "exceptZero" }).format(share);

export const format_unit = (value, name) => (value === NONE ? NONE : `${value}\u00a0${t(`unit.${name}`)}`);

export const format_time = (ms, seconds = true) =>
  get_format("DateTimeFormat", { hour: "2-digit", minute: "2-digit", ...(seconds ? { second: "2-digit" } : {}), hourCycle: "h23" }).format(ms);

export const format_day = (ms) => get_format("DateTimeFormat", { day: "2-digit", month: "2-digit", year: "numeric" }).format(ms);
export const format_short_day = (ms) => get_format("DateTimeFormat", { day: "numeric", month: "short" }).format(ms);
export const format_date_time = (ms, seconds = false) => `${format_day(ms)} ${format_time(ms, seconds)}`;

/** Return the time of an instant, with its date if that is not today. */
export const format_moment = (ms) => (format_day(ms) === format_day(Date.now()) ? format_time(ms) : format_date_time(ms, true));

export function format_duration(seconds) {
  if (seconds < 90) return format_unit(format_number(Math.floor(seconds)), "s");
  if (seconds < 5400) return format_unit(format_number(Math.floor(seconds / 60)), "min");
  return format_unit(format_number(seconds / 3600, 1), "h");
}
