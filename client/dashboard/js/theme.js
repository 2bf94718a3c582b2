/**
 * Light or dark theme: that of the system until the user chooses one.
 *
 * This is a plain script and not a module, since modules run after the first paint: a dark page
 * would flash white.
 */
(() => {
  const KEY = "roundel-theme";
  const root = document.documentElement;
  const system = matchMedia("(prefers-color-scheme: dark)");

  // If storage is forbidden, the choice lasts as long as the page.
  const read = () => {
    try {
      return localStorage.getItem(KEY);
    } catch {
      return null;
    }
  };
  /** @param {string | null} theme */
  const write = (theme) => {
    try {
      if (theme === null) localStorage.removeItem(KEY);
      else localStorage.setItem(KEY, theme);
    } catch {
      // The choice is not stored.
    }
  };
  let chosen = read();
  const systemTheme = () => (system.matches ? "dark" : "light");

  const apply = () => {
    const theme = chosen === "light" || chosen === "dark" ? chosen : systemTheme();
    root.dataset.theme = theme;
    const other = theme === "dark" ? "light" : "dark";
    document.getElementById("theme")?.setAttribute("aria-label", `Switch to the ${other} theme`);
    document.dispatchEvent(new CustomEvent("themechange"));
  };

  apply();
  system.addEventListener("change", apply);
  document.addEventListener("DOMContentLoaded", () => {
    document.getElementById("theme")?.addEventListener("click", () => {
      const wanted = root.dataset.theme === "dark" ? "light" : "dark";
      // With the system's theme chosen, the page follows the system again.
      chosen = wanted === systemTheme() ? null : wanted;
      write(chosen);
      apply();
    });
    apply();
  });
})();
