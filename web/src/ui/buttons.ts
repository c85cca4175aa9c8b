import { h } from "./dom";
import { icon, type IconName } from "./icons";

export interface ButtonOptions {
  icon?: IconName;
  /** "primary": the one thing to do next; "quiet": without a frame. */
  kind?: "primary" | "quiet";
  /** Shown when the pointer rests on it, with its key; also the name of a button that shows an icon only. */
  title?: string;
  key?: string;
}

/** After a click with the pointer the keys steer the screen again, not the button; with the keyboard the focus stays. */
function letGo(event: Event): void {
  if ((event as MouseEvent).detail > 0) (event.currentTarget as HTMLElement).blur();
}

/** A button with text, an icon, or both. */
export function button(text: string, act: (event: Event) => void, options: ButtonOptions = {}): HTMLButtonElement {
  const title = options.title ?? "";
  const tip = [title, options.key && `(${options.key})`].filter(Boolean).join(" ");
  return h(
    "button",
    {
      type: "button",
      class: ["button", options.kind ?? "", text ? "" : "only-icon"].filter(Boolean).join(" "),
      title: tip || null,
      "aria-label": text || title,
      "aria-keyshortcuts": options.key ?? null,
      onclick: (event: Event) => {
        letGo(event);
        act(event);
      },
    },
    options.icon ? icon(options.icon) : null,
    text ? h("span", {}, text) : null,
  );
}

export interface Toggle {
  element: HTMLButtonElement;
  on: boolean;
  set(on: boolean): void;
}

/** A button that stays pressed. */
export function toggle(text: string, on: boolean, changed: (on: boolean) => void, options: ButtonOptions = {}): Toggle {
  const self: Toggle = {
    element: button(text, () => {
      self.set(!self.on);
      changed(self.on);
    }, options),
    on,
    set(value) {
      self.on = value;
      self.element.setAttribute("aria-pressed", String(value));
    },
  };
  self.element.classList.add("toggle");
  self.set(on);
  return self;
}

export interface Choice<T> {
  value: T;
  label: string;
}

/** A drop-down list of few choices. */
export function select<T extends string | number>(
  label: string,
  choices: readonly Choice<T>[],
  value: T,
  changed: (value: T) => void,
): HTMLSelectElement {
  const element = h(
    "select",
    { "aria-label": label, title: label },
    ...choices.map((c) => h("option", { value: c.value, selected: c.value === value }, c.label)),
  );
  element.addEventListener("change", () => {
    const chosen = choices[element.selectedIndex];
    if (chosen) changed(chosen.value);
    element.blur(); // keys then steer the screen again, not the list
  });
  return element;
}

/** A button that opens a list of actions below it; Escape and a click elsewhere close it. */
export function menu(
  text: string,
  entries: () => (HTMLElement | { label: string; hint?: string; act: () => void })[],
  options: ButtonOptions = {},
): HTMLElement {
  const list = h("div", { class: "menu-list", role: "menu", hidden: true });
  const opener = button(text, () => (list.hidden ? open() : close()), options);
  if (text) opener.append(icon("chevron"));
  opener.setAttribute("aria-haspopup", "menu");
  const box = h("div", { class: "menu" }, opener, list);
  const outside = (event: Event): void => {
    if (!box.contains(event.target as Node)) close();
  };
  const keys = (event: KeyboardEvent): void => {
    const items = [...list.querySelectorAll<HTMLElement>("[role=menuitem]")];
    const at = items.indexOf(document.activeElement as HTMLElement);
    if (event.key === "Escape") {
      close();
      opener.focus();
    } else if (event.key === "ArrowDown") items[(at + 1) % items.length]?.focus();
    else if (event.key === "ArrowUp") items[(at - 1 + items.length) % items.length]?.focus();
    else return;
    event.preventDefault();
    event.stopPropagation();
  };
  function open(): void {
    list.replaceChildren(
      ...entries().map((entry) => {
        if (entry instanceof HTMLElement) return entry;
        return h(
          "button",
          {
            type: "button",
            role: "menuitem",
            onclick: () => {
              close();
              entry.act();
            },
          },
          h("span", {}, entry.label),
          entry.hint ? h("small", {}, entry.hint) : null,
        );
      }),
    );
    list.hidden = false;
    opener.setAttribute("aria-expanded", "true");
    list.querySelector<HTMLElement>("[role=menuitem]")?.focus();
    document.addEventListener("pointerdown", outside);
  }
  function close(): void {
    list.hidden = true;
    opener.setAttribute("aria-expanded", "false");
    document.removeEventListener("pointerdown", outside);
  }
  box.addEventListener("keydown", keys);
  opener.setAttribute("aria-expanded", "false");
  return box;
}

/** Tabs over panels of which one is shown; arrow keys move between them. */
export function tabs(
  label: string,
  entries: readonly { name: string; label: string }[],
  changed: (name: string) => void,
): { element: HTMLElement; show: (name: string) => void } {
  const buttons = entries.map((e) =>
    h("button", { type: "button", role: "tab", class: "tab", "data-tab": e.name, onclick: (event: Event) => choose(event, e.name) }, e.label),
  );
  const element = h("div", { class: "tabs", role: "tablist", "aria-label": label }, ...buttons);
  element.addEventListener("keydown", (event) => {
    const at = buttons.indexOf(document.activeElement as HTMLButtonElement);
    const step = event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0;
    if (at < 0 || !step) return;
    const next = buttons[(at + step + buttons.length) % buttons.length];
    next?.focus();
    next?.click();
    event.preventDefault();
    event.stopPropagation();
  });
  function choose(event: Event, name: string): void {
    letGo(event);
    show(name);
  }
  function show(name: string): void {
    for (const b of buttons) {
      const chosen = b.dataset["tab"] === name;
      b.setAttribute("aria-selected", String(chosen));
      b.tabIndex = chosen ? 0 : -1;
    }
    changed(name);
  }
  return { element, show };
}
