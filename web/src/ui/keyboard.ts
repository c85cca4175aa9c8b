import { button } from "./buttons";
import { h } from "./dom";

export interface Key {
  /** As KeyboardEvent.key says it, "Shift+" before it where needed: " ", "ArrowLeft", "Shift+ArrowLeft", "f". */
  keys: readonly string[];
  /** How the help names the keys ("" = it does not) and what they do. */
  shown: string;
  what: string;
  act: () => void;
}

/**
 * Binds keys while a screen is open; typing into fields is left alone, and "?" shows them. Returns how to stop.
 * within: only while the pointer or the focus is in this element, for a screen that is part of a page to scroll.
 */
export function bindKeys(title: string, bindings: readonly Key[], within: HTMLElement | null = null): { stop: () => void; help: () => void } {
  const help = (): void => showKeys(title, bindings);
  const listen = (event: KeyboardEvent): void => {
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
    if (document.querySelector("dialog[open]")) return;
    if (within && !within.matches(":hover, :focus-within")) return;
    const target = event.target as HTMLElement;
    if (target.closest("input:not([type=range]):not([type=checkbox]), textarea, select, [contenteditable]")) return;
    const onButton = target.closest("button, a, summary") && (event.key === " " || event.key === "Enter");
    const name = (event.shiftKey && event.key.length > 1 ? "Shift+" : "") + event.key;
    const found = onButton ? undefined : bindings.find((b) => b.keys.includes(name));
    if (found) found.act();
    else if (name === "?") help();
    else return;
    event.preventDefault();
  };
  document.addEventListener("keydown", listen);
  return { stop: () => document.removeEventListener("keydown", listen), help };
}

function showKeys(title: string, bindings: readonly Key[]): void {
  const dialog = h(
    "dialog",
    { class: "help", "aria-label": `Keys: ${title}` },
    h("h2", {}, title),
    h(
      "dl",
      { class: "keys" },
      ...[...bindings.filter((b) => b.shown), { shown: "?", what: "this list" }].flatMap((b) => [
        h("dt", {}, ...b.shown.split(" ").map((k) => h("kbd", {}, k))),
        h("dd", {}, b.what),
      ]),
    ),
  );
  dialog.append(h("div", { class: "row end" }, button("Close", () => dialog.close(), { kind: "primary" })));
  dialog.addEventListener("close", () => dialog.remove());
  dialog.addEventListener("click", (e) => e.target === dialog && dialog.close());
  document.body.append(dialog);
  dialog.showModal();
}
