// The dialog that keeps the recorded frames of the last minutes, with a reason.
import { post } from "./api.js";
import { $, create_element, set_text } from "./dom.js";
import { store } from "./store.js";
import { t } from "./texts.js";

const is_allowed = () => store.page !== null && store.page.role !== "viewer";

export function open() {
  const dialog = $("keep-dialog");
  if (!is_allowed() || dialog.open) return;
  const reason = create_element("input", { id: "keep-reason", maxlength: 200, required: true, autocomplete: "off" });
  const problem = create_element("p", { class: "problem", role: "alert", hidden: true });
  const form = create_element("form", {}, create_element("h2", { id: "keep-title" }, t("keep.title")), create_element("p", {}, t("keep.help")), create_element("label", { for: "keep-reason" }, t("keep.reason")), reason, problem,
    create_element("div", { class: "row" }, create_element("button", { type: "button", class: "plain", on: { click: () => dialog.close() } }, t("keep.cancel")), create_element("button", { class: "plain main" }, t("keep.do"))));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const error_key = await keep_recording(reason.value.trim());
    problem.hidden = !error_key;
    if (error_key) set_text(problem, t(error_key));
    else dialog.close();
  });
  dialog.replaceChildren(form);
  dialog.showModal();
}

/** Keep the recording; return the text key of what failed, or null. */
async function keep_recording(reason) {
  try {
    await post("api/recording/keep", { reason });
  } catch (error) {
    return error.status === 409 ? "keep.nothing" : "keep.failed";
  }
  set_text($("keep"), t("keep.done"));
  setTimeout(() => set_text($("keep"), t("keep.title")), 4000);
  return null;
}

export function start() {
  $("keep").addEventListener("click", open);
  const show = () => { $("keep").hidden = !is_allowed(); };
  store.on("page", show);
  show();
}
