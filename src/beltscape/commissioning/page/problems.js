// What failed: a sentence in the page's language that says what to do, and below it the program's own line.
import { $, create_element } from "../page/script/dom.js";
import { t } from "../page/script/texts.js";

let is_refused = false; // a refusal that is shown goes before an earlier failure of the step

/** Return a line of the program, which is English in every language and marked as such. */
export const create_program_line = (line) => create_element("span", { class: "program" }, `${t("commission.program")} `, create_element("span", { lang: "en" }, line));

/** Show a sentence, and the program's line that goes with it; an empty sentence hides both. */
export function show_problem(sentence, line = "") {
  const place = $("step-problem");
  place.hidden = !sentence;
  const shown = JSON.stringify([sentence, line]);
  if (place.dataset.shown === shown) return; // an alert that is written again is read out again
  place.dataset.shown = shown;
  place.replaceChildren(create_element("span", {}, sentence), ...(line ? [create_program_line(line)] : []));
}

export function hide_problem() {
  is_refused = false;
  show_problem("");
}

/** Show why the step is open again. */
export function show_failure({ name, failure }) {
  if (is_refused) return;
  if (failure === "cancelled") show_problem(t("commission.cancelled"));
  else show_problem(t(`commission.failed.${name}`), failure);
}

/** Show why a change was refused, or that nobody answered. */
export function show_refusal(path, error) {
  is_refused = true;
  if (error.status === undefined) show_problem(t("commission.unsent"));
  else show_problem(t(`commission.refused.${path.split("/")[2]}`), read_line(error));
}

/** Return the line of an answer that refuses. */
export function read_line({ message }) {
  let line = message;
  try { line = JSON.parse(message).detail ?? message; } catch { /* it is no JSON */ }
  return typeof line === "string" ? line : JSON.stringify(line);
}
