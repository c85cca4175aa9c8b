import { h, put } from "./dom";
import { icon, type IconName } from "./icons";
import { themeButton } from "./theme";

export type ScreenName = "view" | "gesture" | "click" | "setup" | "live";

const SCREENS: readonly { name: ScreenName; label: string; icon: IconName }[] = [
  { name: "view", label: "View", icon: "skeleton" },
  { name: "setup", label: "Set up", icon: "camera" },
  { name: "click", label: "Click to start", icon: "plus" },
  { name: "gesture", label: "Gestures", icon: "hand" },
  { name: "live", label: "Live", icon: "play" },
];

const MARK =
  '<path d="M5 3.500v13M15 3.500v13M5 10.500c3.300-2.600 6.700-2.600 10 0" fill="none" stroke="currentColor" stroke-width="2" ' +
  'stroke-linecap="round"/><circle cx="10" cy="4" r="2" fill="currentColor"/>';

/** The bar at the top of every screen, and the box below it that the screen fills. tools: what a screen adds. */
export function shell(root: HTMLElement, active: ScreenName, ...tools: HTMLElement[]): HTMLElement {
  const mark = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  mark.setAttribute("viewBox", "0 0 20 20");
  mark.setAttribute("aria-hidden", "true");
  mark.innerHTML = MARK;
  // names of their own: on small screens the words are not shown
  const brand = h("a", { class: "brand", href: "#/view", "aria-label": "hypose" });
  put(brand, mark, h("span", {}, "hypose"));
  const bar = h(
    "header",
    { class: "bar" },
    brand,
    h(
      "nav",
      { "aria-label": "Screens" },
      ...SCREENS.map((s) =>
        h(
          "a",
          { href: `#/${s.name}`, "aria-label": s.label, title: s.label, "aria-current": s.name === active ? "page" : null },
          icon(s.icon),
          h("span", {}, s.label),
        ),
      ),
    ),
    h("span", { class: "grow" }),
    ...tools,
    themeButton(),
  );
  const box = h("main", { class: "screen", "data-screen": active });
  root.replaceChildren(bar, box);
  return box;
}
