import { h } from "../ui/dom";

/** The two kinds of live tracking, as links; active: the one that is shown. */
export function kinds(active: "sensors" | "cameras"): HTMLElement {
  const link = (kind: "sensors" | "cameras", label: string, to: string): HTMLElement => h("a", { class: "button", href: to, "aria-current": kind === active ? "page" : null }, label);
  return h("nav", { class: "row", "aria-label": "Kinds of sensors" }, link("sensors", "Depth sensors", "#/live"), link("cameras", "Cameras", "#/live/cameras"));
}
