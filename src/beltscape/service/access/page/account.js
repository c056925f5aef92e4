// One's own password; for engineers the users and the audit log.
import { $, make } from "/page/script/dom.js";
import { day_and_time, has, t } from "/page/script/texts.js";
import { ask, form, furnish, hush, leave, weak } from "/access/door.js";

const ROLES = ["viewer", "operator", "engineer"];
let me = null;
let asked = null;  // whom the dialog is about

function roles(select, chosen) {
  select.replaceChildren(...ROLES.map((role) => make("option", { value: role, selected: role === chosen }, t(`role.${role}`))));
}

async function show() {
  const state = await ask("GET", "/api/access/state");
  if (!state.named) { location.replace("/login?next=/account"); return; }
  me = state.user;
  $("you").replaceChildren(me.name, make("small", {}, t(`role.${me.role}`)));
  $("own").elements.name.value = me.name;
  const engineer = me.role === "engineer";
  $("users-panel").hidden = $("log-panel").hidden = !engineer;
  if (!engineer) return;
  roles($("add").elements.role, $("add").elements.role.value || "viewer");
  const [users, log] = await Promise.all([ask("GET", "/api/access/users"), ask("GET", "/api/access/audit?most=100")]);
  $("users").replaceChildren(...users.map(user_row));
  $("log").replaceChildren(...log.map(log_row));
}

function user_row(user) {
  const role = make("select", { "aria-label": t("access.role"), on: { change: () => attempt(() => ask("PATCH", place(user), { role: role.value })) } });
  roles(role, user.role);
  const button = (text, click) => make("button", { type: "button", class: "plain", on: { click } }, t(text));
  return make("tr", {},
    make("td", { class: "who" }, user.name),
    make("td", {}, role),
    make("td", { class: "when" }, day_and_time(user.changed_s * 1000)),
    make("td", { class: "number" }, String(user.sessions)),
    make("td", { class: "acts" },
      button("access.set_password", () => question(t("access.set_password_for", { user: user.name }), t("access.change"), user, true)),
      button("access.remove", () => question(t("access.remove_sure", { user: user.name }), t("access.remove"), user, false))));
}

const place = (user) => `/api/access/users/${encodeURIComponent(user.name)}`;

function log_row(entry) {
  const { at, what, who, from, ...more } = entry;
  const detail = Object.entries(more).map(([key, value]) => (key === "request" || key === "query" ? value : `${key} ${value}`)).join(" · ");
  return make("tr", {},
    make("td", { class: "when" }, day_and_time(Date.parse(at), true)),
    make("td", { class: "who" }, who),
    make("td", { class: what.endsWith("failed") ? "failed" : null }, has(`access.log.${what}`) ? t(`access.log.${what}`) : what),
    make("td", {}, from),
    make("td", { class: "detail" }, detail));
}

async function attempt(work) {
  const problem = $("users-problem");
  hush();
  try {
    await work();
  } catch (error) {
    problem.textContent = error.message;
    problem.hidden = false;
  }
  await show();
}

/** Ask once more before a user is removed, or for his new password. */
function question(title, yes, user, password) {
  const dialog = $("ask");
  const element = dialog.querySelector("form");
  element.reset();
  element.querySelector(".problem").hidden = true;
  $("ask-title").textContent = title;
  $("ask-password").hidden = $("ask-rules").hidden = !password;
  element.elements.password.required = password;
  $("ask-yes").textContent = yes;
  $("ask-yes").classList.toggle("danger", !password);
  asked = { user, password };
  dialog.showModal();
}

await furnish(show);
await show();

form($("own"), async (values) => {
  const problem = weak(values.new, values.again, me.name);
  if (problem) throw new Error(problem);
  await ask("POST", "/api/access/password", { old: values.old, new: values.new });
  for (const name of ["old", "new", "again"]) $("own").elements[name].value = "";
  await show();
  return t("access.changed");
});

form($("add"), async ({ name, role, password }) => {
  const problem = weak(password, password, name);
  if (problem) throw new Error(problem);
  await ask("POST", "/api/access/users", { name, role, password });
  $("add").reset();
  await show();
});

form($("ask").querySelector("form"), async ({ password }) => {
  if (asked.password) {
    const problem = weak(password, password, asked.user.name);
    if (problem) throw new Error(problem);
    await ask("PATCH", place(asked.user), { password });
  } else {
    await ask("DELETE", place(asked.user));
  }
  $("ask").close();
  await show();
});

$("ask-no").addEventListener("click", () => $("ask").close());
$("leave").addEventListener("click", () => leave("/login", () => ask("POST", "/api/access/logout")));
