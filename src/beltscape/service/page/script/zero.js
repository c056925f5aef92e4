// The zero of the empty belt: an engineer measures it, sees the result, and confirms it.
import { format_value_and_sigma, translate_cause } from "./alarm_texts.js";
import { post } from "./api.js";
import { $, create_element, set_text } from "./dom.js";
import { format_number, get_language, t } from "./texts.js";

/** Return the panel of the view of the checks. */
export function create_panel() {
  return create_element("section", { class: "panel zero" },
    create_element("header", {}, create_element("h2", { "data-text": "zero.title" }), create_element("button", { type: "button", class: "plain small", id: "zero-open", "data-text": "zero.open", on: { click: open } })),
    create_element("p", { class: "soft", "data-text": "zero.about" }), create_element("p", { id: "zero-present" }));
}

/** Show where the bare belt lies, from the newest findings. */
export function show(checks) {
  const found = ["zero_drift", "zero_shift"].map((name) => checks.find((one) => one.check === name && one.value != null)).find(Boolean);
  set_text($("zero-present"), found ? t("zero.present", { value: format_value_and_sigma(found.value, found.sigma, found.unit) }) : t("zero.unknown"));
}

function open() {
  const dialog = $("zero-dialog");
  if (dialog.open) return;
  const about = create_element("p", {}, t("zero.ask"));
  const problem = create_element("p", { class: "problem", role: "alert", hidden: true });
  const close = create_element("button", { type: "button", class: "plain", on: { click: () => dialog.close() } }, t("keep.cancel"));
  const next = create_element("button", { type: "button", class: "plain main", id: "zero-next" }, t("zero.measure"));
  const parts = { dialog, about, problem, close, next };
  next.onclick = () => measure(parts);
  dialog.replaceChildren(create_element("h2", { id: "zero-title" }, t("zero.title")), about, problem, create_element("div", { class: "row" }, close, next));
  dialog.showModal();
}

async function measure(parts) {
  const { about, problem, next } = parts;
  next.disabled = true;
  problem.hidden = true;
  set_text(about, t("zero.measuring"));
  try {
    const found = await post("api/zero/measure");
    const [offset, sigma, tilt] = [found.offset_mm, found.sigma_mm, found.tilt_mm].map((value) => format_number(value, 2));
    set_text(about, t("zero.result", { offset, sigma, tilt, frames: found.frames, limit: format_number(found.limit_mm, 1) }));
    set_text(next, t("zero.set"));
    next.onclick = () => set_zero(parts, found.number);
  } catch (error) {
    refuse(parts, explain(error));
  }
  next.disabled = false;
}

async function set_zero(parts, number) {
  const { about, next, close } = parts;
  next.disabled = true;
  try {
    await post("api/zero/set", { number });
    set_text(about, t("zero.done"));
    next.hidden = true;
    set_text(close, t("keys.close"));
  } catch (error) {
    refuse(parts, t(error.status === 409 ? "zero.expired" : "zero.failed"));
  }
  next.disabled = false;
}

/** Show why it was refused, and offer to measure again. */
function refuse(parts, text) {
  const { about, problem, next } = parts;
  set_text(about, t("zero.ask"));
  set_text(problem, text);
  problem.hidden = false;
  set_text(next, t("zero.measure"));
  next.onclick = () => measure(parts);
}

function explain(error) {
  if (error.status !== 409) return t("zero.failed");
  const { detail, cause, values } = JSON.parse(error.message);
  return translate_cause(cause, values) ?? (get_language() === "en" ? detail : t("zero.failed"));
}
