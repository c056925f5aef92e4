// One line that says what to do now: of all that is present, the cause that stands first in the list.
import { explain } from "./alarm_texts.js";
import { list_shown } from "./alarms.js";
import { $, set_text } from "./dom.js";
import { store } from "./store.js";
import { format_number, t } from "./texts.js";

function render() {
  const line = $("now");
  const is_known = store.link === "live" || store.link === "stale";
  const to_do = list_shown().filter(({ state, severity }) => (state === "raised" || state === "acknowledged") && severity !== "info");
  // without a current measurement and without an alarm the banner says what is wrong
  line.hidden = !store.state || !is_known || Boolean(store.state.maintenance) || (!to_do.length && store.link !== "live");
  if (line.hidden) return;
  const [first] = to_do;
  line.dataset.severity = first ? first.severity : "good";
  set_text(line.firstChild, t(first ? "now.do" : "now.nothing"));
  const others = to_do.length > 1 ? ` ${t("now.then", { count: format_number(to_do.length - 1) })}` : "";
  set_text(line.lastChild, first ? ` ${first.title}. ${explain(first)}${others}` : "");
}

export function start() {
  for (const subject of ["state", "link", "texts", "page"]) store.on(subject, render);
}
