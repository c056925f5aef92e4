import { $ } from "/page/script/dom.js";
import { t } from "/page/script/texts.js";
import { ask, form, furnish, weak } from "/access/door.js";

await furnish();
const state = await ask("GET", "/api/access/state").catch(() => ({ setup: true }));
if (!state.setup) location.replace("/login");

form($("setup"), async ({ token, name, password, again }) => {
  const problem = weak(password, again, name);
  if (problem) throw new Error(problem);
  try {
    await ask("POST", "/api/access/setup", { token, name, password });
  } catch (error) {
    throw error.status === 409 && error.message.includes("setup token") ? new Error(t("access.token_wrong")) : error;
  }
  location.replace("/");
});
