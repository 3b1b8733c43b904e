// Sets the theme before the first paint: this file is no module, so that the page never flashes.
{
  const root = document.documentElement;
  try {
    const chosen = localStorage.getItem("theme");
    if (chosen === "light" || chosen === "dark") root.dataset.chosen = chosen;
  } catch {
    // no storage: the system's theme
  }
  root.dataset.theme = root.dataset.chosen ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
}
