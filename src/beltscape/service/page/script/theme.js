// The theme: light, dark or as the system. One button cycles through them; a change emits "theme".
import { store } from "./store.js";

const ORDER = ["system", "light", "dark"];
const system = matchMedia("(prefers-color-scheme: dark)");
let choice = new URLSearchParams(location.search).get("theme") || localStorage.getItem("theme") || "system";

export const theme = {
  get choice() { return ORDER.includes(choice) ? choice : "system"; },
  next() {
    // the first press always changes the theme
    const shown = document.documentElement.dataset.theme;
    choice = this.choice === "system" ? (shown === "dark" ? "light" : "dark") : this.choice === (system.matches ? "light" : "dark") ? (system.matches ? "dark" : "light") : "system";
    localStorage.setItem("theme", choice);
    apply_theme();
  },
};

export function get_colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

function apply_theme() {
  const dark = theme.choice === "dark" || (theme.choice === "system" && system.matches);
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  store.emit("theme");
}

system.addEventListener("change", apply_theme);
