// What the cameras normally show: an engineer has it learned anew, after a confirmation.
import { post } from "./api.js";
import { $, create_element, set_text } from "./dom.js";
import { t } from "./texts.js";

/** Return the panel of the view of the checks. */
export function create_panel() {
  return create_element("section", { class: "panel zero" },
    create_element("header", {}, create_element("h2", { "data-text": "learn.title" }), create_element("button", { type: "button", class: "plain small", id: "learn-open", "data-text": "learn.open", on: { click: open } })),
    create_element("p", { class: "soft", "data-text": "learn.about" }));
}

function open() {
  const dialog = $("learn-dialog");
  if (dialog.open) return;
  const about = create_element("p", {}, t("learn.ask"));
  const problem = create_element("p", { class: "problem", role: "alert", hidden: true });
  const close = create_element("button", { type: "button", class: "plain", on: { click: () => dialog.close() } }, t("keep.cancel"));
  const next = create_element("button", { type: "button", class: "plain main", id: "learn-next", on: { click: () => learn({ about, problem, close, next }) } }, t("learn.confirm"));
  dialog.replaceChildren(create_element("h2", { id: "learn-title" }, t("learn.title")), about, problem, create_element("div", { class: "row" }, close, next));
  dialog.showModal();
}

async function learn({ about, problem, close, next }) {
  next.disabled = true;
  problem.hidden = true;
  try {
    await post("api/images/learn");
    set_text(about, t("learn.done"));
    next.hidden = true;
    set_text(close, t("keys.close"));
  } catch (error) {
    set_text(problem, t(error.status === 409 ? "learn.off" : "learn.failed"));
    problem.hidden = false;
  }
  next.disabled = false;
}
