/**
 * Light or dark: the system's choice, until the person makes one.
 *
 * A plain script in the head and not a module: modules run after the first paint, and a page that
 * flashes white before it turns dark is a nuisance in a dim lab.
 */
(() => {
  const KEY = "roundel-theme";
  const root = document.documentElement;
  const system = matchMedia("(prefers-color-scheme: dark)");

  // Storage can be forbidden; the choice then lasts as long as the page.
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
      // Nothing is lost but the memory of it.
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
      // Back at the system's own choice, the page follows the system again.
      chosen = wanted === systemTheme() ? null : wanted;
      write(chosen);
      apply();
    });
    apply();
  });
})();
