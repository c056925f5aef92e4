import { $ } from "../page/script/dom.js";
import { t } from "../page/script/texts.js";
import { bind_form, check_password, request, set_up_page } from "./common.js";

await set_up_page();
const state = await request("GET", "api/access/state").catch(() => ({ setup: true }));
if (!state.setup) location.replace("login");

bind_form($("setup"), async ({ token, name, password, again }) => {
  const problem = check_password(password, again, name);
  if (problem) throw new Error(problem);
  try {
    await request("POST", "api/access/setup", { token, name, password });
  } catch (error) {
    throw error.status === 409 && error.message.includes("setup token") ? new Error(t("access.token_wrong")) : error;
  }
  location.replace("./");
});
