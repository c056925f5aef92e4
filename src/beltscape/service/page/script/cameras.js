// Pictures and health of the cameras; pictures are loaded only while the panel is visible.
import { $, create_element, create_icon, set_text, sync_children } from "./dom.js";
import { store } from "./store.js";
import { translate_cause } from "./alarm_texts.js";
import { format_number, format_unit, get_language, t } from "./texts.js";

const RELOAD_MS = 2000;
let visible = true;

function create_item(camera) {
  const facts = create_element("dl", {}, ...["cameras.rate", "cameras.skew", "cameras.missed"].flatMap((key) => [create_element("dt", { "data-text": key }, t(key)), create_element("dd")]));
  const picture = create_element("img", { alt: "", decoding: "async", hidden: true });
  picture.addEventListener("load", () => { picture.hidden = false; });
  picture.addEventListener("error", () => { picture.dataset.failed = "1"; });
  return create_element("li", { class: "camera" }, create_element("figure", {}, picture), create_element("div", {}, create_element("h3", {}, camera.name), create_element("span", { class: "state" }, create_icon(camera.state), create_element("span")), facts, create_element("p", { class: "message" })));
}

function update_item(item, camera) {
  const picture = item.querySelector("img");
  const state = item.querySelector(".state");
  if (item.dataset.state !== camera.state) state.replaceChild(create_icon(camera.state), state.firstChild);
  item.dataset.state = camera.state;
  set_text(state.lastChild, t(`camera.${camera.state}`));
  picture.alt = t("cameras.picture", { name: camera.name });
  const [rate, skew, missed] = item.querySelectorAll("dd");
  set_text(rate, format_unit(format_number(camera.rate_hz, 1), "hz"));
  set_text(skew, format_unit(format_number(camera.skew_ms, 2), "ms"));
  set_text(missed, format_number(camera.missed));
  const message = item.querySelector(".message");
  set_text(message, translate_cause(camera.cause, camera.values) ?? camera.message);
  message.title = get_language() === "en" ? camera.message : "";
  message.hidden = !camera.message;
  const now = performance.now();
  if (!visible || document.hidden || store.link === "lost") return;
  if (camera.picture !== null && picture.dataset.frame !== camera.picture && now - Number(picture.dataset.loaded ?? -RELOAD_MS) >= RELOAD_MS) {
    picture.dataset.loaded = now;
    picture.dataset.frame = camera.picture;
    picture.src = `api/cameras/${encodeURIComponent(camera.name)}/picture?frame=${encodeURIComponent(camera.picture)}`;
  }
}

function render() {
  const cameras = store.state?.cameras ?? [];
  sync_children($("cameras"), cameras, (camera) => camera.name, create_item, update_item);
  $("cameras-none").hidden = cameras.length > 0;
}

export function start() {
  new IntersectionObserver((entries) => { visible = entries.at(-1).isIntersecting; }).observe($("cameras").closest(".panel"));
  for (const subject of ["state", "texts"]) store.on(subject, render);
}
