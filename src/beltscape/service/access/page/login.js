import { $ } from "/page/script/dom.js";
import { ask, form, furnish, next } from "/access/door.js";

await furnish();
const state = await ask("GET", "/api/access/state").catch(() => ({}));
if (state.setup) location.replace("/setup");
else if (state.named) location.replace(next());

form($("login"), async ({ name, password }) => {
  try {
    await ask("POST", "/api/access/login", { name, password });
  } catch (error) {
    const field = $("login").elements.password;
    field.value = "";
    field.focus();
    throw error;
  }
  location.replace(next());
});
