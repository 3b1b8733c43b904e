/** The cards of all robots together: in the gateway's order, and none touched that stays. */

import { el } from "./dom.js";

/** Put the cards `after` where those of `before` lie; both by name. `watch` observes those that are in the page. */
export function lay(deck, before, after, watch) {
  for (const [name, card] of before) {
    if (after.get(name) === card) continue;
    watch.unobserve(card.root);
    card.root.remove();
  }
  for (const empty of deck.querySelectorAll(":scope > .empty")) empty.remove();
  let at = deck.firstElementChild;
  for (const [name, card] of after) {
    if (card.root === at) at = at.nextElementSibling;
    else deck.insertBefore(card.root, at);
    if (before.get(name) !== card) watch.observe(card.root);
  }
}

/** Say why there are no cards. */
export function sayNone(deck, hasToken) {
  if (deck.firstElementChild) return;
  const text = hasToken ? "There are no robots that this token may see." : "No robots are configured.";
  deck.append(el("p", { class: "empty", text }));
}
