// The page of a commissioning: reads /api/commission every second and shows the steps and the chosen one.
import { get, post } from "../page/script/api.js";
import { $, create_element, create_icon, set_text } from "../page/script/dom.js";
import { store } from "../page/script/store.js";
import { apply_texts, get_language, list_languages, load_texts, set_language, t } from "../page/script/texts.js";
import { theme } from "../page/script/theme.js";
import { choose_step, render_steps } from "./steps.js";

const PERIOD_MS = 1000;
const BUSY_MS = 400; // while views are taken
let received_ms = 0;
let timer = 0;

async function load_page_settings() {
  try {
    store.page = await get("api/page");
  } catch (error) {
    if (error.status === 401) location.href = "login";
  }
  store.emit("page");
}

async function sign_out() {
  await post("api/access/logout").catch(() => {});
  location.href = "login";
}

function show_page() {
  document.title = `${t("commission.title")} – Beltscape`;
  set_text($("plant"), t("commission.title"));
  const user = store.page?.user;
  $("who").replaceChildren(...(user ? [create_element("a", { href: "account" }, user), create_element("button", { type: "button", on: { click: sign_out } }, t("tools.sign_out"))] : []));
}

function show_theme() {
  $("theme").replaceChildren(create_icon(theme.choice));
  $("theme").title = `${t("tools.theme")}: ${t(`tools.theme_${theme.choice}`)}`;
  $("theme").setAttribute("aria-label", $("theme").title);
}

function show_link() {
  const link = !received_ms ? "waiting" : performance.now() - received_ms > 5 * PERIOD_MS ? "lost" : "live";
  document.body.dataset.link = link;
  set_text($("link-text"), t(`link.${link}`));
  $("banner").hidden = link !== "lost";
  set_text($("banner-text"), t("commission.lost"));
}

/** Take over a state that the server answered with. */
export function receive(state) {
  store.state = state;
  received_ms = performance.now();
  render_steps(state);
}

async function read_state() {
  clearTimeout(timer);
  let state = null;
  try {
    state = await get("api/commission");
  } catch (error) {
    if (error.status === 401) location.href = "login";
  }
  timer = setTimeout(read_state, store.state?.views ? BUSY_MS : PERIOD_MS);
  if (state) receive(state);
  show_link();
}

function start_tools() {
  $("language").append(...list_languages().map(({ code, name }) => create_element("option", { value: code }, name)));
  $("language").value = get_language();
  $("language").addEventListener("change", () => set_language($("language").value));
  $("theme").addEventListener("click", () => theme.next());
}

store.on("answer", receive);
await load_page_settings();
await load_texts(store.page?.language);
start_tools();
apply_texts(document);
store.on("texts", () => { show_link(); show_page(); show_theme(); if (store.state) render_steps(store.state, true); });
store.on("theme", show_theme);
window.addEventListener("hashchange", () => choose_step(location.hash.slice(1)));
show_page();
show_theme();
await read_state();
