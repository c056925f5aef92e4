// The forms of the steps: what the engineer answers. Each field is a key of the settings.
import { get } from "../page/script/api.js";
import { $, create_element } from "../page/script/dom.js";
import { store } from "../page/script/store.js";
import { get_language, t } from "../page/script/texts.js";
import { create_program_line, read_line } from "./problems.js";
import { act, render_steps } from "./steps.js";

const FIELDS = {
  images: [["exposure_us", "number"], ["gain_db", "number"]],
  trigger: [["instants", "number"]],
  board: [["board.file", "text"], ["board.squares.0", "number"], ["board.squares.1", "number"], ["board.square_mm", "number"], ["board.marker_mm", "number"], ["board.dictionary", "text"]],
  skew: [["instants", "number"], ["belt_mm_s", "number"], ["skew_limit_ms", "number"]],
  calibrate: [["plan", "text"], ["tolerance_mm", "number"]],
  empty: [["seconds", "number"]],
  project: [["plant", "text"], ["load_mm", "number"], ["density_kg_m3", "number"]],
  live: [["seconds", "number"]],
  material: [["reference.name", "text"], ["reference.certificate", "text"], ["reference.sigma_percent", "number"], ["material_test", "text"]],
  certificate: [["operator", "text"]],
};
const OF_CAMERAS = new Set(["exposure_us", "gain_db", "instants", "seconds"]);
const SOURCES = ["trial", "captures", "cameras"];
const DEVICES = 8; // rows of the form; more are given in the terminal
const LEAST_RUNS = 2; // and an empty one after those that are there
const RUN_FIELDS = [["load", "text"], ["mass_kg", "number"], ["volume_m3", "number"], ["ticket", "text"], ["capture", "text"]];
const NULLABLE = new Set(["file", "capture", "begin", "end"]);

const ENCODERS = { none: [], camera: ["chunk", "mm_per_count"], udp: ["port", "mm_per_count"], file: ["path", "mm_per_count"], constant: ["speed_mm_s"] }; // kind → keys that are asked
const ENCODER_KEYS = { chunk: "text", port: "number", path: "text", mm_per_count: "number", speed_mm_s: "number" };

const read_path = (settings, path) => path.split(".").reduce((value, key) => value?.[key], settings);

/** Return a moment as the browser's local time to the second, as its input takes it. */
function to_local(iso) {
  if (!iso) return null;
  const at = new Date(iso);
  return new Date(at.getTime() - 60_000 * at.getTimezoneOffset()).toISOString().slice(0, 19);
}

/** Return the moment of an input; the one before, to its millisecond, where it was not changed. */
const read_moment = (value, before) => (value === to_local(before) ? before : new Date(value).toISOString());

export function create_form(name, state) {
  const { settings } = state;
  const form = create_element("form", { class: "form", id: "form", on: { submit: (event) => { event.preventDefault(); $("do-run")?.click(); } } });
  if (name === "cameras") form.append(...create_source(settings));
  for (const [path, kind] of FIELDS[name] ?? []) {
    if (OF_CAMERAS.has(path) && settings.source !== "cameras") continue;
    form.append(create_field(path, kind, read_path(settings, path)));
  }
  if (name === "project" && settings.source === "cameras") form.append(create_encoder(settings));
  if (name === "material") form.append(create_samples(settings), create_zero(settings), ...create_runs(settings));
  if (name === "rig") form.append(create_element("label", { class: "choice wide" }, create_element("input", { type: "checkbox", name: "accept_doubts", checked: settings.accept_doubts }), create_element("span", {}, t("commission.field.accept_doubts"))));
  return form;
}

function create_field(path, kind, value) {
  const input = create_element("input", { name: path, type: kind, step: kind === "number" ? "any" : null, value: value ?? null, autocomplete: "off" });
  return create_element("label", {}, t(`commission.field.${path.replaceAll(".", "_")}`), input);
}

function create_source(settings) {
  const wanted = settings.source ?? "trial";
  const choices = SOURCES.map((source) => create_element("label", { class: "choice" },
    create_element("input", { type: "radio", name: "source", value: source, checked: source === wanted, on: { change: show_source } }),
    create_element("span", {}, t(`commission.source.${source}`), create_element("small", {}, t(`commission.source.${source}_about`)))));
  const devices = Object.entries(settings.devices);
  const rows = Array.from({ length: Math.max(DEVICES, devices.length) }, (_, i) => create_device(i, devices[i] ?? ["", ""]));
  const search = create_element("button", { type: "button", class: "plain", on: { click: () => fill_found(search) } }, t("commission.search"));
  const more = ["frames_per_s", "exposure_us", "allowed_skew_ms"].map((path) => create_field(path, "number", settings[path]));
  const trigger = create_element("label", {}, t("commission.field.trigger"), create_element("select", { name: "trigger" }, ...["software", "line", "free"].map((one) => create_element("option", { value: one, selected: one === settings.trigger }, t(`commission.trigger.${one}`)))));
  setTimeout(show_source);
  return [
    create_element("fieldset", {}, create_element("legend", {}, t("commission.field.source")), ...choices),
    create_element("div", { class: "wide", "data-source": "captures" }, create_field("captures", "text", settings.source === "captures" ? settings.captures : null)),
    create_element("fieldset", { "data-source": "cameras" }, create_element("legend", {}, t("commission.field.devices")), create_element("div", {}, search), create_element("p", { id: "found", class: "soft", role: "status" }), ...rows),
    create_element("div", { class: "form wide", "data-source": "cameras" }, trigger, ...more),
    create_field("core", "text", settings.core),
  ];
}

/** Return where the belt's position comes from, with the keys of the chosen kind. */
function create_encoder({ encoder, camera_encoder }) {
  const wanted = encoder.kind ?? "none";
  const present = { ...encoder, ...camera_encoder };
  const kinds = create_element("select", { "data-encoder": "kind", on: { change: show_encoder } }, ...Object.keys(ENCODERS).map((kind) => create_element("option", { value: kind, selected: kind === wanted }, t(`commission.encoder.${kind}`))));
  const keys = Object.entries(ENCODER_KEYS).map(([key, kind]) => create_element("label", {}, t(`commission.field.encoder_${key}`), create_element("input", { type: kind, step: kind === "number" ? "any" : null, "data-encoder": key, value: present[key] ?? null, autocomplete: "off" })));
  setTimeout(show_encoder);
  return create_element("fieldset", { class: "run" }, create_element("legend", {}, t("commission.field.encoder")), create_element("div", { class: "form" }, create_element("label", { class: "wide" }, t("commission.field.encoder_kind"), kinds), ...keys));
}

function show_encoder() {
  const kind = document.querySelector("#form [data-encoder=kind]")?.value;
  for (const input of document.querySelectorAll("#form input[data-encoder]")) input.parentElement.hidden = !ENCODERS[kind].includes(input.dataset.encoder);
}

function add_encoder(changes, settings) {
  const kind = document.querySelector("#form [data-encoder=kind]").value;
  const given = [...document.querySelectorAll("#form input[data-encoder]")].filter((input) => !input.parentElement.hidden && input.value.trim()).map((input) => [input.dataset.encoder, read_input(input)]);
  const kept = settings.encoder.kind === kind ? settings.encoder : {};
  const values = { ...Object.fromEntries(given) };
  const encoder = kind === "none" ? {} : kind === "camera" ? { ...kept, kind } : { ...kept, kind, ...values };
  const camera_encoder = kind === "camera" ? { ...settings.camera_encoder, ...values } : {};
  if (JSON.stringify(encoder) !== JSON.stringify(settings.encoder)) changes.encoder = encoder;
  if (JSON.stringify(camera_encoder) !== JSON.stringify(settings.camera_encoder)) changes.camera_encoder = camera_encoder;
}

function create_device(number, [name, device]) {
  return create_element("div", { class: "device" },
    create_element("label", {}, t("commission.field.camera", { number: number + 1 }), create_element("input", { "data-device": "name", type: "text", value: name, placeholder: `cam${number}` })),
    create_element("label", {}, t("commission.field.device"), create_element("input", { "data-device": "device", type: "text", value: device, placeholder: "192.168.10.11" })));
}

function show_source() {
  const source = document.querySelector("#form input[name=source]:checked")?.value;
  for (const part of document.querySelectorAll("#form [data-source]")) part.hidden = part.dataset.source !== source;
}

async function fill_found(button) {
  button.disabled = true;
  $("found").textContent = t("commission.searching");
  try {
    const found = await get("api/commission/found");
    $("found").textContent = found.length ? t("commission.found", { count: found.length }) : t("commission.found_none");
    const rows = [...document.querySelectorAll("#form .device")];
    found.slice(0, rows.length).forEach((camera, i) => {
      const [name, device] = rows[i].querySelectorAll("input");
      name.value ||= `cam${i}`;
      device.value = camera.address || camera.device;
    });
  } catch (error) {
    if (error.status === undefined) $("found").textContent = t("commission.unsent");
    else $("found").replaceChildren(create_element("span", {}, t("commission.search_failed")), create_program_line(read_line(error)));
  }
  button.disabled = false;
}

/** Return a button that puts the present moment into a field; it is kept by the program at once. */
const create_stamp = (part, edge) => create_element("button", { type: "button", class: "plain", "data-stamp": `${part} ${edge}`, on: { click: () => stamp(part, edge) } }, t(`commission.${edge}_now`));

async function stamp(part, edge) {
  const changes = read_form("material", store.state);
  const { settings } = store.state;
  if (part === "zero") changes.zero = { ...(changes.zero ?? settings.zero), begin: "now", end: null };
  else {
    const runs = structuredClone(changes.runs ?? settings.runs);
    while (runs.length <= Number(part)) runs.push({});
    runs[part][edge] = "now";
    changes.runs = runs;
  }
  if (await act("api/commission/settings", { changes })) {
    render_steps(store.state, true);
    document.querySelector(`[data-stamp="${part} ${edge}"]`)?.focus();
  }
}

function create_samples({ samples }) {
  return create_element("fieldset", { class: "run" }, create_element("legend", {}, t("commission.samples")), create_element("p", { class: "soft" }, t("commission.samples_about")),
    create_element("div", { class: "form" }, ...Object.entries(samples).map(([key, value]) => create_field(`samples.${key}`, "number", value))));
}

function create_zero({ zero }) {
  const fields = [["revolutions", "number"], ["belt_length_m", "number"], ["capture", "text"]].map(([key, kind]) => create_field(`zero.${key}`, kind, zero[key]));
  return create_element("fieldset", { class: "run" }, create_element("legend", {}, t("commission.zero")), create_element("p", { class: "soft" }, t("commission.zero_about")),
    create_element("div", { class: "form" }, ...fields), create_element("div", { class: "row actions" }, create_stamp("zero", "begin"), create_element("span", { id: "turns", class: "soft", role: "status" })),
    create_moments(zero, [["begin", { name: "zero.begin" }]]));
}

/** Return the moments of a measurement as a text, and their fields, which are opened to correct them. */
function create_moments(measured, edges) {
  const format = (iso) => (iso ? new Intl.DateTimeFormat(get_language(), { dateStyle: "medium", timeStyle: "medium" }).format(new Date(iso)) : "–");
  const fields = edges.map(([edge, more]) => create_element("label", {}, t(`commission.field.${edge}`), create_element("input", { type: "datetime-local", step: 1, value: to_local(measured[edge]), ...more })));
  return create_element("details", { class: "moments" }, create_element("summary", {}, edges.map(([edge]) => `${t(`commission.field.${edge}`)}: ${format(measured[edge])}`).join("; ")), create_element("div", { class: "form" }, ...fields));
}

function create_runs({ runs }) {
  const rows = Array.from({ length: Math.max(LEAST_RUNS, runs.length + 1) }, (_, i) => runs[i] ?? {});
  return rows.map((run, i) => create_element("fieldset", { class: "run", "data-run": i }, create_element("legend", {}, t("commission.run", { number: i + 1 })),
    create_element("div", { class: "form" }, ...RUN_FIELDS.map(([key, kind]) => create_element("label", {}, t(`commission.field.run_${key}`), create_element("input", { type: kind, step: kind === "number" ? "any" : null, "data-key": key, value: run[key] ?? null, autocomplete: "off" })))),
    create_element("div", { class: "row actions" }, create_stamp(i, "begin"), create_stamp(i, "end")),
    create_moments(run, ["begin", "end"].map((edge) => [edge, { "data-key": edge }]))));
}

/** Return what an input holds; null: nothing. */
function read_input(input, before) {
  if (input.type === "checkbox") return input.checked;
  if (input.value.trim() === "") return null;
  if (input.type === "datetime-local") return read_moment(input.value, before);
  return input.type === "number" ? Number(input.value) : input.value.trim();
}

/** Return the settings that the form changes. */
export function read_form(name, { settings }) {
  const changes = {};
  for (const input of document.querySelectorAll("#form [name]")) {
    if (input.type === "radio" && !input.checked) continue;
    if (input.closest("[hidden]")) continue;
    const value = read_input(input, read_path(settings, input.name));
    const path = input.name.split(".");
    if (value === (read_path(settings, input.name) ?? null)) continue;
    if (value === null && typeof read_path(settings, input.name) === "string" && path.length === 1) { changes[input.name] = input.name === "captures" || input.name === "plan" || input.name === "material_test" ? null : ""; continue; }
    if (path.length === 1) { changes[path[0]] = value; continue; }
    changes[path[0]] ??= structuredClone(settings[path[0]]);
    let table = changes[path[0]];
    for (const key of path.slice(1, -1)) table = table[key];
    table[path.at(-1)] = value ?? (typeof table[path.at(-1)] === "string" && !NULLABLE.has(path.at(-1)) ? "" : null);
  }
  if (name === "cameras" && changes.source === undefined && settings.source === null) changes.source = document.querySelector("#form input[name=source]:checked").value;
  const source = changes.source ?? settings.source;
  if (name === "cameras" && source === "cameras") add_devices(changes, settings);
  if (name === "project" && source === "cameras") add_encoder(changes, settings);
  if (name === "material") add_runs(changes, settings);
  return changes;
}

function add_devices(changes, settings) {
  const rows = [...document.querySelectorAll("#form .device")].map((row) => [...row.querySelectorAll("input")].map((input) => input.value.trim()));
  const devices = Object.fromEntries(rows.filter(([name, device]) => name && device));
  if (JSON.stringify(devices) !== JSON.stringify(settings.devices)) changes.devices = devices;
}

function add_runs(changes, settings) {
  const rows = [...document.querySelectorAll("#form [data-run]")];
  const runs = rows.map((row, i) => Object.fromEntries([...row.querySelectorAll("input")].filter((input) => input.value.trim()).map((input) => [input.dataset.key, read_input(input, settings.runs[i]?.[input.dataset.key])])));
  const given = runs.filter((run) => Object.keys(run).length);
  const known = settings.runs.map((run) => Object.fromEntries(Object.entries(run).filter(([, value]) => value !== null && value !== "")));
  const sort = (list) => JSON.stringify(list.map((run) => Object.entries(run).sort()));
  if (sort(given) !== sort(known)) changes.runs = given;
}
