import { remove } from "../api";
import { menu } from "./buttons";
import { toast } from "./toast";

/** What can be done with a result in a list: more, and delete it. */
export function itemMenu(item: { id: string; name: string; path: string }, changed: () => void, more: HTMLElement[]): HTMLElement {
  return menu(
    "",
    () => [...more, { label: "Delete", hint: "for good", act: () => void erase(item, changed) }],
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
