import { button } from "./buttons";
import { memory } from "./dom";
import { icon } from "./icons";

export type Theme = "dark" | "light";
const changed = new Set<() => void>();

export function theme(): Theme {
  return document.documentElement.dataset["theme"] === "light" ? "light" : "dark";
}

/** As chosen before; else as the computer is set, also when that changes. */
export function startTheme(): void {
  const light = matchMedia("(prefers-color-scheme: light)");
  const follow = (): void => setTheme((memory.get("theme") as Theme | null) ?? (light.matches ? "light" : "dark"), false);
  light.addEventListener("change", follow);
  follow();
}

export function setTheme(value: Theme, keep = true): void {
  document.documentElement.dataset["theme"] = value;
  if (keep) memory.set("theme", value);
  for (const call of changed) call();
}

/** Calls back when colours change, for what is drawn on canvases; returns how to stop. */
export function onTheme(call: () => void): () => void {
  changed.add(call);
  return () => changed.delete(call);
}

/** The value of a colour variable of theme.css, as "#rrggbb" or "rgb(...)". */
export function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

export function themeButton(): HTMLButtonElement {
  const one = button("", () => setTheme(theme() === "dark" ? "light" : "dark"), {
    kind: "quiet",
    title: "Dark or light",
    icon: "sun",
  });
  const show = (): void => one.replaceChildren(icon(theme() === "dark" ? "sun" : "moon"));
  onTheme(show);
  show();
  return one;
}
