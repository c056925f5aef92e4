// What a step found, as pairs of name and value.
import { format_measured, format_number, format_percent, format_significant, t } from "../page/script/texts.js";

const with_unit = (value, unit) => `${value}\u00a0${t(`unit.${unit}`)}`;

const FORMATS = {
  cameras: (value) => format_number(value),
  core: (value) => value,
  names: (value) => value.join(", "),
  set_aside: (value) => value.join(", "),
  faults: (value) => value.join(", ") || t("commission.none"),
  exposure_us: (value) => list_by_camera(value),
  gain_db: (value) => list_by_camera(value),
  evenness: (value) => format_percent(value),
  instants: (value) => format_number(value),
  incomplete: (value) => format_number(value),
  allowed_skew_ms: (value) => with_unit(format_significant(value), "ms"),
  skew_limit_ms: (value) => format_significant(value),
  views: (value) => format_number(value),
  held_out_px: (value) => with_unit(format_significant(value), "px"),
  sigma_mm: (value) => with_unit(format_significant(value), "mm"),
  worst_mm: (value) => with_unit(format_significant(value), "mm"),
  uncovered: (value) => format_percent(value, 1),
  doubts: (value) => format_number(value),
  width_mm: (value) => with_unit(format_number(value), "mm"),
  noise_mm: (value) => with_unit(format_significant(value), "mm"),
  frames: (value) => format_number(value),
  records: (value) => format_number(value),
  belt_m: (value) => with_unit(format_significant(value), "m"),
  missing_share: (value) => format_percent(value, 1),
  number: (value) => value,
  days: (value) => format_number(value),
};

const list_by_camera = (values) => Object.entries(values).filter(([, value]) => value !== null).map(([name, value]) => `${name} ${format_significant(value)}`).join(", ") || t("commission.none");
const PARTS = new Set(["rig", "alarms", "density", "empty", "source", "encoder", "data", "page", "users", "reports", "scale"]); // others are protocols, which have names
const OF_FORM = new Set(["exposure_us", "gain_db", "skew_limit_ms"]); // named as in the form

export function format_facts({ name, result }) {
  const facts = Object.entries(FORMATS).filter(([key]) => result[key] !== undefined && result[key] !== null).map(([key, format]) => [t(`commission.${OF_FORM.has(key) ? "field" : "fact"}.${key}`), format(result[key])]);
  if (result.litres !== undefined) facts.unshift([t("commission.fact.litres"), with_unit(format_measured(result.litres, result.sigma_litres), "litre")]);
  if (name === "skew") facts.unshift(...(result.delays ? Object.entries(result.delays).map(format_delay) : [[t("commission.fact.skew"), t("commission.not_measured")]]));
  if (name === "project") facts.push(...Object.entries(result.parts).map(([part, line]) => [PARTS.has(part) ? t(`commission.part.${part}`) : part, line]));
  for (const one of name === "material" ? result.results ?? [] : []) facts.push([t(`commission.fact.result_${one.key}`), `${format_measured(one.value, one.sigma)}${one.unit ? `\u00a0${one.unit}` : ""}`]);
  for (const error of name === "material" ? result.errors : []) facts.push([t(`commission.fact.error_${error.key.includes("mass") ? "mass" : "volume"}`), `${format_measured(error.value, error.sigma)}\u00a0%`]);
  return facts;
}

const format_delay = ([camera, one]) => [t("commission.fact.delay", { camera }), `${with_unit(format_measured(one.delay_ms, one.sigma_ms), "ms")}; ${with_unit(format_measured(one.belt_mm, one.sigma_mm), "mm")}`];
