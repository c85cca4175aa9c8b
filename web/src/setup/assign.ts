/**
 * Which file of a folder belongs to which camera. What a file is and whose it is follows from the names of all of them
 * together, never from their order; what the names do not tell stays open for the user to say.
 */

export type Role = "video" | "background" | "masks" | "keypoints" | "board" | "calibration" | "none";
export type Kind = "video" | "image" | "images" | "keypoints" | "calibration" | "other";
/** Roles of which every camera has one file at most. */
export const OF_A_CAMERA: readonly Role[] = ["video", "background", "masks", "keypoints", "board"];

/** A file; path: with the folders it lies in; role: what the user has said that it is. */
export interface Seen {
  path: string;
  kind: Kind;
  role?: Role | undefined;
  /** Of a calibration: the cameras that it calibrates. */
  cameras?: readonly string[] | undefined;
}

/** camera: "" while it is not known. */
export interface Assigned {
  role: Role;
  camera: string;
}

/** Words that people put into names of pictures and clips of a room without anybody in it, of masks, and of a board. */
const EMPTY_ROOM = new Set(["background", "backgrounds", "bg", "empty", "emptyroom", "plate", "plates", "cleanplate"]);
const MASKS = new Set(["mask", "masks", "silhouette", "silhouettes", "segmentation", "matte"]);
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

/** For each file what it is for and its camera, whatever their order. cameras: those of the calibration; without one
 * they are called as their videos are. */
export function assign(files: readonly Seen[], cameras: readonly string[]): Assigned[] {
  const calibrated = cameras.length > 0;
  const out = files.map((f): Assigned => ({ role: f.role ?? roleOf(f, calibrated), camera: "" }));
  const chosen = chosenCalibration(files);
  const offered = chosen === undefined ? calibrations(files) : [chosen];
  files.forEach((f, k) => {
    if (f.kind === "calibration" && !f.role && !offered.includes(k)) out[k]!.role = "none";
  });
  const names = calibrated ? cameras : camerasOf(files.map((f, k) => ({ path: f.path, role: out[k]!.role })));
  for (const role of OF_A_CAMERA) {
    const mine = out.flatMap((a, k) => (a.role === role ? [k] : []));
    const found = match(mine.map((k) => files[k]!.path), names);
    mine.forEach((k, i) => (out[k]!.camera = found[i] ?? ""));
  }
  return out;
}

/** The camera of each file of one kind; "" where the names do not tell. */
export function match(paths: readonly string[], cameras: readonly string[]): string[] {
  const found = paths.map((p) => named(p, cameras));
  return found.some((c) => c) ? found : told(paths, cameras);
}

/** Names of cameras that no calibration names yet: what tells their videos apart (their own names, those of the folders
 * they lie in, or what is left of these without what they have in common), so that as many other files as can be carry
 * the name of one of them. */
export function camerasOf(files: readonly { path: string; role: Role }[]): string[] {
  const first = (["video", "masks", "keypoints"] as const).find((role) => files.some((f) => f.role === role));
  const own = files.filter((f) => f.role === first).map((f) => f.path.replace(/\.[^./]*$/, "").split("/").reverse());
  if (!own.length) return [];
  const others = (["board", "background", "masks", "keypoints"] as const).filter((r) => r !== first).map((role) => files.filter((f) => f.role === role).map((f) => f.path));
  const offered: string[][] = [];
  for (let level = 0; own.every((parts) => parts.length > level); level++) {
    const names = own.map((parts) => parts[level]!);
    const short = shortened(names);
    // cam01 stays as it is written
    offered.push(...(names.some((n, k) => words(n).length > words(short[k]!).length) && short.every((s) => words(s).length > 1) ? [short, names] : [names, short]));
  }
  let best: string[] = [];
  let most = -1;
  for (const names of offered) {
    if (new Set(names).size < names.length || names.some((n) => !n)) continue;
    const score = others.reduce((sum, paths) => sum + new Set(match(paths, names).filter((c) => c)).size, 0);
    if (score > most) [best, most] = [names, score];
  }
  return best;
}

/** Names without what all of them begin and end with, but for a word for a camera: walk_cam1_hd is cam1. */
function shortened(names: readonly string[]): string[] {
  const { rest, before } = differences(names.map(words));
  const word = before !== undefined && CAMERA_WORDS.has(before) ? before : "";
  return rest.map((r) => (r ? word + r : ""));
}

/** Files that may be the calibration: those the user says, or all but those of one camera each, which say what another
 * was made of. */
function calibrations(files: readonly Seen[]): number[] {
  const all = files.flatMap((f, k) => (f.kind === "calibration" && (f.role ?? "calibration") === "calibration" ? [k] : []));
  const said = all.filter((k) => files[k]!.role);
  return said.length ? said : all.length > 1 ? all.filter((k) => files[k]!.cameras?.length !== 1) : all;
}

/** Which file is the calibration: the only one, or of several that lie in one folder, as of a Pose2Sim project, the
 * first. undefined where there is none, or where the user has to choose. */
export function chosenCalibration(files: readonly Seen[]): number | undefined {
  const mine = calibrations(files);
  const folder = (k: number): string => files[k]!.path.split("/").slice(0, -1).join("/");
  if (mine.length > 1 && (files[mine[0]!]!.role || new Set(mine.map(folder)).size > 1)) return undefined;
  const toml = (k: number): number => Number(/\.toml$/i.test(files[k]!.path));
  return [...mine].sort((a, b) => toml(b) - toml(a) || files[a]!.path.localeCompare(files[b]!.path))[0];
}

const CALLED: Record<Role, readonly [string, string]> = {
  video: ["video", "videos"], background: ["empty room", "empty rooms"], masks: ["video of masks", "videos of masks"],
  keypoints: ["set of key points", "sets of key points"], board: ["clip of the board", "clips of the board"], calibration: ["calibration", "calibrations"], none: ["", ""],
};

/** Why no recording can be made of the files yet, as a sentence; "" when it can. */
export function obstacle(files: readonly (Assigned & { name: string })[]): string {
  const of = (role: Role): (Assigned & { name: string })[] => files.filter((f) => f.role === role);
  const [calibrations, boards] = [of("calibration"), of("board")];
  const shown = files.filter((f) => f.role === "video" || f.role === "masks" || f.role === "keypoints");
  if (calibrations.length > 1) return `There are ${calibrations.length} calibrations; choose one, and set the others to “not used”.`;
  if (!shown.length) return "The videos are missing: choose a folder that holds one per camera.";
  for (const role of OF_A_CAMERA) {
    const mine = of(role);
    const [one, many] = CALLED[role];
    const open = mine.find((f) => !f.camera);
    if (open) return role === "background" ? `Of which camera is ${open.name} the empty room? Choose it, or set the file to “not used”.` : `Which camera is ${open.name} of? Choose it, or set the file to “not used”.`;
    const twice = repeated(mine);
    if (twice && role === "video") return `Two videos are of the camera ${twice}; choose another camera for one of them, or set it to “not used”.`;
    if (twice) return `There are two ${many} of the camera ${twice}; set one of them to “not used”.`;
    const alone = role === "background" || role === "board" ? mine.find((r) => !shown.some((v) => v.camera === r.camera)) : undefined;
    if (alone) return `${alone.name} is the ${one} of ${alone.camera}, which has no video; set the file to “not used”.`;
  }
  const bare = calibrations.length || !boards.length ? undefined : shown.find((f) => !boards.some((b) => b.camera === f.camera));
  return bare ? `There is no clip of the board of ${bare.camera}: add it, or set ${bare.name} to “not used”.` : "";
}

function repeated(files: readonly Assigned[]): string | undefined {
  return files.map((f) => f.camera).find((c, k, all) => all.indexOf(c) !== k);
}

function roleOf({ path, kind }: Seen, calibrated: boolean): Role {
  if (kind === "calibration" || kind === "keypoints") return kind;
  if (kind === "other") return "none";
  const said = path.split("/").flatMap(words);
  if (said.some((w) => EMPTY_ROOM.has(w))) return "background";
  // a picture that does not say that it is an empty room is one of a board or of the person, more often than not
  if (kind === "image") return "none";
  if (said.some((w) => MASKS.has(w))) return "masks";
  if (said.some((w) => CALIBRATING.has(w))) return calibrated ? "none" : "board";
  return "video";
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
