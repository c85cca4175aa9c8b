import { h } from "./dom";
import { icon } from "./icons";

/** Says something for a few seconds in the corner; errors stay until they are closed, offers for half a minute. */
export function toast(text: string, kind: "said" | "error" | "done" = "said", action?: { label: string; act: () => void }): void {
  let box = document.querySelector<HTMLElement>(".toasts");
  if (!box) {
    box = h("div", { class: "toasts", role: "status", "aria-live": "polite" });
    document.body.append(box);
  }
  const one = h(
    "div",
    { class: `toast ${kind}` },
    kind === "error" ? icon("warning") : kind === "done" ? icon("done") : null,
    h("span", {}, text),
    action ? h("button", { type: "button", class: "button", onclick: () => { one.remove(); action.act(); } }, action.label) : null,
    h("button", { type: "button", class: "button quiet only-icon", "aria-label": "Close", onclick: () => one.remove() }, icon("close")),
  );
  box.append(one);
  while (box.children.length > 4) box.firstElementChild?.remove();
  if (kind !== "error") setTimeout(() => one.remove(), action ? 30_000 : 6000);
}
