/**
 * Which dropped file belongs to which camera. What a file is and whose it is follows from the names of all of them
 * together, never from the order in which they arrive; what the names do not tell stays open for the user to say.
 */

export type Role = "video" | "background" | "calibration" | "none";

/** A file as it lies ready; path: with the folders it was dropped with; role: what the user has said that it is. */
export interface Seen {
  path: string;
  kind: "video" | "image" | "calibration" | "other";
  role?: Role | undefined;
}

/** camera: "" while it is not known. */
export interface Assigned {
  role: Role;
  camera: string;
}

/** Words that people put into names of pictures and clips of a room without anybody in it, and of those of a board. */
const EMPTY_ROOM = new Set(["background", "backgrounds", "bg", "empty", "emptyroom", "plate", "plates", "cleanplate"]);
const CALIBRATING = new Set([
  "calib", "calibration", "intrinsic", "intrinsics", "extrinsic", "extrinsics", "checkerboard", "chessboard", "charuco",
  "board", "boards", "checker",
]);
const CAMERA_WORDS = new Set(["cam", "c", "view", "v", "kamera"]);

/** `Cam_01` and `cam1` are both ["cam", "1"]: letters and numbers by themselves, in lower case, without zeros before. */
export function words(text: string): string[] {
  const apart = text.normalize("NFKD").replace(/(\p{Ll})(\p{Lu})/gu, "$1 $2"); // camA is cam and a
  const found = apart.toLowerCase().match(/\p{L}+|\p{N}+/gu) ?? [];
  return found.map((w) => (w === "camera" ? "cam" : w.replace(/^0+(?=\d)/, "")));
}

/** For each file what it is for and its camera, whatever their order. */
export function assign(files: readonly Seen[], cameras: readonly string[]): Assigned[] {
  const out = files.map((f): Assigned => ({ role: f.role ?? roleOf(f), camera: "" }));
  for (const role of ["video", "background"] as const) {
    const mine = out.flatMap((a, k) => (a.role === role ? [k] : []));
    for (const k of mine) out[k]!.camera = named(files[k]!.path, cameras);
    if (mine.some((k) => out[k]!.camera)) continue;
    const found = told(mine.map((k) => files[k]!.path), cameras);
    mine.forEach((k, i) => (out[k]!.camera = found[i] ?? ""));
  }
  return out;
}

/** Why no recording can be made of the files yet, as a sentence; "" when it can. */
export function obstacle(files: readonly (Assigned & { name: string })[]): string {
  const of = (role: Role): (Assigned & { name: string })[] => files.filter((f) => f.role === role);
  const [videos, rooms, calibrations] = [of("video"), of("background"), of("calibration")];
  if (!calibrations.length) return "The calibration is missing: drop the file that says where the cameras stand.";
  if (calibrations.length > 1) return `There are ${calibrations.length} calibrations; choose one, and set the others to “not used”.`;
  if (!videos.length) return "The videos are missing: drop one per camera.";
  const open = videos.find((f) => !f.camera);
  if (open) return `Which camera is ${open.name} of? Choose it, or set the file to “not used”.`;
  const twice = repeated(videos);
  if (twice) return `Two videos are of the camera ${twice}; choose another camera for one of them, or set it to “not used”.`;
  const room = rooms.find((f) => !f.camera);
  if (room) return `Of which camera is ${room.name} the empty room? Choose it, or set the file to “not used”.`;
  const both = repeated(rooms);
  if (both) return `There are two empty rooms of the camera ${both}; set one of them to “not used”.`;
  const alone = rooms.find((r) => !videos.some((v) => v.camera === r.camera));
  return alone ? `${alone.name} is the empty room of ${alone.camera}, which has no video; drop it, or set the file to “not used”.` : "";
}

function repeated(files: readonly Assigned[]): string | undefined {
  return files.map((f) => f.camera).find((c, k, all) => all.indexOf(c) !== k);
}

function roleOf({ path, kind }: Seen): Role {
  if (kind === "calibration") return "calibration";
  if (kind === "other") return "none";
  const said = path.split("/").flatMap(words);
  if (said.some((w) => EMPTY_ROOM.has(w))) return "background";
  // a picture that does not say that it is an empty room is one of a board or of the person, more often than not
  return kind === "video" && !said.some((w) => CALIBRATING.has(w)) ? "video" : "none";
}

/** The camera whose name a file carries, or else the folders it lies in, the nearest first; "" when none or several do. */
function named(path: string, cameras: readonly string[]): string {
  const parts = path.replace(/\.[^./]*$/, "").split("/").reverse();
  for (const part of parts) {
    const inside = words(part);
    const found = cameras
      .map((camera) => ({ camera, own: words(camera) }))
      .filter(({ own }) => own.length && (holds(inside, own) || (/\d/.test(inside.join("")) && inside.length > 1 && holds(own, inside))))
      .map(({ camera, own }) => ({ camera, length: joined(own).length, same: joined(own) === joined(inside) }))
      .sort((a, b) => Number(b.same) - Number(a.same) || b.length - a.length);
    const [best, second] = found;
    if (!best) continue;
    return second && second.same === best.same && second.length === best.length ? "" : best.camera;
  }
  return "";
}

/** Words as one text; numbers stay apart from each other, so that `cam1_1` is not `cam11`. */
function joined(list: readonly string[]): string {
  return list.reduce((text, w) => text + (/\d$/.test(text) && /^\d/.test(w) ? "." : "") + w, "");
}

/** Whether some of the words next to each other are the other words. */
function holds(list: readonly string[], part: readonly string[]): boolean {
  const wanted = joined(part);
  const bare = /^(\p{N}+|.)$/u.test(wanted);
  return list.some((_, i) => {
    // a mere number or letter is a camera's name after a word for a camera only: in take2 it counts something else
    if (bare && i > 0 && !CAMERA_WORDS.has(list[i - 1]!)) return false;
    return list.some((__, j) => j >= i && joined(list.slice(i, j + 1)) === wanted);
  });
}

/** Where no file says a camera's whole name: what the files differ in against what the cameras differ in (`view-2.mp4`,
 * `B.mp4` against cam1, cam2, camA, camB). All of the files or none of them. */
function told(paths: readonly string[], cameras: readonly string[]): string[] {
  const nothing = paths.map(() => "");
  if (!paths.length || paths.length > cameras.length || cameras.length < 2) return nothing;
  const own = differences(cameras.map(words));
  const theirs = differences(paths.map((p) => words(p.replace(/\.[^./]*$/, ""))));
  // a number after any other word counts something else: takes, or the files of one camera
  const before = theirs.before;
  if (before !== undefined && !CAMERA_WORDS.has(before)) return nothing;
  const found = theirs.rest.map((rest) => own.rest.flatMap((o, k) => (o === rest && o ? [cameras[k]!] : [])));
  if (found.some((f) => f.length !== 1) || new Set(found.flat()).size !== paths.length) return nothing;
  return found.flat();
}

/** Lists of words without what all of them begin and end with; before: the last word of that beginning. */
function differences(lists: readonly string[][]): { rest: string[]; before: string | undefined } {
  const shortest = Math.min(...lists.map((l) => l.length));
  let first = 0;
  let last = 0;
  while (first < shortest && lists.every((l) => l[first] === lists[0]![first])) first++;
  while (last < shortest - first && lists.every((l) => l[l.length - 1 - last] === lists[0]![lists[0]!.length - 1 - last])) last++;
  return { rest: lists.map((l) => joined(l.slice(first, l.length - last))), before: first ? lists[0]![first - 1] : undefined };
}
