// What the pages of access share: words, theme, requests, forms.
import { $, make, sign } from "/page/script/dom.js";
import { apply, choose, chosen, languages, load, t } from "/page/script/texts.js";
import { theme } from "/page/script/theme.js";

export const LEAST = 10;

/** Words in the reader's language, the menu of languages, the button of themes. */
export async function furnish(changed = () => {}) {
  await load(navigator.language.slice(0, 2));
  const menu = $("language");
  menu.append(...languages().map((name) => make("option", { value: name }, t(`language.${name}`))));
  menu.value = chosen();
  menu.addEventListener("change", () => { choose(menu.value); hush(); changed(); });
  const button = $("theme");
  const show = () => button.replaceChildren(sign(theme.wish));
  button.addEventListener("click", () => { theme.next(); show(); });
  show();
  apply(document);
}

/** Hide what was said in another language, or before. */
export function hush() {
  for (const line of document.querySelectorAll(".problem, .done")) line.hidden = true;
}

let leaving = false;

/** Do something that ends the session, then go to another page: requests that are refused meanwhile say nothing. */
export async function leave(place, act) {
  leaving = true;
  await act().catch(() => {});
  location.replace(place);
}

/** Ask the server: its answer, or an error with a line in the reader's language. */
export async function ask(method, path, body) {
  let answer;
  try {
    const headers = { accept: "application/json" };
    if (method !== "GET") {
      const { token } = await ask("GET", "/api/access/state");
      if (token) headers["x-beltscape-token"] = token;
      if (body !== undefined) headers["content-type"] = "application/json";
    }
    answer = await fetch(path, { method, headers, body: body === undefined ? undefined : JSON.stringify(body) });
  } catch (error) {
    throw error.status === undefined ? new Error(t("access.unreachable")) : error;
  }
  const found = await answer.json().catch(() => ({}));
  if (answer.ok) return found;
  if (answer.status === 401 && !/\/(login|password)$/.test(path)) {
    if (!leaving) location.replace(`/login?next=${location.pathname}`);
    return new Promise(() => {}); // the page is on its way out
  }
  const error = new Error(words(answer, found.detail));
  error.status = answer.status;
  throw error;
}

function words(answer, detail) {
  if (answer.status === 429) return t("access.wait", { seconds: answer.headers.get("retry-after") ?? "2" });
  if (answer.status === 401) return t("access.wrong");
  if (answer.status === 422) return t("access.unfit");
  return t("access.refused", { reason: typeof detail === "string" ? detail : answer.status });
}

/** What is wrong with a new password, in the reader's language; null: nothing the page can see. */
export function weak(password, again, name = "") {
  if (password !== again) return t("access.differ");
  const inside = name.length > 2 && password.toLowerCase().includes(name.toLowerCase());
  return password.length < LEAST || new Set(password).size < 5 || inside ? t("access.password_help") : null;
}

/** Let a form call `send(values)`; what that throws is shown in it. */
export function form(element, send) {
  const problem = element.querySelector(".problem");
  const done = element.querySelector(".done");
  // until now the browser itself would have sent the form
  for (const button of element.querySelectorAll("button.primary")) button.disabled = false;
  element.addEventListener("submit", async (event) => {
    event.preventDefault();
    const button = event.submitter ?? element.querySelector("button:not([type])");
    hush();
    const empty = [...element.elements].filter((field) => field.required && !field.value);
    for (const field of element.elements) field.removeAttribute("aria-invalid");
    if (empty.length) {
      for (const field of empty) field.setAttribute("aria-invalid", "true");
      empty[0].focus();
      return;
    }
    button.disabled = true;
    try {
      const said = await send(Object.fromEntries(new FormData(element)));
      if (said && done) { done.textContent = said; done.hidden = false; }
    } catch (error) {
      problem.textContent = error.message;
      problem.hidden = false;
    } finally {
      button.disabled = false;
    }
  });
}

/** Where to go after signing in: a place of this server, never another one. */
export function next() {
  const wish = new URLSearchParams(location.search).get("next") ?? "/";
  const place = new URL(wish, location.origin);
  return place.origin === location.origin && !place.pathname.startsWith("/login") ? place.pathname + place.search + place.hash : "/";
}
