/** Files as they are dropped: single ones, or whole folders with all that lies in them. */

export interface DroppedFile {
  file: File;
  /** With the folders it was dropped with, "walk/videos/cam1.mp4"; a file by itself has only its name. */
  path: string;
}

const MOST = 5000;

/** All files of a drop; what lies in folders comes with its path. */
export async function filesOf(transfer: DataTransfer): Promise<DroppedFile[]> {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.() ?? null);
  const plain = [...transfer.files];
  if (entries.every((e) => e === null)) return plain.map((file) => ({ file, path: file.name }));
  const found: DroppedFile[] = [];
  for (const entry of entries) if (entry) await gather(entry, found);
  return found.filter(({ path }) => !path.split("/").some((part) => part.startsWith(".")));
}

/** Files of a file input, which may have chosen a folder. */
export function filesOfInput(input: HTMLInputElement): DroppedFile[] {
  return [...(input.files ?? [])]
    .map((file) => ({ file, path: file.webkitRelativePath || file.name }))
    .filter(({ path }) => !path.split("/").some((part) => part.startsWith(".")));
}

async function gather(entry: FileSystemEntry, found: DroppedFile[]): Promise<void> {
  if (found.length >= MOST) return;
  if (entry.isFile) {
    const file = await new Promise<File>((done, failed) => (entry as FileSystemFileEntry).file(done, failed));
    found.push({ file, path: entry.fullPath.replace(/^\//, "") });
    return;
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  for (;;) {
    // a folder tells its entries a hundred at a time, until there are none
    const some = await new Promise<FileSystemEntry[]>((done, failed) => reader.readEntries(done, failed));
    if (!some.length) return;
    for (const one of some) await gather(one, found);
  }
}

let waiting: DroppedFile[] = [];
let taker: ((files: DroppedFile[]) => void) | null = null;

/** Files may be dropped anywhere on the page: the form for a new recording takes them, and is opened for them. */
export function takeDrops(): void {
  let depth = 0;
  const over = (on: boolean): void => void document.body.toggleAttribute("data-over", on);
  const carries = (event: DragEvent): boolean => event.dataTransfer?.types.includes("Files") ?? false;
  document.addEventListener("dragenter", (event) => carries(event) && over(++depth > 0));
  document.addEventListener("dragleave", (event) => carries(event) && over(--depth > 0));
  document.addEventListener("dragover", (event) => carries(event) && event.preventDefault());
  document.addEventListener("drop", (event) => {
    if (!carries(event) || !event.dataTransfer) return;
    event.preventDefault();
    over((depth = 0) > 0);
    void filesOf(event.dataTransfer).then((files) => {
      if (taker) return taker(files);
      waiting.push(...files);
      location.hash = "#/setup";
    });
  });
}

/** Takes what is dropped, and what has been before; returns how to stop. */
export function onDrop(take: (files: DroppedFile[]) => void): () => void {
  taker = take;
  if (waiting.length) take(waiting);
  waiting = [];
  return () => {
    if (taker === take) taker = null;
  };
}
