import { $ } from "../page/script/dom.js";
import { bind_form, get_next_page, request, set_up_page } from "./common.js";

await set_up_page();
const state = await request("GET", "api/access/state").catch(() => ({}));
if (state.setup) location.replace("setup");
else if (state.named) location.replace(get_next_page());

bind_form($("login"), async ({ name, password }) => {
  try {
    await request("POST", "api/access/login", { name, password });
  } catch (error) {
    const field = $("login").elements.password;
    field.value = "";
    field.focus();
    throw error;
  }
  location.replace(get_next_page());
});
