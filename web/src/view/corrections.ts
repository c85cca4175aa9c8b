import type { ViewData } from "../lib/bundle";
import type { ResultEntry, State } from "../protocol";
import { menu } from "../ui/buttons";
import { erase } from "../ui/library";
import { toast } from "../ui/toast";

interface Corrected {
  frame: number;
  since?: number;
  until: number;
  clicks: string;
  of: string;
}

/** The corrections that a result consists of: each can be opened again, and the last one undone. Null when there are none. */
export function correctionsMenu(data: ViewData, entry: ResultEntry, state: State): HTMLElement | null {
  const list = (data.header.provenance["corrections"] ?? []) as Corrected[];
  if (!list.length || !entry.recording) return null;
  const siblings = state.results.filter((r) => r.recording === entry.recording);
  const before = (name: string): ResultEntry | undefined => siblings.find((r) => r.name === name);
  const last = list[list.length - 1]!;
  const old = before(last.of);
  return menu(
    "Corrected",
    () => [
      ...list.map((c) => ({
        label: `Frame ${c.frame} of ${c.of}`,
        hint: `tracked again from ${c.since ?? c.frame} to ${c.until - 1}; open it again`,
        act: () => {
          const of = before(c.of);
          if (of) location.hash = `#/view/${of.id}/${c.frame - data.header.first_frame}/${encodeURIComponent(c.clicks)}`;
          else toast(`${c.of} is not there any more, so its correction cannot be opened.`, "error");
        },
      })),
      ...(old ? [{ label: `Undo: back to ${old.name}`, hint: `${entry.name} is deleted`, act: () => void undo(entry, old, last.frame - data.header.first_frame) }] : []),
    ],
    { icon: "edit", kind: "quiet", title: "What was corrected in this result" },
  );
}

async function undo(entry: ResultEntry, old: ResultEntry, row: number): Promise<void> {
  if (await erase(entry, () => undefined)) location.hash = `#/view/${old.id}/${row}`;
}
