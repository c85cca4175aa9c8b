/** Folders with a file per frame, or with the photos of one camera: each is sent as one file, a tar archive. */
import type { DroppedFile } from "./dropped";

const IMAGE = /\.(png|jpe?g|bmp|tiff?|webp)$/i;
/** Pictures and tables of which a folder has one per frame. */
const NUMBERED = /\d{3,}(_keypoints)?\.(png|jpe?g|bmp|tiff?|webp|json|txt)$/i;
const BLOCK = 512;

/** The files with those of such folders as one file each, which has the folder's path. */
export function packed(files: readonly DroppedFile[]): DroppedFile[] {
  const folders = new Map<string, DroppedFile[]>();
  for (const f of files) folders.set(parent(f.path), [...(folders.get(parent(f.path)) ?? []), f]);
  // photos of one camera in a folder of their own, beside those of the others
  const photos = [...folders].filter(([path, list]) => path && list.length > 1 && list.every((f) => IMAGE.test(f.path))).map(([path]) => path);
  const out: DroppedFile[] = [];
  for (const [path, list] of folders) {
    const numbered = list.filter((f) => NUMBERED.test(f.path));
    const beside = photos.includes(path) && photos.filter((p) => parent(p) === parent(path)).length > 1;
    const together = !path ? [] : beside ? list : numbered.length > 2 ? numbered : [];
    out.push(...list.filter((f) => !together.includes(f)));
    if (together.length) out.push({ file: archive(path.split("/").pop() ?? "folder", together), path });
  }
  return out;
}

function parent(path: string): string {
  return path.split("/").slice(0, -1).join("/");
}

/** A tar archive of files under their bare names. Nothing is read here: the browser does while it sends. */
function archive(name: string, files: readonly DroppedFile[]): File {
  const parts: BlobPart[] = [];
  const sorted = [...files].sort((a, b) => (a.path < b.path ? -1 : 1));
  for (const { file } of sorted) parts.push(head(file), file, new Uint8Array((BLOCK - (file.size % BLOCK)) % BLOCK));
  parts.push(new Uint8Array(2 * BLOCK));
  return new File(parts, `${name}.folder`, { lastModified: Math.max(...files.map((f) => f.file.lastModified)) });
}

function head(file: File): Uint8Array<ArrayBuffer> {
  const block = new Uint8Array(BLOCK);
  const put = (text: string, at: number): void => block.set(new TextEncoder().encode(text), at);
  put(file.name.replace(/[^\x20-\x7e]/g, "_").slice(-99), 0);
  put("0000644\0", 100);
  put("0000000\0".repeat(2), 108);
  put(`${file.size.toString(8).padStart(11, "0")}\0`, 124);
  put("00000000000\0", 136);
  put("        0", 148);
  put("ustar\x0000", 257);
  put(`${block.reduce((sum, b) => sum + b, 0).toString(8).padStart(6, "0")}\0 `, 148);
  return block;
}
