// What people do to an alarm: acknowledge, reset, shelve for a time, take out of service, show again.
import { format_title } from "./alarm_texts.js";
import { post } from "./api.js";
import { $, create_element, set_text } from "./dom.js";
import { store } from "./store.js";
import { format_duration, t } from "./texts.js";

const MINUTES = [5, 15, 30, 60, 120, 240, 480, 1440, 10080];
export const may_operate = () => store.page !== null && store.page.role !== "viewer";
export const may_engineer = () => store.page?.role === "engineer";
const get_path = (name, action) => `api/alarms/${encodeURIComponent(name)}/${action}`;

/** Do something to an alarm; the reason of a refusal is shown. */
export async function act(name, action, body) {
  const problem = $("alarms-problem");
  problem.hidden = true;
  try {
    await post(get_path(name, action), body);
    return true;
  } catch (error) {
    if (error.status === 409 && action === "acknowledge") return false; // another user was faster; the next state shows it
    set_text(problem, describe(error, action));
    problem.hidden = false;
    return false;
  }
}

function describe(error, action) {
  if (error.status === 401 || error.status === 403) return t("alarms.role");
  if (action === "acknowledge") return t("alarms.failed");
  return t("alarms.refused", { reason: read_reason(error) });
}

function read_reason(error) {
  try {
    const { detail } = JSON.parse(error.message);
    return typeof detail === "string" ? detail : "";
  } catch {
    return "";
  }
}

/** Ask for a reason, and for shelving also for the time; `action` is "shelve" or "out_of_service". */
export function open_dialog(name, action) {
  const dialog = $("alarm-dialog");
  const is_shelving = action === "shelve";
  const reason = create_element("input", { id: "alarm-reason", maxlength: 200, required: true, pattern: ".*\\S.*", autocomplete: "off" });
  const longest = store.page.shelving_max_min;
  const minutes = create_element("select", { id: "alarm-minutes" }, ...MINUTES.filter((each) => each <= longest).map((each) => create_element("option", { value: each, selected: each === 30 }, format_duration(each * 60))));
  const problem = create_element("p", { class: "problem", role: "alert", hidden: true });
  const title = t(is_shelving ? "alarms.shelve_one" : "alarms.service_one", { alarm: format_title(name) });
  const form = create_element("form", {}, create_element("h2", { id: "alarm-dialog-title" }, title), create_element("p", {}, t(is_shelving ? "alarms.shelve_help" : "alarms.service_help")),
    create_element("label", { for: "alarm-reason" }, t("keep.reason")), reason, ...(is_shelving ? [create_element("label", { for: "alarm-minutes" }, t("alarms.shelve_time")), minutes] : []), problem,
    create_element("div", { class: "row" }, create_element("button", { type: "button", class: "plain", on: { click: () => dialog.close() } }, t("keep.cancel")), create_element("button", { class: "plain main" }, t(is_shelving ? "alarms.shelve_do" : "alarms.service_do"))));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const body = { reason: reason.value.trim(), ...(is_shelving ? { minutes: Number(minutes.value) } : {}) };
    try {
      await post(get_path(name, action), body);
      dialog.close();
    } catch (error) {
      set_text(problem, describe(error, action));
      problem.hidden = false;
    }
  });
  dialog.replaceChildren(form);
  dialog.showModal();
}
