// The production view: the present product and batch, and the tables of batches, shifts, reports and the belt scale.
import { get, post } from "./api.js";
import { $, create_element, set_text, sync_children } from "./dom.js";
import * as tables from "./production_tables.js";
import { store } from "./store.js";
import { apply_texts, format_duration, format_measured, format_moment, format_number, format_unit, t } from "./texts.js";

const POLL_MS = 4000; // a batch's totals change by some percent of a truck in this time
const TABLES = 8; // the tables change at the end of a batch or a shift: every half minute
let present = null, is_built = false, timer = 0;

export const is_served = () => Boolean(store.page?.has_production);
const is_allowed = () => store.page !== null && store.page.role !== "viewer";

function build() {
  is_built = true;
  const panel = (name, key, ...inside) => create_element("section", { class: `panel ${name}`, "aria-labelledby": `production-${name}-title` },
    create_element("header", {}, create_element("h2", { id: `production-${name}-title`, "data-text": key })), ...inside);
  const name = create_element("input", { id: "batch-name", maxlength: 60, required: true, autocomplete: "off" });
  const form = create_element("form", { id: "batch-form", hidden: true }, create_element("label", { for: "batch-name", "data-text": "production.batch_name" }), name,
    create_element("button", { class: "plain main", "data-text": "production.start" }));
  form.addEventListener("submit", (event) => { event.preventDefault(); change("api/production/batch/start", { name: name.value.trim() }).then((done) => { if (done) name.value = ""; }); });
  $("production-view").append(
    panel("product", "production.product", create_element("div", { class: "products", id: "products", role: "group", "data-label": "production.product" }), create_element("p", { class: "soft", id: "no-products", "data-text": "production.no_products", hidden: true })),
    panel("batch", "production.batch", create_element("div", { id: "batch-now" }), form,
      create_element("button", { class: "plain main", type: "button", id: "batch-stop", "data-text": "production.stop", hidden: true, on: { click: () => change("api/production/batch/stop") } })),
    create_element("p", { class: "problem", id: "production-problem", role: "alert", hidden: true }),
    ...tables.build(panel));
  apply_texts($("production-view"));
}

async function change(path, body) {
  try {
    await post(path, body);
    $("production-problem").hidden = true;
  } catch (error) {
    $("production-problem").hidden = false;
    set_text($("production-problem"), t(error.status === 503 ? "production.not_kept" : "production.refused", { reason: read_reason(error) }));
    await load();
    return false;
  }
  await load();
  tables.load();
  return true;
}

function read_reason(error) {
  try {
    const { detail } = JSON.parse(error.message);
    return typeof detail === "string" ? detail : "";
  } catch {
    return "";
  }
}

async function load() {
  try {
    present = await get("api/production");
  } catch {
    return; // the banner tells that the connection is lost
  }
  render();
}

function render() {
  if (!present) return;
  show_on_live();
  if (!is_built) return;
  $("no-products").hidden = present.products.length > 0;
  sync_children($("products"), present.products, (product) => product.name, create_product, update_product);
  $("batch-form").hidden = Boolean(present.batch) || !is_allowed();
  $("batch-stop").hidden = !present.batch || !is_allowed();
  show_batch(present.batch);
  tables.show_scale(present.has_scale);
}

/** Show product and batch beside the flow as well. */
function show_on_live() {
  const parts = [present.product, present.batch && t("production.in_batch", { name: present.batch.name })].filter(Boolean);
  $("flow-product").hidden = !parts.length;
  set_text($("flow-product"), parts.join(" · "));
}

function create_product(product) {
  const chip = create_element("i", { class: "chip", "aria-hidden": "true" });
  chip.style.background = product.colour;
  return create_element("button", { type: "button", on: { click: () => confirm_product(product) } }, chip, create_element("b", {}, product.name), create_element("span", {}));
}

function update_product(button, product) {
  const is_present = product.name === present.product;
  button.setAttribute("aria-pressed", String(is_present));
  button.disabled = !is_allowed();
  const moisture = product.moisture_percent == null ? "" : ` · ${t("production.moisture_of", { percent: format_number(product.moisture_percent, 1) })}`;
  const density = product.sigma_kg_m3 > 0 ? format_measured(product.density_kg_m3, product.sigma_kg_m3) : format_number(product.density_kg_m3);
  set_text(button.lastChild, `${format_unit(density, "kg_m3")}${moisture}`);
}

function confirm_product(product) {
  if (product.name === present.product) return;
  tables.ask(t("production.change_title"), t("production.change_help", { name: product.name, before: present.product }), t("production.change"), () => change("api/production/product", { name: product.name }));
}

function show_batch(batch) {
  if (!batch) {
    $("batch-now").replaceChildren(create_element("p", { class: "soft" }, t("production.no_batch")));
    return;
  }
  const { totals } = batch;
  const mass = totals.mass_t == null ? t("flow.no_density") : tables.format_mass(totals);
  const age_s = (Date.now() + store.clock_ms - batch.started_ms) / 1000;
  $("batch-now").replaceChildren(create_element("p", { class: "name" }, batch.name),
    create_element("p", { class: "sum-line" }, mass), create_element("p", { class: "sum-line" }, tables.format_volume(totals)),
    create_element("p", { class: "soft" }, t("production.since", { time: format_moment(batch.started_ms), duration: format_duration(Math.max(age_s, 0)), by: batch.started_by })),
    create_element("p", { class: "soft" }, tables.describe_belt(totals)));
}

export function open() {
  if (!is_built) build();
  load();
  tables.load();
}

function poll() {
  clearInterval(timer);
  if (!is_served()) return;
  load();
  let polls = 0;
  timer = setInterval(() => {
    if (document.hidden) return;
    load();
    polls += 1;
    if (is_built && !$("production-view").hidden && polls % TABLES === 0) tables.load();
  }, POLL_MS);
}

export function start() {
  store.on("page", poll);
  poll();
  store.on("texts", () => { render(); if (is_built) tables.render(); });
}
