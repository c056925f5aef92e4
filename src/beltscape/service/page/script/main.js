// The entry point: loads settings and texts, starts the parts, connects.
import * as alarm_journal from "./alarm_journal.js";
import * as alarms from "./alarms.js";
import { get, post } from "./api.js";
import * as belt from "./belt.js";
import * as cameras from "./cameras.js";
import * as chart from "./chart.js";
import { connect, is_frame_stale, retry } from "./connection.js";
import { $, create_element, create_icon, set_text, throttle } from "./dom.js";
import * as flow from "./flow.js";
import * as health from "./health.js";
import * as history from "./history.js";
import * as maintenance from "./maintenance.js";
import * as now from "./now.js";
import * as production from "./production.js";
import * as recording from "./recording.js";
import * as keys from "./keys.js";
import { compute_area_m2, read_section, SectionPlot } from "./section.js";
import { store } from "./store.js";
import { apply_texts, format_duration, format_moment, format_number, format_time, format_unit, get_language, list_languages, load_texts, set_language, t } from "./texts.js";
import { theme } from "./theme.js";

function show_link() {
  set_text($("link-text"), t(`link.${store.link}`));
  show_banner();
}

function show_banner() {
  // a page that is just opening shows no message for the first seconds
  const is_opening = performance.now() < 3000;
  const text = store.link === "lost" ? t("banner.lost", { time: format_moment(store.state.wall_ms) })
    : store.link === "stale" ? (store.age_s == null ? t("banner.nothing") : is_frame_stale() ? t("banner.stale", { age: format_duration(store.age_s) }) : store.flow_age_s == null ? t("banner.no_record_yet") : t("banner.no_record", { age: format_duration(store.flow_age_s) }))
    : store.link === "waiting" && !is_opening ? t("banner.never") : "";
  $("banner").hidden = !text;
  $("retry").hidden = store.link === "stale";
  if (text) set_text($("banner-text"), text);
}

function show_clock() {
  set_text($("clock"), format_time(Date.now() + store.clock_ms));
}

function show_page() {
  const page = store.page;
  if (!page) return;
  set_text($("plant"), page.plant);
  const is_signed_in = page.user && page.user !== "anonymous";
  $("who").replaceChildren(...(is_signed_in
    ? [create_element("a", { href: "account" }, t("tools.signed_in", { user: page.user, role: t(`role.${page.role}`) })), create_element("button", { type: "button", on: { click: sign_out } }, t("tools.sign_out"))]
    : [create_element("a", { href: "login" }, t("tools.sign_in"))]));
}

async function sign_out() {
  await post("api/access/logout").catch(() => {});
  location.href = "login";
}

function show_theme() {
  $("theme").replaceChildren(create_icon(theme.choice));
  $("theme").title = `${t("tools.theme")}: ${t(`tools.theme_${theme.choice}`)}`;
  $("theme").setAttribute("aria-label", $("theme").title);
}

function show_view() {
  const is_wall = document.documentElement.classList.contains("wall");
  const view = is_wall ? "live" : location.hash === "#history" ? "history" : location.hash === "#alarms-view" ? "alarms" : location.hash === "#health" && health.is_allowed() ? "health" : location.hash === "#production" && production.is_served() ? "production" : "live";
  for (const name of ["live", "production", "alarms", "history", "health"]) {
    $(`${name}-view`).hidden = name !== view;
    $(`to-${name}`).toggleAttribute("aria-current", name === view);
  }
  $("to-health").hidden = !health.is_allowed();
  $("to-production").hidden = !production.is_served();
  if (view === "history") history.open();
  else if (view === "alarms") alarm_journal.open();
  else if (view === "health") health.open();
  else if (view === "production") production.open();
  else store.emit("layout");
}

function start_section() {
  const plot = new SectionPlot($("section"));
  const show_area = () => { if (plot.section) set_text($("section-area"), format_unit(format_number(compute_area_m2(plot.section), 4), "m2")); };
  store.on("section", throttle((message) => {
    $("section-none").hidden = true;
    plot.show(read_section(message));
    show_area();
  }));
  store.on("texts", show_area);
  for (const subject of ["theme", "texts", "layout"]) store.on(subject, () => plot.draw());
}

function start_tools() {
  $("language").append(...list_languages().map(({ code, name }) => create_element("option", { value: code }, name)));
  $("language").value = get_language();
  $("language").addEventListener("change", () => set_language($("language").value));
  $("wall").append(create_icon("wall"));
  $("show-keys").append(create_icon("keys"));
  $("theme").addEventListener("click", () => theme.next());
  $("wall").addEventListener("click", keys.toggle_wall);
  $("show-keys").addEventListener("click", keys.toggle_help);
  $("retry").addEventListener("click", retry);
}

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

await load_page_settings();
await load_texts(store.page?.language);
start_tools();
for (const part of [flow, alarms, now, cameras, chart, recording, maintenance, production, health, keys]) part.start();
start_section();
apply_texts(document);
store.on("link", show_link);
store.on("texts", () => { $("language").value = get_language(); show_link(); show_page(); show_theme(); });
store.on("theme", show_theme);
store.on("page", () => { show_page(); show_view(); });
store.on("tick", () => { show_clock(); show_banner(); });
store.on("opened", () => { if (!store.page) load_page_settings(); });
store.on("signed_out", go_to_login);
addEventListener("hashchange", show_view);
show_link();
show_page();
show_theme();
show_clock();
show_view();
connect();
await belt.start();
