/** The way in: where the gateway asks for a token, the page asks the operator, and shows nothing before it is let in. */

import { isToken } from "./client.js";
import { mark, write } from "./dom.js";

const KEPT = "robot-gateway token"; // in the storage of this tab, which ends with it
const WITHDRAWN = "robot-gateway token withdrawn";
const ASKED = "api/v1/robots";
const REFUSED = 401;
const PATIENCE_MS = 4000;

/** Whether the gateway lets a token in (null: none): "in", "refused", or "silent" where nobody answers. */
export async function knock(token) {
  const headers = token === null ? {} : { Authorization: `Bearer ${token}` };
  try {
    const answer = await fetch(ASKED, { headers, cache: "no-store", signal: AbortSignal.timeout(PATIENCE_MS) });
    await answer.arrayBuffer(); // or the browser counts it as broken off
    return answer.status === REFUSED ? "refused" : "in";
  } catch {
    return "silent";
  }
}

/**
 * A token that the gateway lets in; null where it asks for none, or does not answer yet.
 *
 * `page` has the elements: section, form, token, keep, error, chip.
 */
export async function enter(page) {
  const kept = recall(KEPT);
  if ((await knock(kept)) !== "refused") return kept;
  const withdrawn = kept !== null || recall(WITHDRAWN) !== null;
  forget();
  return ask(page, withdrawn ? "The gateway does not take the token of this tab any more: its token was changed or withdrawn." : null);
}

/** Begin again without a token: the page is loaded anew, so that nothing of what it has shown stays behind. */
export function leave({ withdrawn = false } = {}) {
  forget();
  if (withdrawn) keep(WITHDRAWN, "yes");
  location.reload();
}

function ask(page, error) {
  document.body.classList.add("is-locked");
  page.section.hidden = false;
  write(page.chip, "Token needed");
  mark(page.chip, "data-tone", "warn");
  tell(page, error);
  page.token.focus();
  return new Promise((resolve) => {
    let busy = false;
    page.form.addEventListener("submit", async (event) => {
      event.preventDefault();
      if (busy) return;
      busy = true;
      const token = page.token.value.trim();
      const wrong = await refusal(token);
      busy = false;
      tell(page, wrong);
      if (wrong) return page.token.select();
      if (page.keep.checked) keep(KEPT, token);
      page.token.value = "";
      page.section.hidden = true;
      document.body.classList.remove("is-locked");
      resolve(token);
    });
  });
}

/** What is wrong with a token, in words; null: nothing. */
async function refusal(token) {
  if (!token) return "Enter the token.";
  if (!isToken(token)) return "This is no token: a token is one word without blanks, such as rgw_…";
  const found = await knock(token);
  if (found === "refused") return "The gateway does not know this token. Compare it with the one that you were given.";
  return found === "silent" ? "The gateway does not answer. Try again in a moment." : null;
}

function tell(page, text) {
  write(page.error, text ?? "");
  page.error.hidden = !text;
  mark(page.token, "aria-invalid", text ? "true" : null);
}

function recall(key) {
  try {
    return sessionStorage.getItem(key);
  } catch {
    return null; // no storage
  }
}

function keep(key, value) {
  try {
    sessionStorage.setItem(key, value);
  } catch {
    // no storage: it lasts as long as the page
  }
}

function forget() {
  try {
    for (const key of [KEPT, WITHDRAWN]) sessionStorage.removeItem(key);
  } catch {
    // no storage: nothing is kept
  }
}
