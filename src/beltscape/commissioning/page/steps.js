// The list of the steps, and the chosen one: what it is about, its form, actions, result and commands.
import { post } from "../page/script/api.js";
import { $, create_element, create_icon, set_text, sync_children } from "../page/script/dom.js";
import { store } from "../page/script/store.js";
import { format_significant, t } from "../page/script/texts.js";
import { create_form, read_form } from "./forms.js";
import { format_facts } from "./facts.js";
import { render_optics, stop_optics } from "./optics.js";
import { create_program_line, hide_problem, show_failure, show_problem, show_refusal } from "./problems.js";
import { render_views } from "./views.js";

const ICONS = { done: "good", open: "waiting", blocked: "unknown", outdated: "unusable", failed: "unusable", running: "rising" };
const SECOND_PRESS_MS = 1000;
let offered_ms = -SECOND_PRESS_MS; // when a button took the place of the one that was pressed
let chosen = location.hash.slice(1);
let shown = ""; // step and settings that the form was made for

const get_status = (step) => (step.failure && step.status !== "running" && step.status !== "done" ? "failed" : step.status);

export function choose_step(name) {
  if (!name || name === chosen) return;
  if (chosen === "images") leave_pictures();
  chosen = name;
  history.replaceState(null, "", `#${name}`);
  if (store.state) render_steps(store.state, true);
  $("step-title").focus();
}

function leave_pictures() {
  stop_optics();
  if (store.state?.live.is_open && !store.state.views) act("api/commission/live", { is_open: false });
}

/** Send a change and show the answer, or why it was refused. */
export async function act(path, body = {}) {
  try {
    hide_problem();
    store.emit("answer", await post(path, body));
    return true;
  } catch (error) {
    show_refusal(path, error);
    return false;
  }
}

export function render_steps(state, is_new = false) {
  const names = state.steps.map((step) => step.name);
  if (!names.includes(chosen)) chosen = state.running || state.next;
  sync_children($("steps"), state.steps, (step) => step.name,
    (step) => create_element("li", {}, create_element("button", { type: "button", on: { click: () => choose_step(step.name) } })),
    (item, step) => show_item(item, step, names.indexOf(step.name)));
  set_text($("folder"), state.folder);
  const step = state.steps.find((one) => one.name === chosen);
  const made_for = `${step.name} ${JSON.stringify(state.settings)}`;
  if (is_new || shown.split(" ")[0] !== step.name) { shown = made_for; show_form(step, state); }
  show_step(step, state);
}

function show_item(item, step, number) {
  const status = get_status(step);
  const button = item.firstChild;
  const key = `${status} ${t(`commission.step.${step.name}`)}`;
  if (item.dataset.shown !== key) {
    item.dataset.shown = key;
    item.dataset.status = status;
    button.replaceChildren(create_icon(ICONS[status]), create_element("span", {}, `${number + 1}. ${t(`commission.step.${step.name}`)}`), create_element("span", { class: "note" }, t(`commission.status.${status}`)));
  }
  if (step.name !== chosen) button.removeAttribute("aria-current");
  else if (!button.hasAttribute("aria-current")) {
    button.setAttribute("aria-current", "step");
    requestAnimationFrame(() => item.parentElement.scrollTo({ left: item.offsetLeft - 60 })); // on a phone they stand in a row
  }
}

function show_form(step, state) {
  set_text($("step-title"), t(`commission.step.${step.name}`));
  set_text($("step-about"), t(`commission.about.${step.name}`));
  $("step-body").replaceChildren(create_form(step.name, state), create_element("div", { id: "step-live" }));
  hide_problem();
  $("step-actions").replaceChildren();
  if (step.name === "images" && state.steps[0].status === "done" && !state.running) act("api/commission/live", { is_open: true });
}

function show_step(step, state) {
  const status = get_status(step);
  $("step-state").dataset.status = status;
  set_text($("step-state"), t(`commission.status.${status}`));
  if (step.failure) show_failure(step);
  show_actions(step, state);
  $("step-warnings-about").hidden = !step.warnings.length;
  sync_children($("step-warnings"), step.warnings, (line) => line, (line) => create_element("li", { lang: "en" }, line), () => {});
  sync_children($("step-progress"), step.status === "running" ? state.progress : [], (line) => line, (line) => create_element("li", { lang: "en" }, line), () => {});
  const facts = step.result && step.status !== "running" ? format_facts(step) : [];
  sync_children($("step-facts"), facts, ([name, value]) => `${name} ${value}`, ([name, value]) => create_element("div", {}, create_element("dt", {}, name), create_element("dd", {}, value)), () => {});
  sync_children($("step-files"), step.files, (file) => file, (file) => create_element("li", {}, create_element("a", { class: "plain", href: `api/commission/files/${file}`, target: "_blank", rel: "noopener", title: file }, name_file(file))), () => {});
  set_text($("step-commands"), [...step.commands, `beltscape commission ${quote(state.folder)} --step ${step.name}`].join("\n"));
  show_faults(step, state);
  if (step.name === "material") set_text($("turns"), state.turns === null ? "" : t("commission.turns", { turns: format_significant(state.turns), needed: state.settings.zero.revolutions }));
  if (step.name === "images") render_optics($("step-live"), state);
  if (step.name === "calibrate") render_views($("step-live"), state);
}

/** Name the cameras that are not well while their pictures are shown. */
function show_faults(step, { live }) {
  const faults = ["images", "calibrate"].includes(step.name) ? live.faults : [];
  sync_children($("live-faults"), faults, ({ camera, text }) => `${camera} ${text}`, ({ camera, key, values, text }) => create_element("li", {}, `${camera}: `, key ? t(`cause.${key}`, values) : create_program_line(text)), () => {});
}

/** Return what a result file is called: by its place, as the steps write it. */
function name_file(file) {
  const [folder] = file.split("/");
  if (folder.startsWith("flow_")) return t("commission.file.flow", { name: folder.slice(5) });
  if (file.startsWith("data/certificates/")) return t("commission.file.certificate", { name: file.split("/").at(-1).replace(/\.html$/, "") });
  return t(`commission.file.${{ "board/board.pdf": "board", "rig/coverage.png": "coverage", "belt.html": "belt" }[file] ?? "report"}`);
}

const quote = (text) => (/^[\w./-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);

function show_actions(step, state) {
  const is_running = step.status === "running";
  const is_busy = Boolean(state.running);
  const buttons = [];
  if (is_running) buttons.push(["cancel", t("commission.cancel"), cancel, false, false]);
  else {
    const text = step.status === "done" ? t("commission.again") : t(`commission.do.${step.name}`);
    buttons.push(["run", text, () => run_step(step.name), step.status === "blocked" || is_busy, step.status !== "done"]);
    const next = state.steps[state.steps.findIndex((one) => one.name === step.name) + 1];
    if (step.status === "done" && next) buttons.push(["next", t("commission.next", { step: t(`commission.step.${next.name}`) }), () => choose_step(next.name), false, true]);
  }
  const had_focus = $("step-actions").contains(document.activeElement);
  sync_children($("step-actions"), buttons, ([key]) => key,
    ([key]) => create_element("button", { type: "button", id: `do-${key}` }),
    (button, [, text, action, is_off, is_main]) => { set_text(button, text); button.disabled = is_off; button.className = is_main ? "plain main" : "plain"; button.onclick = action; });
  if (had_focus && !$("step-actions").contains(document.activeElement)) {
    // the button that was pressed has given way to another one, where the keyboard goes on
    ($("do-next") ?? $("step-actions").lastChild)?.focus();
    offered_ms = performance.now();
  }
  if (step.status === "blocked" && step.missing) show_problem(t("commission.first", { step: t(`commission.step.${step.missing}`) }));
}

/** End the step that runs; a second press of the key that began it, on the button that took its place, does not. */
function cancel() {
  if (performance.now() - offered_ms > SECOND_PRESS_MS) act("api/commission/cancel");
}

async function run_step(name) {
  const changes = read_form(name, store.state);
  if (Object.keys(changes).length && !(await act("api/commission/settings", { changes }))) return;
  await act(`api/commission/run/${name}`);
}
