// Keeping the raw frames of the last minutes: asks why, says whether it was done.
import { post } from "./api.js";
import { $, make, say } from "./dom.js";
import { store } from "./store.js";
import { t } from "./texts.js";

const allowed = () => store.page !== null && store.page.role !== "viewer";

export function open() {
  const dialog = $("keep-dialog");
  if (!allowed() || dialog.open) return;
  const reason = make("input", { id: "keep-reason", maxlength: 200, required: true, autocomplete: "off" });
  const problem = make("p", { class: "problem", role: "alert", hidden: true });
  const form = make("form", {}, make("h2", { id: "keep-title" }, t("keep.title")), make("p", {}, t("keep.help")), make("label", { for: "keep-reason" }, t("keep.reason")), reason, problem,
    make("div", { class: "row" }, make("button", { type: "button", class: "plain", on: { click: () => dialog.close() } }, t("keep.cancel")), make("button", { class: "plain main" }, t("keep.do"))));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const failed = await keep(reason.value.trim());
    problem.hidden = !failed;
    if (failed) say(problem, t(failed));
    else dialog.close();
  });
  dialog.replaceChildren(form);
  dialog.showModal();
}

/** Key of what went wrong; null: it is kept. */
async function keep(reason) {
  try {
    await post("/api/recording/keep", { reason });
  } catch (error) {
    return error.status === 409 ? "keep.nothing" : "keep.failed";
  }
  say($("keep"), t("keep.done"));
  setTimeout(() => say($("keep"), t("keep.title")), 4000);
  return null;
}

export function start() {
  $("keep").addEventListener("click", open);
  const show = () => { $("keep").hidden = !allowed(); };
  store.on("page", show);
  show();
}
