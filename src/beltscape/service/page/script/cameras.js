// Small pictures and health of the cameras; a new picture is asked for only while somebody can see it.
import { $, keep, make, say, sign } from "./dom.js";
import { store } from "./store.js";
import { number, t, unit } from "./texts.js";

const EVERY_MS = 2000;
let visible = true;

function create(camera) {
  const facts = make("dl", {}, ...["cameras.rate", "cameras.skew", "cameras.missed"].flatMap((key) => [make("dt", { "data-text": key }, t(key)), make("dd")]));
  const picture = make("img", { alt: "", decoding: "async", hidden: true });
  picture.addEventListener("load", () => { picture.hidden = false; });
  picture.addEventListener("error", () => { picture.dataset.failed = "1"; });
  return make("li", { class: "camera" }, make("figure", {}, picture), make("div", {}, make("h3", {}, camera.name), make("span", { class: "state" }, sign(camera.state), make("span")), facts, make("p", { class: "message" })));
}

function update(item, camera) {
  const picture = item.querySelector("img");
  const state = item.querySelector(".state");
  if (item.dataset.state !== camera.state) state.replaceChild(sign(camera.state), state.firstChild);
  item.dataset.state = camera.state;
  say(state.lastChild, t(`camera.${camera.state}`));
  picture.alt = t("cameras.picture", { name: camera.name });
  const [rate, skew, missed] = item.querySelectorAll("dd");
  say(rate, unit(number(camera.rate_hz, 1), "hz"));
  say(skew, unit(number(camera.skew_ms, 2), "ms"));
  say(missed, number(camera.missed));
  const message = item.querySelector(".message");
  say(message, camera.message);
  message.hidden = !camera.message;
  const now = performance.now();
  if (!visible || document.hidden || store.link === "lost") return;
  if (camera.picture !== null && picture.dataset.frame !== camera.picture && now - Number(picture.dataset.asked ?? -EVERY_MS) >= EVERY_MS) {
    picture.dataset.asked = now;
    picture.dataset.frame = camera.picture;
    picture.src = `/api/cameras/${encodeURIComponent(camera.name)}/picture?frame=${encodeURIComponent(camera.picture)}`;
  }
}

function show() {
  const cameras = store.state?.cameras ?? [];
  keep($("cameras"), cameras, (camera) => camera.name, create, update);
  $("cameras-none").hidden = cameras.length > 0;
}

export function start() {
  new IntersectionObserver((entries) => { visible = entries.at(-1).isIntersecting; }).observe($("cameras").closest(".panel"));
  for (const subject of ["state", "texts"]) store.on(subject, show);
}
