import type { ViewData } from "../lib/bundle";
import { button } from "../ui/buttons";
import { h } from "../ui/dom";
import { channels } from "./panels";

/** Asks which channels are to be plotted, at most so many; null when it is to stay as it was. */
export function chooseChannels(data: ViewData, before: readonly string[], most: number): Promise<string[] | null> {
  const all = channels(data);
  const chosen = new Set(before.filter((id) => all.some((c) => c.id === id)));
  const groups = [...new Set(all.map((c) => c.group))];
  const told = h("p", { class: "dim", role: "status" });
  const boxes: HTMLInputElement[] = [];
  const update = (): void => {
    told.textContent = `${chosen.size} of at most ${most}`;
    for (const box of boxes) box.disabled = !box.checked && chosen.size >= most;
  };
  const dialog = h("dialog", { class: "channels", "aria-label": "What is plotted" });
  const box = (id: string, label: string): HTMLElement => {
    const input = h("input", { type: "checkbox", value: id, checked: chosen.has(id) });
    input.addEventListener("change", () => {
      if (input.checked) chosen.add(id);
      else chosen.delete(id);
      update();
    });
    boxes.push(input);
    return h("label", {}, input, label);
  };
  return new Promise((done) => {
    let answer: string[] | null = null;
    const form = h(
      "form",
      { method: "dialog" },
      h("h2", {}, "What is plotted"),
      told,
      h("div", { class: "channel-groups" }, ...groups.map((g) => h("fieldset", {}, h("legend", {}, g), ...all.filter((c) => c.group === g).map((c) => box(c.id, c.label))))),
      h(
        "div",
        { class: "row end" },
        button("Cancel", () => dialog.close()),
        button("Show them", () => {
          answer = [...chosen];
          dialog.close();
        }, { kind: "primary", icon: "done" }),
      ),
    );
    dialog.addEventListener("close", () => {
      dialog.remove();
      done(answer);
    });
    dialog.append(form);
    document.body.append(dialog);
    update();
    dialog.showModal();
  });
}
