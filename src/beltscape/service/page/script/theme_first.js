// Runs before the page is drawn, so that it never flashes in the wrong theme or layout.
(() => {
  const root = document.documentElement;
  const wish = new URLSearchParams(location.search).get("theme") || localStorage.getItem("theme");
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = wish === "light" || wish === "dark" ? wish : dark ? "dark" : "light";
  root.classList.toggle("wall", new URLSearchParams(location.search).has("wall"));
})();
