// The drift of the rig: an engineer sees what moved and what the proposal would change, takes it or not, and undoes it.
import { get, post } from "./api.js";
import { $, create_element, set_text } from "./dom.js";
import { format_number, get_language, t } from "./texts.js";

/** Return the panel of the view of the checks. */
export function create_panel() {
  return create_element("section", { class: "panel zero" },
    create_element("header", {}, create_element("h2", { "data-text": "drift.title" }), create_element("button", { type: "button", class: "plain small", id: "drift-open", "data-text": "drift.open", on: { click: open } })),
    create_element("p", { class: "soft", "data-text": "drift.about" }));
}

function open() {
  const dialog = $("drift-dialog");
  if (dialog.open) return;
  const found = create_element("div", { id: "drift-found" }, create_element("p", {}, t("drift.reading")));
  const problem = create_element("p", { class: "problem", role: "alert", hidden: true });
  const close = create_element("button", { type: "button", class: "plain", on: { click: () => dialog.close() } }, t("keys.close"));
  const undo = create_element("button", { type: "button", class: "plain", id: "drift-undo", hidden: true }, t("drift.undo"));
  const take = create_element("button", { type: "button", class: "plain main", id: "drift-take", hidden: true }, t("drift.take"));
  const parts = { found, problem, undo, take };
  undo.onclick = () => change(parts, () => post("api/drift/undo"), "drift.undone");
  dialog.replaceChildren(create_element("h2", { id: "drift-title" }, t("drift.title")), found, problem, create_element("div", { class: "row" }, close, undo, take));
  dialog.showModal();
  change(parts, () => get("api/drift"), "");
}

/** Show what a request answers; the buttons rest meanwhile. */
async function change(parts, request, done) {
  const { problem, undo, take } = parts;
  undo.disabled = take.disabled = true;
  problem.hidden = true;
  try {
    show(parts, await request(), done);
  } catch (error) {
    show_problem(problem, error);
  }
  undo.disabled = take.disabled = false;
}

function show(parts, drift, done) {
  const { found, undo, take } = parts;
  const lines = [...(done ? [t(done)] : []), ...(drift.also.length ? [t("drift.also", { settings: drift.also.join(", ") })] : []), describe(drift)];
  if (drift.has_proposal && !drift.is_significant) lines.push(t("drift.insignificant"));
  if (drift.needs_new_belt) lines.push(t("drift.core"));
  const report = create_element("a", { href: `api/drift/report?language=${get_language()}`, target: "_blank", rel: "noopener" }, t("drift.report"));
  found.replaceChildren(...lines.map((line) => create_element("p", {}, line)), ...(drift.estimates ? [create_element("p", {}, report)] : []));
  take.hidden = !drift.has_proposal;
  undo.hidden = !drift.can_undo;
  take.onclick = () => change(parts, () => post("api/drift/take", { number: drift.newest }), "drift.taken");
}

function describe(drift) {
  if (!drift.estimates && !drift.window_s) return t("drift.off");
  if (!drift.estimates) return t(drift.has_reference ? "drift.reference_only" : "drift.none_yet", { time: format_window(drift.window_s / 3600) });
  if (!drift.has_proposal) return t("drift.still");
  const with_sigma = (value, sigma, digits) => `${format_number(value, digits)} ± ${format_number(sigma, digits)}`;
  const values = { camera: drift.moved, litres: with_sigma(drift.change_litres, drift.change_sigma_litres, 0), percent: with_sigma(drift.change_percent, drift.change_sigma_percent, 2) };
  return t(drift.moved === "all" ? "drift.moved_all" : "drift.moved_one", values);
}

/** Return a running time in hours, or in minutes where it is less than one. */
const format_window = (hours) => (hours >= 1 ? `${format_number(hours, Number.isInteger(hours) ? 0 : 1)}\u00a0h` : `${format_number(60 * hours, 0)}\u00a0min`);

/** Show why it cannot be read or changed: the program's own line, which names the cause and the fix. */
function show_problem(problem, error) {
  let detail = "";
  try {
    detail = JSON.parse(error.message).detail ?? "";
  } catch {
    // no answer of the service
  }
  set_text(problem, error.status === 409 ? `${t("drift.refused")} ${detail}` : t("learn.failed"));
  problem.hidden = false;
}
