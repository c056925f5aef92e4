// Every word on the page, in the chosen language, from texts.json; numbers and times as its readers write them.
import { store } from "./store.js";

const LOCALES = { en: "en-GB", de: "de-DE", zh: "zh-CN" };
let table = {};
let language = "en";
const formats = new Map();

export async function load(fallback) {
  table = await (await fetch("/page/texts.json")).json();
  const wish = new URLSearchParams(location.search).get("lang") || localStorage.getItem("language");
  choose(wish in LOCALES ? wish : fallback in LOCALES ? fallback : "en", false);
}

export function choose(name, keep = true) {
  language = name;
  formats.clear();
  if (keep) localStorage.setItem("language", name);
  document.documentElement.lang = name === "zh" ? "zh-Hans" : name;
  apply(document);
  store.tell("texts");
}

export const languages = () => Object.keys(LOCALES);
export const chosen = () => language;

/** The text of a key, {names} filled in; a key that is not there shows itself. */
export function t(key, values = {}) {
  const text = table[key]?.[language] ?? key;
  return text.replace(/\{(\w+)\}/g, (_, name) => values[name] ?? "");
}

export const has = (key) => key in table;

/** Fill in data-text, data-label, data-hint and data-title (both of them) below an element. */
export function apply(root) {
  for (const element of root.querySelectorAll("[data-text]")) element.textContent = t(element.dataset.text);
  for (const element of root.querySelectorAll("[data-label]")) element.setAttribute("aria-label", t(element.dataset.label));
  for (const element of root.querySelectorAll("[data-hint]")) element.title = t(element.dataset.hint);
  for (const element of root.querySelectorAll("[data-title]")) {
    element.title = t(element.dataset.title);
    element.setAttribute("aria-label", t(element.dataset.title));
  }
}

/** The reader's own locale where it is of the chosen language, else that language's usual one. */
function locale() {
  return navigator.languages.find((name) => name.split("-")[0] === language) ?? LOCALES[language];
}

function format(kind, options) {
  const key = kind + JSON.stringify(options);
  if (!formats.has(key)) formats.set(key, new Intl[kind](locale(), options));
  return formats.get(key);
}

const NONE = "–";

export function number(value, digits = 0) {
  if (value == null || !Number.isFinite(value)) return NONE;
  return format("NumberFormat", { minimumFractionDigits: digits, maximumFractionDigits: digits }).format(value);
}

/** A number with as many digits as it takes to show three of them. */
export function three(value) {
  if (value == null || !Number.isFinite(value)) return NONE;
  const size = Math.abs(value);
  return number(value, size >= 99.5 || size === 0 ? 0 : size >= 9.95 ? 1 : size >= 0.995 ? 2 : 3);
}

/** An uncertainty: two digits are enough of it. */
export function spread(value) {
  if (value == null || !Number.isFinite(value)) return "";
  const size = Math.abs(value);
  return `±\u00a0${number(value, size >= 9.95 ? 0 : size >= 0.995 ? 1 : 2)}`;
}

export const percent = (share, digits = 0) =>
  share == null || !Number.isFinite(share) ? NONE : format("NumberFormat", { style: "percent", minimumFractionDigits: digits, maximumFractionDigits: digits }).format(share);

export const signed_percent = (share) =>
  format("NumberFormat", { style: "percent", maximumFractionDigits: 0, signDisplay: "exceptZero" }).format(share);

export const unit = (value, name) => (value === NONE ? NONE : `${value}\u00a0${t(`unit.${name}`)}`);

export const time = (ms, seconds = true) =>
  format("DateTimeFormat", { hour: "2-digit", minute: "2-digit", ...(seconds ? { second: "2-digit" } : {}), hourCycle: "h23" }).format(ms);

export const day = (ms) => format("DateTimeFormat", { day: "2-digit", month: "2-digit", year: "numeric" }).format(ms);
export const short_day = (ms) => format("DateTimeFormat", { day: "numeric", month: "short" }).format(ms);
export const day_and_time = (ms, seconds = false) => `${day(ms)} ${time(ms, seconds)}`;

/** The time of an instant, with its day where that is not today. */
export const moment = (ms) => (day(ms) === day(Date.now()) ? time(ms) : day_and_time(ms, true));

export function duration(seconds) {
  if (seconds < 90) return unit(number(Math.floor(seconds)), "s");
  if (seconds < 5400) return unit(number(Math.floor(seconds / 60)), "min");
  return unit(number(seconds / 3600, 1), "h");
}
