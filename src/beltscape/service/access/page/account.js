// The account page: own password; for engineers also users and audit log.
import { $, create_element } from "../page/script/dom.js";
import { format_date_time, has_text, t } from "../page/script/texts.js";
import { bind_form, check_password, hide_messages, leave, request, set_up_page } from "./common.js";

const ROLES = ["viewer", "operator", "engineer"];
let own_user = null;
let subject = null;  // user and action of the open dialog

function fill_roles(select, selected_role) {
  select.replaceChildren(...ROLES.map((role) => create_element("option", { value: role, selected: role === selected_role }, t(`role.${role}`))));
}

async function show() {
  const state = await request("GET", "api/access/state");
  if (!state.named) { location.replace("login?next=account"); return; }
  own_user = state.user;
  $("you").replaceChildren(own_user.name, create_element("small", {}, t(`role.${own_user.role}`)));
  $("own").elements.name.value = own_user.name;
  const engineer = own_user.role === "engineer";
  $("users-panel").hidden = $("log-panel").hidden = !engineer;
  if (!engineer) return;
  fill_roles($("add").elements.role, $("add").elements.role.value || "viewer");
  const [users, log] = await Promise.all([request("GET", "api/access/users"), request("GET", "api/access/audit?most=100")]);
  $("users").replaceChildren(...users.map(user_row));
  $("log").replaceChildren(...log.map(log_row));
}

function user_row(user) {
  const role = create_element("select", { "aria-label": t("access.role"), on: { change: () => run_action(() => request("PATCH", user_path(user), { role: role.value })) } });
  fill_roles(role, user.role);
  const button = (text, click) => create_element("button", { type: "button", class: "plain", on: { click } }, t(text));
  return create_element("tr", {},
    create_element("td", { class: "who" }, user.name),
    create_element("td", {}, role),
    create_element("td", { class: "when" }, format_date_time(user.changed_s * 1000)),
    create_element("td", { class: "number" }, String(user.sessions)),
    create_element("td", { class: "acts" },
      button("access.set_password", () => open_dialog(t("access.set_password_for", { user: user.name }), t("access.change"), user, true)),
      button("access.remove", () => open_dialog(t("access.remove_sure", { user: user.name }), t("access.remove"), user, false))));
}

const user_path = (user) => `api/access/users/${encodeURIComponent(user.name)}`;

function log_row(entry) {
  const { at, what, who, from, ...more } = entry;
  const detail = Object.entries(more).map(([key, value]) => (key === "request" || key === "query" ? value : `${key} ${value}`)).join(" · ");
  return create_element("tr", {},
    create_element("td", { class: "when" }, format_date_time(Date.parse(at), true)),
    create_element("td", { class: "who" }, who),
    create_element("td", { class: what.endsWith("failed") ? "failed" : null }, has_text(`access.log.${what}`) ? t(`access.log.${what}`) : what),
    create_element("td", {}, from),
    create_element("td", { class: "detail" }, detail));
}

async function run_action(work) {
  const problem = $("users-problem");
  hide_messages();
  try {
    await work();
  } catch (error) {
    problem.textContent = error.message;
    problem.hidden = false;
  }
  await show();
}

/** Open the dialog that confirms a removal or asks for a new password. */
function open_dialog(title, yes, user, password) {
  const dialog = $("ask");
  const element = dialog.querySelector("form");
  element.reset();
  element.querySelector(".problem").hidden = true;
  $("ask-title").textContent = title;
  $("ask-password").hidden = $("ask-rules").hidden = !password;
  element.elements.password.required = password;
  $("ask-yes").textContent = yes;
  $("ask-yes").classList.toggle("danger", !password);
  subject = { user, password };
  dialog.showModal();
}

await set_up_page(show);
await show();

bind_form($("own"), async (values) => {
  const problem = check_password(values.new, values.again, own_user.name);
  if (problem) throw new Error(problem);
  await request("POST", "api/access/password", { old: values.old, new: values.new });
  for (const name of ["old", "new", "again"]) $("own").elements[name].value = "";
  await show();
  return t("access.changed");
});

bind_form($("add"), async ({ name, role, password }) => {
  const problem = check_password(password, password, name);
  if (problem) throw new Error(problem);
  await request("POST", "api/access/users", { name, role, password });
  $("add").reset();
  await show();
});

bind_form($("ask").querySelector("form"), async ({ password }) => {
  if (subject.password) {
    const problem = check_password(password, password, subject.user.name);
    if (problem) throw new Error(problem);
    await request("PATCH", user_path(subject.user), { password });
  } else {
    await request("DELETE", user_path(subject.user));
  }
  $("ask").close();
  await show();
});

$("ask-no").addEventListener("click", () => $("ask").close());
$("leave").addEventListener("click", () => leave("login", () => request("POST", "api/access/logout")));
