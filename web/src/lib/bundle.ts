/** The block of bytes that holds one result; hypose/app/studio/view_bundle.py writes it and says what is where. */

export type Numbers = Float32Array | Float64Array | Uint8Array | Uint16Array | Uint32Array;

export interface CameraData {
  name: string;
  K: number[][];
  distortion: number[];
  fisheye: boolean;
  camera_from_world: number[][];
  size: [number, number];
  image_shift: [number, number];
  pictures: boolean;
}

export interface Header {
  version: string;
  title: string;
  recipe: string;
  frames: number;
  frame_rate: number;
  first_frame: number;
  complete: boolean;
  summary: {
    frames: number;
    seconds: number;
    lost: number;
    extrapolated: number;
    iou: number | null;
    worst_iou: number | null;
    sd_mm: number | null;
  };
  joint_names: string[];
  parents: number[];
  floor: number;
  formats: string[];
  angles: { name: string; unit: string }[];
  cameras: CameraData[];
  subject: [string, number][];
  files: { name: string; what: string; bytes: number }[];
  notes: string[];
  citation: string;
  seconds: Record<string, number>;
  /** What is to be thought of it, in words; null when nothing has looked. */
  assessment: { word: "good" | "look" | "not to be trusted"; sentence: string } | null;
  truth: { names: string[]; parents: number[]; mean_mm: number | null; note: string } | null;
  provenance: Record<string, unknown>;
}

/** A skinned triangle mesh at rest, in the model frame. */
export interface MeshData {
  vertices: Float32Array;
  faces: Uint16Array | Uint32Array;
  skinIndex: Uint8Array;
  skinWeight: Float32Array;
}

/** Other poses that explain the same frame: weights (T, 1 + count), first that of the pose shown; joints (N, count, J, 3)
 * m, best first, of the rows that have another; at: where a row is in these, absent where it has none. NaN where a frame
 * has fewer. */
export interface Rivals {
  count: number;
  at: ReadonlyMap<number, number>;
  joints: Float32Array;
  weights: Float32Array;
}

export interface ViewData {
  header: Header;
  /** T: number of frames; J: of joints. */
  frames: number;
  joints: number;
  times: Float64Array;
  /** (T, J, 3) m, world. */
  positions: Float32Array;
  /** (T, J, 4) x y z w, world from joint; null when only positions are known. */
  rotations: Float32Array | null;
  /** (T, J) m per axis, NaN where not known. */
  sd: Float32Array;
  /** (T, J, 6) xx xy xz yy yz zz, m^2, world, NaN where not known. */
  covariance: Float32Array;
  rivals: Rivals | null;
  /** (T) 1 = lost, 2 = extrapolated, 3 = doubtful. */
  flags: Uint8Array;
  /** (T, J) 1 where the joint may be wrong; null when nothing has looked. */
  doubtful: Uint8Array | null;
  /** (T, J) percent: how likely the joint is wrong by more than 100 mm, 255 where not known. */
  wrong: Uint8Array | null;
  views: Uint8Array;
  /** (T) 1 - overlap with the masks. */
  cost: Float32Array;
  /** (A, T) degrees or metres. */
  angles: Float32Array | null;
  /** (A, T) standard deviation of each of them. */
  angleSd: Float32Array | null;
  fine: MeshData | null;
  coarse: MeshData | null;
  restJoints: Float32Array | null;
  /** (T', J', 3) m, world. */
  truth: Float32Array | null;
  /** (T', K) m. */
  truthDistances: Float32Array | null;
}

export const LOST = 1;
export const DOUBTFUL = 3;
/** What a flag of a frame is called; a colour of theme.css has the same name. */
export const flagName = (flag: number): "lost" | "extrapolated" | "doubtful" =>
  flag === LOST ? "lost" : flag === 2 ? "extrapolated" : "doubtful";

const KINDS = { f4: Float32Array, f8: Float64Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };
type Described = Record<string, { dtype: keyof typeof KINDS; shape: number[]; offset: number }>;

/** The result in a block; its arrays look into `buffer`, nothing is copied. Throws an Error when it is none. */
export function readBundle(buffer: ArrayBuffer): ViewData {
  const magic = new TextDecoder().decode(new Uint8Array(buffer, 0, Math.min(8, buffer.byteLength)));
  if (magic !== "HYPOSEV1") throw new Error("What the server sent is no result of this version; reload the page.");
  const length = new DataView(buffer).getUint32(8, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 12, length))) as Header & {
    arrays: Described;
  };
  const start = Math.ceil((12 + length) / 8) * 8;
  const arrays = new Map<string, Numbers>();
  for (const [name, { dtype, shape, offset }] of Object.entries(header.arrays)) {
    arrays.set(name, new KINDS[dtype](buffer, start + offset, shape.reduce((a, b) => a * b, 1)));
  }
  const get = <T extends Numbers>(name: string): T | null => (arrays.get(name) as T | undefined) ?? null;
  const need = <T extends Numbers>(name: string): T => {
    const found = get<T>(name);
    if (!found) throw new Error(`The result lacks its ${name}; reload the page.`);
    return found;
  };
  const mesh = (level: string): MeshData | null =>
    arrays.has(`${level}_vertices`)
      ? {
          vertices: need(`${level}_vertices`),
          faces: need(`${level}_faces`),
          skinIndex: need(`${level}_skin_index`),
          skinWeight: need(`${level}_skin_weight`),
        }
      : null;
  const covariance = need<Float32Array>("joint_covariance");
  const joints = header.joint_names.length;
  const rivals = get<Float32Array>("rival_joints");
  return {
    header,
    frames: header.frames,
    joints,
    times: need("times"),
    positions: need("joints"),
    rotations: get("rotations"),
    sd: perAxis(covariance),
    covariance,
    rivals: rivals && rivalsOf(rivals, need("rival_rows"), need("rival_weights"), header.frames),
    flags: need("flags"),
    doubtful: get("low_confidence_joints"),
    wrong: get("error_probability"),
    views: need("n_views"),
    cost: need("cost"),
    angles: get("angles"),
    angleSd: get("angle_sd"),
    fine: mesh("fine"),
    coarse: mesh("coarse"),
    restJoints: get("rest_joints"),
    truth: get("truth_joints"),
    truthDistances: get("truth_distances"),
  };
}

function rivalsOf(joints: Float32Array, rows: Uint32Array, weights: Float32Array, frames: number): Rivals {
  return { count: weights.length / frames - 1, at: new Map(Array.from(rows, (row, k) => [row, k])), joints, weights };
}

/** The joints (J, 3) of the k-th other pose of a row; null when it has no such. */
export function rivalJoints({ at, count, joints }: Rivals, row: number, k: number, size: number): Float32Array | null {
  const place = at.get(row);
  if (place === undefined) return null;
  const from = 3 * size * (place * count + k);
  return Number.isFinite(joints[from]!) ? joints.subarray(from, from + 3 * size) : null;
}

/** Root mean square over the axes of covariances (N, 6), xx xy xz yy yz zz. */
function perAxis(covariance: Float32Array): Float32Array {
  const sd = new Float32Array(covariance.length / 6);
  for (let i = 0; i < sd.length; i++) {
    sd[i] = Math.sqrt((covariance[6 * i]! + covariance[6 * i + 3]! + covariance[6 * i + 5]!) / 3);
  }
  return sd;
}

/** Stretches of frames [first, last] with the same flag other than 0. */
export interface Stretch {
  first: number;
  last: number;
  flag: number;
}

export function stretches(flags: Uint8Array): Stretch[] {
  const out: Stretch[] = [];
  for (let i = 0; i < flags.length; i++) {
    const flag = flags[i] as number;
    const open = out[out.length - 1];
    if (!flag) continue;
    if (open && open.flag === flag && open.last === i - 1) open.last = i;
    else out.push({ first: i, last: i, flag });
  }
  return out;
}

/** Stretches to look at: flagged frames, and those with a doubtful joint; what is of one kind and at most `gap` frames
 * apart is one. */
export function toLookAt(data: ViewData, gap: number): Stretch[] {
  const out: Stretch[] = [];
  const counts = doubtfulCounts(data);
  for (let t = 0; t < data.frames; t++) {
    const flag = data.flags[t] || (counts[t] ? DOUBTFUL : 0);
    if (!flag) continue;
    const open = out[out.length - 1];
    if (open && open.flag === flag && t - open.last <= gap) open.last = t;
    else out.push({ first: t, last: t, flag });
  }
  return out;
}

/** How many joints may be wrong at each row. */
export function doubtfulCounts({ doubtful, joints, frames }: ViewData): Uint8Array {
  return column(new Uint8Array(frames), (t) => {
    let count = 0;
    if (doubtful) for (let j = 0; j < joints; j++) count += Number(doubtful[t * joints + j]! > 0);
    return count;
  });
}

/** `out` with f(t) at every t; from(), which asks for an iterator, takes ten times as long on a long result. */
export function column<T extends Numbers>(out: T, f: (t: number) => number): T {
  for (let t = 0; t < out.length; t++) out[t] = f(t);
  return out;
}

/** The joints that may be wrong at a row. */
export function doubtfulAt({ doubtful, joints }: ViewData, row: number): number[] {
  const out: number[] = [];
  if (doubtful) for (let j = 0; j < joints; j++) if (doubtful[row * joints + j]) out.push(j);
  return out;
}

/** Row of `data` at a time in seconds: the last frame that has begun by then. */
export function rowAt(times: Float64Array, seconds: number): number {
  let low = 0;
  let high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if ((times[middle] as number) <= seconds + 1e-9) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** "left" or "right" of a joint's or angle's name, "middle" else. */
export function side(name: string): "left" | "right" | "middle" {
  if (name.startsWith("left") || name.endsWith("_l")) return "left";
  return name.startsWith("right") || name.endsWith("_r") ? "right" : "middle";
}
