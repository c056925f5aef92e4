// The page of a site: reads /api/site every second and shows belts, transfer points, alarms and totals.
import { get, post } from "../page/script/api.js";
import { $, create_element, create_icon, set_text } from "../page/script/dom.js";
import { store } from "../page/script/store.js";
import { apply_texts, format_moment, format_time, get_language, list_languages, load_texts, set_language, t } from "../page/script/texts.js";
import { theme } from "../page/script/theme.js";
import { show_alarms } from "./alarms.js";
import { show_balances } from "./balances.js";
import { show_belts } from "./belts.js";
import { show_totals, start_totals } from "./totals.js";

const PERIOD_MS = 1000;
let received_ms = 0; // performance.now() at the newest state; 0: never

async function load_page_settings() {
  try {
    store.page = await get("api/page");
  } catch (error) {
    if (error.status === 401) go_to_login();
  }
  store.emit("page");
}

function go_to_login() {
  location.href = "login";
}

async function sign_out() {
  await post("api/access/logout").catch(() => {});
  go_to_login();
}

function show_page() {
  const page = store.page;
  if (!page) return;
  set_text($("plant"), page.plant);
  document.title = page.plant || t("site.title");
  const is_signed_in = page.user && page.user !== "anonymous";
  $("who").replaceChildren(...(is_signed_in
    ? [create_element("a", { href: "account" }, t("tools.signed_in", { user: page.user, role: t(`role.${page.role}`) })), create_element("button", { type: "button", on: { click: sign_out } }, t("tools.sign_out"))]
    : [create_element("a", { href: "login" }, t("tools.sign_in"))]));
}

function show_theme() {
  $("theme").replaceChildren(create_icon(theme.choice));
  $("theme").title = `${t("tools.theme")}: ${t(`tools.theme_${theme.choice}`)}`;
  $("theme").setAttribute("aria-label", $("theme").title);
}

function show_link() {
  const is_silent = performance.now() - received_ms > 4 * PERIOD_MS;
  const link = !received_ms ? "waiting" : is_silent ? "lost" : "live";
  document.body.dataset.link = link;
  set_text($("link-text"), t(`link.${link}`));
  const text = link === "lost" ? t("site.lost", { time: format_moment(store.state.wall_ms) }) : link === "waiting" && performance.now() > 5000 ? t("site.never") : "";
  $("banner").hidden = !text;
  if (text) set_text($("banner-text"), text);
}

function render() {
  if (!store.state) return;
  show_belts(store.state.belts);
  show_balances(store.state.balances);
  show_alarms(store.state);
}

async function read_state() {
  try {
    store.state = await get("api/site");
    received_ms = performance.now();
    store.clock_ms = store.state.wall_ms - Date.now();
    if (!store.page) await load_page_settings();
    render();
  } catch (error) {
    if (error.status === 401) go_to_login();
  }
  show_link();
  set_text($("clock"), format_time(Date.now() + store.clock_ms));
  setTimeout(read_state, PERIOD_MS);
}

function start_tools() {
  $("language").append(...list_languages().map(({ code, name }) => create_element("option", { value: code }, name)));
  $("language").value = get_language();
  $("language").addEventListener("change", () => set_language($("language").value));
  $("theme").addEventListener("click", () => theme.next());
}

await load_page_settings();
await load_texts(store.page?.language);
start_tools();
apply_texts(document);
store.on("texts", () => { show_link(); show_page(); show_theme(); render(); show_totals(); });
store.on("theme", show_theme);
store.on("page", show_page);
show_page();
show_theme();
await start_totals();
await read_state();
