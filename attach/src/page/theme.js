"use strict";
// Light or dark: as the computer has it, or as was chosen here. Canvases draw anew at `themechange`.
// In the head of the page, so that nothing is drawn in the wrong colours first.

(() => {
  const KEY = "servocrab-theme";
  const NEXT = { auto: "light", light: "dark", dark: "auto" };
  const dark = matchMedia("(prefers-color-scheme: dark)");
  let chosen = "auto";
  try {
    chosen = localStorage.getItem(KEY) ?? "auto";
  } catch {
    // A browser that keeps nothing has the theme of the computer.
  }
  if (!(chosen in NEXT)) chosen = "auto";

  function apply() {
    const isDark = chosen === "auto" ? dark.matches : chosen === "dark";
    document.documentElement.dataset.theme = isDark ? "dark" : "light";
    document.documentElement.dataset.chosen = chosen;
    const button = document.getElementById("theme");
    if (button) button.setAttribute("aria-label", `Theme: ${chosen}`);
    dispatchEvent(new Event("themechange"));
  }

  function next() {
    chosen = NEXT[chosen];
    try {
      localStorage.setItem(KEY, chosen);
    } catch {
      // It holds until the page is left.
    }
    apply();
  }

  dark.addEventListener("change", apply);
  document.addEventListener("DOMContentLoaded", () => {
    document.getElementById("theme").addEventListener("click", next);
    apply();
  });
  apply();
})();
