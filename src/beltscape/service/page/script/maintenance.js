// Maintenance: an operator begins it with a reason and a time and ends it; while it lasts, a banner shows it.
import { post } from "./api.js";
import { $, create_element, set_text } from "./dom.js";
import { store } from "./store.js";
import { format_duration, format_moment, t } from "./texts.js";

const MINUTES = [5, 15, 30, 60, 120, 480];
const is_allowed = () => store.page !== null && store.page.role !== "viewer";

export function open() {
  const dialog = $("maintenance-dialog");
  if (!is_allowed() || dialog.open) return;
  const reason = create_element("input", { id: "maintenance-reason", maxlength: 200, required: true, autocomplete: "off", value: t("maintenance.cleaning") });
  const minutes = create_element("select", { id: "maintenance-minutes" }, ...MINUTES.map((each) => create_element("option", { value: each, selected: each === 30 }, format_duration(each * 60))));
  const problem = create_element("p", { class: "problem", role: "alert", hidden: true });
  const form = create_element("form", {}, create_element("h2", { id: "maintenance-title" }, t("maintenance.title")), create_element("p", {}, t("maintenance.help")),
    create_element("label", { for: "maintenance-reason" }, t("keep.reason")), reason, create_element("label", { for: "maintenance-minutes" }, t("maintenance.at_most")), minutes, problem,
    create_element("div", { class: "row" }, create_element("button", { type: "button", class: "plain", on: { click: () => dialog.close() } }, t("keep.cancel")), create_element("button", { class: "plain main" }, t("maintenance.begin"))));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    try {
      await post("api/maintenance/begin", { reason: reason.value.trim(), minutes: Number(minutes.value) });
      dialog.close();
    } catch {
      problem.hidden = false;
      set_text(problem, t("maintenance.failed"));
    }
  });
  dialog.replaceChildren(form);
  dialog.showModal();
}

async function end() {
  try {
    await post("api/maintenance/end");
  } catch (error) {
    if (error.status !== 409) set_text($("maintenance-text"), t("maintenance.failed"));
  }
}

function render() {
  const present = store.state?.maintenance ?? null;
  $("maintenance").hidden = !present;
  document.body.toggleAttribute("data-maintenance", Boolean(present));
  $("maintenance-begin").hidden = !is_allowed() || Boolean(present);
  $("maintenance-end").hidden = !is_allowed();
  if (present) set_text($("maintenance-text"), t("maintenance.now", { reason: present.reason, by: present.by, since: format_moment(present.since_ms), until: format_moment(present.until_ms) }));
}

export function start() {
  $("maintenance-begin").addEventListener("click", open);
  $("maintenance-end").addEventListener("click", end);
  for (const subject of ["state", "texts", "page"]) store.on(subject, render);
  render();
}
