/** The cards of all robots together: in the gateway's order, none touched that stays; those of a plant under the name of their cell. */

import { el } from "./dom.js";

/** Put the cards `after` where those of `before` lie; both by name. `watch` observes those that are in the page. */
export function lay(deck, before, after, watch) {
  for (const [name, card] of before) {
    if (after.get(name) === card) continue;
    watch.unobserve(card.root);
    card.root.remove();
  }
  for (const old of deck.querySelectorAll(":scope > .empty, :scope > .cell-head")) old.remove();
  let at = deck.firstElementChild;
  for (const [name, card] of after) {
    if (card.root === at) at = at.nextElementSibling;
    else deck.insertBefore(card.root, at);
    if (before.get(name) !== card) watch.observe(card.root);
  }
  let group = "";
  for (const [name, card] of after) {
    const cell = name.slice(0, Math.max(0, name.indexOf("/"))); // of a plant: cell/robot
    if (cell !== group) deck.insertBefore(el("h3", { class: "cell-head", text: cell }), card.root);
    group = cell;
  }
}

/** Say why there are no cards. */
export function sayNone(deck, hasToken) {
  if (deck.firstElementChild) return;
  const text = hasToken ? "There are no robots that this token may see." : "No robots are configured.";
  deck.append(el("p", { class: "empty", text }));
}
