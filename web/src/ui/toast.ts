import { h, plain } from "./dom";
import { icon } from "./icons";

/** Says something for a few seconds in the corner; errors stay until they are closed. */
export function toast(text: string, kind: "said" | "error" | "done" = "said"): void {
  let box = document.querySelector<HTMLElement>(".toasts");
  if (!box) {
    box = h("div", { class: "toasts", role: "status", "aria-live": "polite" });
    document.body.append(box);
  }
  const one = h(
    "div",
    { class: `toast ${kind}` },
    kind === "error" ? icon("warning") : kind === "done" ? icon("done") : null,
    h("span", {}, plain(text)),
    h("button", { type: "button", class: "button quiet only-icon", "aria-label": "Close", onclick: () => one.remove() }, icon("close")),
  );
  box.append(one);
  while (box.children.length > 4) box.firstElementChild?.remove();
  if (kind !== "error") setTimeout(() => one.remove(), 6000);
}
