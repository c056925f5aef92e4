// Light, dark, or as the system: one button goes round; whoever draws on canvases listens to "theme".
import { store } from "./store.js";

const ORDER = ["system", "light", "dark"];
const system = matchMedia("(prefers-color-scheme: dark)");
let wish = new URLSearchParams(location.search).get("theme") || localStorage.getItem("theme") || "system";

export const theme = {
  get wish() { return ORDER.includes(wish) ? wish : "system"; },
  next() {
    // the first press always shows a difference
    const shown = document.documentElement.dataset.theme;
    wish = this.wish === "system" ? (shown === "dark" ? "light" : "dark") : this.wish === (system.matches ? "light" : "dark") ? (system.matches ? "dark" : "light") : "system";
    localStorage.setItem("theme", wish);
    apply();
  },
};

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

function apply() {
  const dark = theme.wish === "dark" || (theme.wish === "system" && system.matches);
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  store.tell("theme");
}

system.addEventListener("change", apply);
