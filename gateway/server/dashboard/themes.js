/** The button that chooses between light, dark, and what the system prefers; `theme.js` has set it before the first paint. */

import { write } from "./dom.js";

const THEMES = ["system", "light", "dark"];
const dark = matchMedia("(prefers-color-scheme: dark)");
const root = document.documentElement;

/** Let the button choose; `recolour` is called when the colours have changed. */
export function themes(button, recolour) {
  const show = () => {
    const chosen = root.dataset.chosen ?? "system";
    root.dataset.theme = chosen === "system" ? (dark.matches ? "dark" : "light") : chosen;
    write(button, `Theme: ${chosen}`);
    recolour();
  };
  button.addEventListener("click", () => {
    const next = THEMES[(THEMES.indexOf(root.dataset.chosen ?? "system") + 1) % THEMES.length];
    root.dataset.chosen = next;
    try {
      localStorage.setItem("theme", next);
    } catch {
      // no storage: it lasts as long as the page
    }
    show();
  });
  dark.addEventListener("change", show);
  show();
}
