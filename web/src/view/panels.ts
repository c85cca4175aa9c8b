import { column, side, type ViewData } from "../lib/bundle";
import type { PlotOptions, Series } from "../ui/plot";

/** Another run beside the one shown: row `i` of this result is row `i + shift` of the other. */
export interface Beside {
  data: ViewData;
  shift: number;
  name: string;
}

export interface Panel extends PlotOptions {
  series: Series[];
}

export interface Group {
  name: string;
  label: string;
  panels: (data: ViewData, beside: Beside | null) => Panel[];
}

/** Name, label and panels of the groups of angles. */
export const ANGLE_GROUPS: readonly [string, string, readonly [string, readonly string[]][]][] = [
  ["legs", "Legs", [
    ["Hip flexion", ["hip_flexion_l", "hip_flexion_r"]],
    ["Knee flexion", ["knee_angle_l", "knee_angle_r"]],
    ["Ankle dorsiflexion", ["ankle_angle_l", "ankle_angle_r"]],
  ]],
  ["hips", "Hips", [
    ["Hip flexion", ["hip_flexion_l", "hip_flexion_r"]],
    ["Hip adduction", ["hip_adduction_l", "hip_adduction_r"]],
    ["Hip rotation", ["hip_rotation_l", "hip_rotation_r"]],
  ]],
  ["arms", "Arms", [
    ["Shoulder flexion", ["arm_flex_l", "arm_flex_r"]],
    ["Shoulder adduction", ["arm_add_l", "arm_add_r"]],
    ["Elbow flexion", ["elbow_flex_l", "elbow_flex_r"]],
  ]],
  ["trunk", "Trunk", [
    ["Trunk", ["lumbar_extension", "lumbar_bending", "lumbar_rotation"]],
    ["Neck", ["neck_extension", "neck_bending", "neck_rotation"]],
    ["Pelvis", ["pelvis_tilt", "pelvis_list", "pelvis_rotation"]],
  ]],
];
/** Of three curves in one plot; told apart also by who sees red and green, or blue and yellow, alike. */
const THREE = ["first", "second", "third"] as const;

/** Panels of angles: both sides of one, or three of the trunk. */
export function angles(panels: readonly [string, readonly string[]][]) {
  return (data: ViewData, beside: Beside | null): Panel[] =>
    panels.map(([title, names]) => {
      const two = names.length === 2;
      const series = names.flatMap((name, i): Series[] => {
        const values = angle(data, name);
        if (!values) return [];
        const label = two ? side(name) : (name.split("_").pop() ?? name);
        const one: Series = { label, colour: two ? side(name) : THREE[i % 3]!, values, sd: angle(data, name, data.angleSd), doubtful: wrongAngle(data, name) };
        const other = beside && angle(beside.data, name);
        if (!other) return [one];
        const theirs = shifted(other, beside.shift, data.frames);
        return [one, { label: beside.name, colour: one.colour, values: theirs, dashed: true, note: `RMS ${rms(values, theirs).toFixed(1)}°` }];
      });
      return { title, unit: "°", series };
    });
}

/** (T) of an angle, null where there is none of this name. */
export function angle(data: ViewData, name: string, of: Float32Array | null = data.angles): Float32Array | null {
  const at = data.header.angles.findIndex((a) => a.name === name);
  return of && at >= 0 ? of.subarray(at * data.frames, (at + 1) * data.frames) : null;
}

/** The joints that an angle is made of, next to the ones that it turns. */
const MADE_OF: readonly [RegExp, readonly string[]][] = [
  [/^hip_/, ["hip", "knee"]],
  [/^knee_/, ["hip", "knee", "ankle"]],
  [/^(ankle|subtalar)_/, ["knee", "ankle"]],
  [/^arm_/, ["shoulder", "elbow"]],
  [/^elbow_/, ["shoulder", "elbow", "wrist"]],
  [/^lumbar_/, ["spine", "chest"]],
  [/^neck_/, ["neck", "head"]],
  [/^pelvis_/, ["pelvis"]],
];

/** (T) 1 where a joint of an angle may be wrong. */
function wrongAngle(data: ViewData, name: string): Uint8Array | null {
  const which = side(name);
  const parts = MADE_OF.find(([pattern]) => pattern.test(name))?.[1] ?? [];
  return wrongJoints(data, parts.map((p) => (which === "middle" ? p : `${which}_${p}`)));
}

/** (T) 1 where one of these joints may be wrong. */
function wrongJoints({ header, doubtful, joints, frames }: ViewData, names: readonly string[]): Uint8Array | null {
  if (!doubtful) return null;
  const columns = names.map((n) => header.joint_names.indexOf(n)).filter((j) => j >= 0);
  return column(new Uint8Array(frames), (t) => Number(columns.some((j) => doubtful[t * joints + j])));
}

/** Root mean square of the difference of two curves, where both are known. */
export function rms(a: ArrayLike<number>, b: ArrayLike<number>): number {
  let [sum, n] = [0, 0];
  for (let t = 0; t < a.length; t++) {
    const d = a[t]! - (b[t] ?? NaN);
    if (Number.isFinite(d)) [sum, n] = [sum + d * d, n + 1];
  }
  return n ? Math.sqrt(sum / n) : NaN;
}

/** Values of another run at the rows of this one. */
export function shifted(values: Float32Array, shift: number, frames: number): Float32Array {
  return column(new Float32Array(frames), (i) => values[i + shift] ?? NaN);
}

/** Where xx, yy and zz stand in a covariance of six numbers. */
const DIAGONAL = [0, 3, 5] as const;

/** (T) m: x, y or z of a joint. */
export function coordinate(data: ViewData, joint: string, axis: number): Float32Array | null {
  const j = data.header.joint_names.indexOf(joint);
  if (j < 0) return null;
  return column(new Float32Array(data.frames), (t) => data.positions[3 * (t * data.joints + j) + axis]!);
}

/** Curves of [label, joint, axis, colour]. */
function lines(data: ViewData, beside: Beside | null, named: readonly [string, string, number, string][]): Series[] {
  const spread = (joint: string, axis: number): Float32Array => {
    const j = data.header.joint_names.indexOf(joint);
    return column(new Float32Array(data.frames), (t) => Math.sqrt(data.covariance[6 * (t * data.joints + j) + DIAGONAL[axis]!]!));
  };
  return named.flatMap(([label, joint, axis, tone]): Series[] => {
    const values = coordinate(data, joint, axis);
    if (!values) return [];
    const one: Series = { label, colour: tone, values, sd: spread(joint, axis), doubtful: wrongJoints(data, [joint]) };
    const other = beside && coordinate(beside.data, joint, axis);
    if (!other) return [one];
    const theirs = shifted(other, beside!.shift, data.frames);
    return [one, { label: beside!.name, colour: tone, values: theirs, dashed: true, note: `RMS ${(1000 * rms(values, theirs)).toFixed(0)} mm` }];
  });
}

/** Where the person is. */
export function place(data: ViewData, beside: Beside | null): Panel[] {
  const root = data.header.joint_names[0] ?? "pelvis";
  return [
    { title: "Pelvis", unit: "m", series: lines(data, beside, [["x", root, 0, "first"], ["y", root, 1, "second"], ["z", root, 2, "third"]]) },
    { title: "Height of the hands", unit: "m", series: lines(data, beside, [["left", "left_wrist", 2, "left"], ["right", "right_wrist", 2, "right"]]) },
    { title: "Height of the ankles", unit: "m", series: lines(data, beside, [["left", "left_ankle", 2, "left"], ["right", "right_ankle", 2, "right"]]) },
  ].filter((p) => p.series.length);
}

/** Parts of the body, their colours, and the joints in them. */
export const REGIONS: readonly [string, string, RegExp][] = [
  ["trunk", "first", /^(pelvis|spine|chest|neck|head)$/],
  ["arms", "second", /(shoulder|elbow|wrist)$/],
  ["legs", "third", /(hip|knee|ankle)$/],
];

/** How well the body fits, and how sure it is. */
export function quality(data: ViewData): Panel[] {
  const { frames, joints } = data;
  const mean = (values: Float32Array, columns: readonly number[], stride: number): Float32Array =>
    column(new Float32Array(frames), (t) => {
      let sum = 0;
      let n = 0;
      for (const c of columns) {
        const value = values[t * stride + c] ?? NaN;
        if (!Number.isFinite(value)) continue;
        sum += value;
        n += 1;
      }
      return n ? (1000 * sum) / n : NaN;
    });
  const panels: Panel[] = [];
  if (data.cost.some(Number.isFinite)) {
    const overlap = data.cost.map((c) => 1 - c);
    panels.push({ title: "Overlap with the masks", unit: "IoU", series: [{ label: "", colour: "accent", values: overlap }] });
  }
  if (data.wrong) {
    const { wrong } = data;
    const worst = column(new Float32Array(frames), (t) => {
      let most = NaN;
      for (let j = 0; j < joints; j++) {
        const percent = wrong[t * joints + j]!;
        if (percent <= 100 && !(percent <= most)) most = percent;
      }
      return most;
    });
    panels.push({ title: "Most doubtful joint is wrong", unit: "%", range: [0, 10], series: [{ label: "", colour: "doubtful", values: worst }] });
  }
  if (data.sd.some(Number.isFinite)) {
    const series = REGIONS.map(([label, tone, which]) => {
      const columns = data.header.joint_names.flatMap((n, j) => (which.test(n) ? [j] : []));
      return { label, colour: tone, values: mean(data.sd, columns, joints) };
    });
    panels.push({ title: "Joint sd", unit: "mm", range: [0, 1], series });
  }
  if (data.rivals) {
    const each = data.rivals.count + 1;
    const values = column(new Float32Array(frames), (t) => data.rivals!.weights[t * each]!);
    panels.push({ title: "Weight of the pose shown", unit: "of 1", range: [0, 1], series: [{ label: "", colour: "accent", values }] });
  }
  const names = data.header.truth?.names ?? [];
  if (data.truthDistances) {
    const values = mean(data.truthDistances, names.map((_, i) => i), names.length);
    panels.push({ title: "Distance to the truth", unit: "mm", range: [0, 1], series: [{ label: "mean", colour: "other", values }] });
  }
  if (panels.length < 3) {
    panels.push({ title: "Views used", unit: "views", range: [0, 1], series: [{ label: "", colour: "middle", values: data.views }] });
  }
  return panels;
}

/** What can be chosen to be plotted: an angle ("angle:hip_flexion", of both sides where there are two), or where a joint
 * is ("z:wrist"). */
export interface Channel {
  id: string;
  label: string;
  group: string;
}

export function channels(data: ViewData): Channel[] {
  const base = (name: string): string => name.replace(/_[lr]$/, "");
  const told = (text: string): string => text.replaceAll("_", " ").replace(/^./, (c) => c.toUpperCase());
  const metres = new Set(data.header.angles.filter((a) => a.unit === "m").map((a) => a.name));
  const turns = data.angles ? [...new Set(data.header.angles.filter((a) => !metres.has(a.name)).map((a) => base(a.name)))] : [];
  const joints = [...new Set(data.header.joint_names.map((n) => n.replace(/^(left|right)_/, "")))];
  return [
    ...turns.map((name) => ({ id: `angle:${name}`, label: told(name), group: "Angles" })),
    ...(["x", "y", "z"] as const).flatMap((axis) => joints.map((name) => ({ id: `${axis}:${name}`, label: told(name), group: axis === "z" ? "Height (z)" : `Position ${axis}` }))),
  ];
}

/** The panels of chosen channels, one each. */
export function own(chosen: readonly string[]): Group["panels"] {
  return (data, beside) =>
    chosen.flatMap((id): Panel[] => {
      const [kind = "", name = ""] = id.split(":");
      const known = channels(data).find((c) => c.id === id);
      if (!known) return [];
      if (kind === "angle") {
        const names = data.header.angles.map((a) => a.name).filter((n) => n === name || n === `${name}_l` || n === `${name}_r`);
        return angles([[known.label, names]])(data, beside);
      }
      const both = data.header.joint_names.includes(`left_${name}`);
      const axis = "xyz".indexOf(kind);
      const list = both ? (["left", "right"] as const).map((s) => [s, `${s}_${name}`, axis, s] as [string, string, number, string]) : [[kind, name, axis, "first"] as [string, string, number, string]];
      return [{ title: `${known.label} ${kind}`, unit: "m", series: lines(data, beside, list) }];
    });
}
