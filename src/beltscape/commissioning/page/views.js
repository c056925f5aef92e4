// Guided calibration: what to do now, the score, and every camera's picture with corners, coverage and the next pose.
import { $, create_element, create_svg, set_text, sync_children } from "../page/script/dom.js";
import { format_percent, format_significant, t } from "../page/script/texts.js";
import { create_program_line } from "./problems.js";
import { act } from "./steps.js";

const MISSING = 1, REACHED = 2;
let has_sound = false;
let heard = 0; // views of which a sound was made

const with_unit = (value, unit) => `${format_significant(value)}\u00a0${t(`unit.${unit}`)}`;
const handle = (action) => act("api/commission/views", { action });

export function render_views(host, state) {
  const { views } = state;
  if (!views) {
    const can_start = !state.running && state.steps.find((step) => step.name === "calibrate").status !== "blocked";
    if (host.dataset.kind !== `closed ${can_start}`) {
      host.dataset.kind = `closed ${can_start}`;
      host.replaceChildren(create_element("div", { class: "row actions" }, create_element("button", { type: "button", class: "plain main", id: "views-start", disabled: !can_start, on: { click: () => handle("start") } }, t("commission.views.start"))));
    }
    return;
  }
  if (host.dataset.kind !== "open") { host.dataset.kind = "open"; host.replaceChildren(...create_parts()); }
  show_coach(views);
  show_scores(views);
  make_sound(views);
  $("views-anew").hidden = !views.moved && !views.taken;
  sync_children($("views-eyes"), Object.keys(views.sizes_px).map((name) => ({ name, views })), ({ name }) => name, create_eye, update_eye);
}

function create_parts() {
  const button = (id, text, action) => create_element("button", { type: "button", class: "plain", id, on: { click: action } }, text);
  const sound = create_element("input", { type: "checkbox", id: "views-sound", checked: has_sound, on: { change: (event) => { has_sound = event.target.checked; } } });
  return [
    create_element("div", { class: "coach", id: "views-coach", role: "status" }, create_element("strong", {}), create_element("span", {})),
    create_element("div", { class: "warnings", id: "views-trouble", role: "status" }),
    create_element("dl", { class: "scores", id: "views-scores" }),
    create_element("p", { class: "soft", id: "views-doubts-about", hidden: true }, t("commission.views.doubts")),
    create_element("ul", { class: "warnings", id: "views-doubts" }),
    create_element("div", { class: "row actions" }, button("views-take", t("commission.views.take"), () => handle("take")), button("views-stop", t("commission.views.stop"), () => handle("stop")), button("views-anew", t("commission.views.anew"), () => handle("anew")), create_element("label", { class: "soft" }, sound, ` ${t("commission.views.sound")}`)),
    create_element("p", { class: "key" }, ...["missing", "reached", "next"].map((key) => create_element("span", {}, create_element("i", { class: key, "aria-hidden": "true" }), t(`commission.views.key_${key}`)))),
    create_element("ul", { class: "eyes", id: "views-eyes" }),
  ];
}

function show_coach(views) {
  const [strong, more] = $("views-coach").children;
  $("views-coach").dataset.tone = views.moved ? "bad" : views.is_enough ? "good" : "";
  set_text(strong, views.moved ? t("commission.views.moved", { camera: views.moved }) : views.is_enough ? t("commission.views.enough") : t(`commission.view.${views.verdict}`, { camera: views.camera }));
  const waits = views.is_scoring ? t("commission.views.scoring") : views.score || views.verdict === "resuming" ? "" : t("commission.views.first");
  set_text(more, views.moved ? t("commission.views.moved_fix") : views.trouble ? t("commission.views.trouble") : describe_unseen(views) || waits);
  sync_children($("views-trouble"), views.trouble ? [views.trouble] : [], (line) => line, (line) => create_element("p", {}, create_program_line(line)), () => {});
}

/** Return what recorded views lack, once all of them were looked at. */
function describe_unseen({ unseen, sizes_px, taken }) {
  if (!unseen.length) return "";
  return unseen.length > Object.keys(sizes_px).length - 2 && !taken ? t("commission.views.none_seen") : t("commission.views.unseen", { cameras: unseen.join(", ") });
}

function show_scores({ taken, score, tolerance_mm }) {
  const rows = [[t("commission.views.taken"), String(taken)]];
  if (score) rows.push(
    [t("commission.fact.held_out_px"), with_unit(score.held_out_px, "px")],
    [t("commission.views.square"), with_unit(score.square_mm, "mm")],
    [t("commission.fact.sigma_mm"), `${with_unit(score.sigma_mm, "mm")} (≤\u00a0${format_significant(tolerance_mm)})`],
    [t("commission.fact.uncovered"), format_percent(score.uncovered, 1)]);
  sync_children($("views-scores"), rows, ([name]) => name, ([name]) => create_element("div", {}, create_element("dt", {}, name), create_element("dd", {})), (row, [, value]) => set_text(row.lastChild, value));
  sync_children($("views-doubts"), score?.doubts ?? [], (line) => line, (line) => create_element("li", { lang: "en" }, line), () => {});
  $("views-doubts-about").hidden = !score?.doubts?.length;
}

/** A short tone for every view that is taken, where it is wished. */
function make_sound({ taken }) {
  if (has_sound && taken > heard && heard) {
    const audio = new AudioContext();
    const tone = audio.createOscillator();
    tone.connect(audio.destination);
    tone.start();
    tone.stop(audio.currentTime + 0.12);
  }
  heard = taken;
}

function create_eye({ name }) {
  return create_element("li", { class: "eye" }, create_element("h3", {}, name, create_element("span", {})),
    create_element("div", { class: "view" }, create_element("img", { alt: t("commission.picture", { camera: name }), on: { load: ({ target }) => { target.dataset.loaded = ""; } } })));
}

function update_eye(eye, { name, views }) {
  const [width, height] = views.sizes_px[name];
  const corners = views.corners[name] ?? [];
  const cells = views.cells[name].flat();
  const needed = cells.filter((cell) => cell === MISSING || cell === REACHED).length;
  const covered = cells.filter((cell) => cell === REACHED).length;
  set_text(eye.firstChild.lastChild, t("commission.views.of_camera", { corners: corners.length, share: format_percent(Math.min(1, covered / Math.max(needed, 1))) }));
  const view = eye.lastChild;
  view.style.aspectRatio = `${width} / ${height}`;
  if (views.verdict !== "resuming") view.querySelector("img").src = `api/commission/pictures/${encodeURIComponent(name)}?${Date.now()}`;
  view.querySelector("svg")?.remove();
  view.append(create_svg("svg", { viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true" }, ...draw_cells(views.cells[name], width, height), ...draw_ghost(views.ghost[name]), ...corners.map(([u, v]) => create_svg("circle", { class: "corner", cx: u, cy: v, r: width / 150 }))));
}

function draw_cells(cells, width, height) {
  const [rows, columns] = [cells.length, cells[0].length];
  return cells.flatMap((row, v) => row.map((cell, u) => (cell === MISSING || cell === REACHED ? create_svg("rect", { class: cell === MISSING ? "cell-missing" : "cell-reached", x: u * width / columns, y: v * height / rows, width: width / columns, height: height / rows }) : null))).filter(Boolean);
}

const draw_ghost = (outline) => (outline ? [create_svg("polygon", { class: "ghost", points: outline.map((point) => point.join(",")).join(" ") })] : []);
