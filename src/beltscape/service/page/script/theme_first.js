// Sets theme and layout before the first rendering, so that the page does not flash in the wrong ones.
(() => {
  const root = document.documentElement;
  const choice = new URLSearchParams(location.search).get("theme") || localStorage.getItem("theme");
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = choice === "light" || choice === "dark" ? choice : dark ? "dark" : "light";
  root.classList.toggle("wall", new URLSearchParams(location.search).has("wall"));
})();
