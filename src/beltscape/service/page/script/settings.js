// The settings of project.toml: an engineer sees what differs from the running plant, and has it taken over.
import { get, post } from "./api.js";
import { $, create_element, set_text } from "./dom.js";
import { t } from "./texts.js";

/** Return the panel of the view of the checks. */
export function create_panel() {
  return create_element("section", { class: "panel zero" },
    create_element("header", {}, create_element("h2", { "data-text": "settings.title" }), create_element("button", { type: "button", class: "plain small", id: "settings-open", "data-text": "settings.open", on: { click: open } })),
    create_element("p", { class: "soft", "data-text": "settings.about" }));
}

function open() {
  const dialog = $("settings-dialog");
  if (dialog.open) return;
  const found = create_element("div", { id: "settings-found" });
  const problem = create_element("p", { class: "problem", role: "alert", hidden: true });
  const close = create_element("button", { type: "button", class: "plain", on: { click: () => dialog.close() } }, t("keys.close"));
  const next = create_element("button", { type: "button", class: "plain main", id: "settings-next", hidden: true, on: { click: () => apply({ found, problem, next }) } }, t("settings.confirm"));
  dialog.replaceChildren(create_element("h2", { id: "settings-title" }, t("settings.title")), found, problem, create_element("div", { class: "row" }, close, next));
  dialog.showModal();
  find({ found, problem, next });
}

async function find({ found, problem, next }) {
  try {
    const changes = await get("api/settings/changes");
    show(found, changes, "settings.now");
    next.hidden = !changes.at_once.length;
  } catch (error) {
    show_problem(problem, error);
  }
}

async function apply({ found, problem, next }) {
  next.disabled = true;
  problem.hidden = true;
  try {
    show(found, await post("api/settings/reload"), "settings.done");
    next.hidden = true;
  } catch (error) {
    show_problem(problem, error);
  }
  next.disabled = false;
}

function show(found, { at_once, restart }, heading) {
  const list = (key, changes) => (changes.length ? [create_element("h3", {}, t(key)), create_element("ul", {}, ...changes.map(describe))] : []);
  const parts = [...list(heading, at_once), ...list("settings.restart", restart)];
  found.replaceChildren(...(parts.length ? parts : [create_element("p", {}, t("settings.none"))]));
}

const describe = ({ key, before, after }) => create_element("li", {}, create_element("code", {}, key), ` ${before || "–"} → ${after || "–"}`);

/** Show why project.toml cannot be taken over: the program's own line, which names the key and the fix. */
function show_problem(problem, error) {
  let detail = "";
  try {
    detail = JSON.parse(error.message).detail ?? "";
  } catch {
    // no answer of the service
  }
  set_text(problem, error.status === 409 ? `${t("settings.refused")} ${detail}` : t("learn.failed"));
  problem.hidden = false;
}
