// Shared code of the access pages: texts, theme, requests, forms.
import { $, create_element, create_icon } from "../page/script/dom.js";
import { apply_texts, get_language, list_languages, load_texts, set_language, t } from "../page/script/texts.js";
import { theme } from "../page/script/theme.js";

export const MIN_LENGTH = 10;

/** Load the texts and set up the language menu and the theme button. */
export async function set_up_page(changed = () => {}) {
  await load_texts(navigator.language.slice(0, 2));
  const menu = $("language");
  menu.append(...list_languages().map(({ code, name }) => create_element("option", { value: code }, name)));
  menu.value = get_language();
  menu.addEventListener("change", () => { set_language(menu.value); hide_messages(); changed(); });
  const button = $("theme");
  const show = () => button.replaceChildren(create_icon(theme.choice));
  button.addEventListener("click", () => { theme.next(); show(); });
  show();
  apply_texts(document);
}

/** Hide earlier messages. */
export function hide_messages() {
  for (const line of document.querySelectorAll(".problem, .done")) line.hidden = true;
}

let is_leaving = false;

/** Run an action that ends the session, then open another page; requests refused meanwhile show no message. */
export async function leave(location_after, action) {
  is_leaving = true;
  await action().catch(() => {});
  location.replace(location_after);
}

/** Send a request; return its response, or throw an error with a message in the user's language. */
export async function request(method, path, body) {
  let answer;
  try {
    const headers = { accept: "application/json" };
    if (method !== "GET") {
      const { token } = await request("GET", "api/access/state");
      if (token) headers["x-beltscape-token"] = token;
      if (body !== undefined) headers["content-type"] = "application/json";
    }
    answer = await fetch(path, { method, headers, body: body === undefined ? undefined : JSON.stringify(body) });
  } catch (error) {
    throw error.status === undefined ? new Error(t("access.unreachable")) : error;
  }
  const content = await answer.json().catch(() => ({}));
  if (answer.ok) return content;
  if (answer.status === 401 && !/\/(login|password)$/.test(path)) {
    if (!is_leaving) location.replace(`login?next=${location.pathname.split("/").pop()}`);
    return new Promise(() => {}); // the page is being left
  }
  const error = new Error(describe_error(answer, content.detail));
  error.status = answer.status;
  throw error;
}

function describe_error(answer, detail) {
  if (answer.status === 429) return t("access.wait", { seconds: answer.headers.get("retry-after") ?? "2" });
  if (answer.status === 401) return t("access.wrong");
  if (answer.status === 422) return t("access.unfit");
  return t("access.refused", { reason: typeof detail === "string" ? detail : answer.status });
}

/** Return what is wrong with a new password, in the user's language, or null. */
export function check_password(password, again, name = "") {
  if (password !== again) return t("access.differ");
  const inside = name.length > 2 && password.toLowerCase().includes(name.toLowerCase());
  return password.length < MIN_LENGTH || new Set(password).size < 5 || inside ? t("access.password_help") : null;
}

/** Submit a form by `send(values)`; errors are shown in the form. */
export function bind_form(element, send) {
  const problem = element.querySelector(".problem");
  const done = element.querySelector(".done");
  // before this script runs, the browser itself would submit the form
  for (const button of element.querySelectorAll("button.primary")) button.disabled = false;
  element.addEventListener("submit", async (event) => {
    event.preventDefault();
    const button = event.submitter ?? element.querySelector("button:not([type])");
    hide_messages();
    const empty = [...element.elements].filter((field) => field.required && !field.value);
    for (const field of element.elements) field.removeAttribute("aria-invalid");
    if (empty.length) {
      for (const field of empty) field.setAttribute("aria-invalid", "true");
      empty[0].focus();
      return;
    }
    button.disabled = true;
    try {
      const message = await send(Object.fromEntries(new FormData(element)));
      if (message && done) { done.textContent = message; done.hidden = false; }
    } catch (error) {
      problem.textContent = error.message;
      problem.hidden = false;
    } finally {
      button.disabled = false;
    }
  });
}

/** Return the page to open after login; it is always one of this service, also below a proxy's path. */
export function get_next_page() {
  const root = new URL("./", document.baseURI).href;
  const requested = (new URLSearchParams(location.search).get("next") ?? "").replace(/^\//, "");
  const url = new URL(requested, root).href;
  return !/^[/\\]/.test(requested) && url.startsWith(root) && !url.startsWith(`${root}login`) ? url : root;
}
