import { post, remove } from "../api";
import { button, menu } from "./buttons";
import { h } from "./dom";
import { toast } from "./toast";

type Kind = "recordings" | "results";

/** What can be done with a recording or a result in a list: rename it; delete a result. */
export function itemMenu(kind: Kind, item: { id: string; name: string; path: string }, changed: () => void, more: HTMLElement[] = []): HTMLElement {
  return menu(
    "",
    () => [
      { label: "Rename", act: () => rename(kind, item, changed) },
      ...(kind === "results" ? [{ label: "Delete", hint: "for good", act: () => void erase(item, changed) }] : []),
      ...more,
    ],
    { icon: "more", kind: "quiet", title: `More about ${item.path}` },
  );
}

/** Deletes a result when the user confirms it; whether it is gone. */
export async function erase(item: { id: string; name: string; path: string }, changed: () => void): Promise<boolean> {
  if (!confirm(`Delete the folder ${item.path} with all that is in it, for good?`)) return false;
  try {
    await remove(item.id);
    toast(`${item.name} is deleted.`, "said");
    changed();
    return true;
  } catch (error) {
    toast((error as Error).message, "error");
    return false;
  }
}

function rename(kind: Kind, item: { id: string; name: string }, changed: () => void): void {
  const name = h("input", { type: "text", value: item.name, maxlength: 80, pattern: "[A-Za-z0-9_.\\-]+", required: true, "aria-label": "New name" });
  const go = button("Rename", () => undefined, { kind: "primary" });
  go.type = "submit";
  const dialog = h("dialog", { "aria-label": `Rename ${item.name}` });
  const form = h("form", { class: "rename" }, h("h2", {}, `Rename ${item.name}`), name, h("div", { class: "row end" }, button("Cancel", () => dialog.close()), go));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    post(`/api/${kind}/${item.id}/name`, { name: name.value })
      .then(() => {
        dialog.close();
        changed();
      })
      .catch((error: Error) => toast(error.message, "error"));
  });
  dialog.addEventListener("close", () => dialog.remove());
  dialog.append(form);
  document.body.append(dialog);
  dialog.showModal();
  name.select();
}
