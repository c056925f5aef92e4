// Puts the page together.
import * as alarms from "./alarms.js";
import { get } from "./api.js";
import * as belt from "./belt.js";
import * as cameras from "./cameras.js";
import * as chart from "./chart.js";
import { connect, retry } from "./connection.js";
import { $, calm, make, say, sign } from "./dom.js";
import * as flow from "./flow.js";
import * as history from "./history.js";
import * as keep from "./keep.js";
import * as keys from "./keys.js";
import { area_m2, of_message, SectionPlot } from "./section.js";
import { store } from "./store.js";
import { apply, choose, chosen, day_and_time, duration, languages, load, moment, number, t, time, unit } from "./texts.js";
import { theme } from "./theme.js";

function show_link() {
  say($("link-text"), t(`link.${store.link}`));
  show_banner();
}

function show_banner() {
  const age = store.age_s;
  // for the first seconds a page that is just opening says nothing
  const soon = performance.now() < 3000;
  const text = store.link === "lost" ? t("banner.lost", { time: moment(store.state.wall_ms) })
    : store.link === "stale" ? (age == null ? t("banner.nothing") : t("banner.stale", { age: duration(age) }))
    : store.link === "waiting" && !soon ? t("banner.never") : "";
  $("banner").hidden = !text;
  $("retry").hidden = store.link === "stale";
  if (text) say($("banner-text"), text);
}

function show_clock() {
  say($("clock"), time(Date.now() + store.clock_ms));
}

function show_page() {
  const page = store.page;
  if (!page) return;
  say($("plant"), page.plant);
  const named = page.user && page.user !== "anonymous";
  $("who").replaceChildren(...(named
    ? [make("a", { href: "/account" }, t("tools.signed_in", { user: page.user, role: t(`role.${page.role}`) })), make("button", { type: "button", on: { click: sign_out } }, t("tools.sign_out"))]
    : [make("a", { href: "/login?next=/" }, t("tools.sign_in"))]));
}

async function sign_out() {
  const { post } = await import("./api.js");
  await post("/api/access/logout").catch(() => {});
  location.href = "/login";
}

function show_theme() {
  $("theme").replaceChildren(sign(theme.wish));
  $("theme").title = `${t("tools.theme")}: ${t(`tools.theme_${theme.wish}`)}`;
  $("theme").setAttribute("aria-label", $("theme").title);
}

function show_view() {
  const past = location.hash === "#history" && !document.documentElement.classList.contains("wall");
  $("live-view").hidden = past;
  $("history-view").hidden = !past;
  $("to-live").toggleAttribute("aria-current", !past);
  $("to-history").toggleAttribute("aria-current", past);
  if (past) history.open(); else store.tell("layout");
}

function start_section() {
  const plot = new SectionPlot($("section"));
  store.on("section", calm((message) => {
    const section = of_message(message);
    $("section-none").hidden = true;
    say($("section-area"), unit(number(area_m2(section), 4), "m2"));
    plot.show(section);
  }));
  for (const subject of ["theme", "texts", "layout"]) store.on(subject, () => plot.draw());
}

function start_tools() {
  $("language").append(...languages().map((name) => make("option", { value: name }, t(`language.${name}`))));
  $("language").value = chosen();
  $("language").addEventListener("change", () => choose($("language").value));
  $("wall").append(sign("wall"));
  $("show-keys").append(sign("keys"));
  $("theme").addEventListener("click", () => theme.next());
  $("wall").addEventListener("click", keys.wall);
  $("show-keys").addEventListener("click", keys.help);
  $("retry").addEventListener("click", retry);
}

async function ask_page() {
  try {
    store.page = await get("/api/page");
  } catch (error) {
    if (error.status === 401) to_login();
  }
  store.tell("page");
}

function to_login() {
  location.href = `/login?next=${encodeURIComponent(location.pathname)}`;
}

await ask_page();
await load(store.page?.language);
start_tools();
for (const part of [flow, alarms, cameras, chart, keep, keys]) part.start();
start_section();
apply(document);
store.on("link", show_link);
store.on("texts", () => { $("language").value = chosen(); show_link(); show_page(); show_theme(); });
store.on("theme", show_theme);
store.on("page", show_page);
store.on("tick", () => { show_clock(); show_banner(); });
store.on("opened", () => { if (!store.page) ask_page(); });
store.on("signed_out", to_login);
addEventListener("hashchange", show_view);
show_link();
show_page();
show_theme();
show_clock();
show_view();
connect();
await belt.start();
