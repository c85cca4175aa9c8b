import { side, stretches, type ViewData } from "../lib/bundle";
import { select, tabs } from "../ui/buttons";
import { h, memory } from "../ui/dom";
import { Plot, type PlotOptions, type Series } from "../ui/plot";

/** Another run beside the one shown: row `i` of this result is row `i + shift` of the other. */
export interface Beside {
  data: ViewData;
  shift: number;
  name: string;
}

interface Panel extends PlotOptions {
  series: Series[];
}

type Group = { name: string; label: string; panels: (data: ViewData, beside: Beside | null) => Panel[] };

const ANGLE_GROUPS: readonly [string, string, readonly [string, readonly string[]][]][] = [
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
const WINDOWS = [0, 5, 20, 60];
const LONG_S = 60; // longer results begin with a part of themselves: whole, their curves would be solid blocks
const MOST_PANELS = 5;
const THREE = ["middle", "accent", "warn"] as const; // told apart in both themes, also by who sees red and green alike

/** Joint angles and the quality of the fit over time, in groups. */
export class PlotPane {
  readonly element: HTMLElement;
  readonly tabs: HTMLElement;
  /** How much time the plots show at once. */
  readonly span: HTMLElement;
  private plots: Plot[] = [];
  private readonly groups: Group[];
  private readonly showTab: (name: string) => void;
  private name = "";
  private row = 0;
  private window = 0;
  private beside: Beside | null = null;

  constructor(
    private readonly data: ViewData,
    private readonly chosen: (row: number) => void,
  ) {
    this.element = h("div", { class: "plots" });
    this.groups = [
      ...(data.angles ? ANGLE_GROUPS.map(([name, label, panels]): Group => ({ name, label, panels: angles(panels) })) : []),
      { name: "place", label: "Position", panels: place },
      { name: "quality", label: "Quality", panels: quality },
    ];
    const seconds = (data.times[data.frames - 1] ?? 0) - (data.times[0] ?? 0);
    if (seconds > LONG_S) this.window = 20;
    const spans = WINDOWS.map((w) => ({ value: w, label: w ? `${w} s` : "All" })).filter((w) => w.value < seconds);
    this.span = select("Time shown in the plots", spans, this.window, (w) => {
      this.window = w;
      for (const plot of this.plots) plot.setWindow(w);
    });
    const made = tabs("Plots", this.groups, (name) => this.open(name));
    this.tabs = made.element;
    this.showTab = made.show;
    const before = memory.get("plots") ?? "";
    this.showTab(this.groups.some((g) => g.name === before) ? before : this.groups[0]!.name);
  }

  /** Moves to a frame; tell() says the values there. */
  show(row: number): void {
    this.row = row;
    for (const plot of this.plots) plot.show(row);
  }

  tell(): void {
    for (const plot of this.plots) plot.tell();
  }

  compare(beside: Beside | null): void {
    this.beside = beside;
    this.open(this.name);
  }

  close(): void {
    for (const plot of this.plots) plot.close();
    this.plots = [];
  }

  private open(name: string): void {
    this.name = name;
    memory.set("plots", name);
    this.close();
    const group = this.groups.find((g) => g.name === name);
    const flagged = stretches(this.data.flags);
    const panels = group?.panels(this.data, this.beside) ?? [];
    this.plots = panels.slice(0, MOST_PANELS).map(({ series, ...options }) => {
      return new Plot(this.data.times, series, { ...options, chosen: this.chosen, flagged, window: this.window });
    });
    this.element.replaceChildren(...this.plots.map((p) => p.element));
    this.show(this.row);
    this.tell();
  }
}

function angles(panels: readonly [string, readonly string[]][]) {
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
        return [one, { label: beside.name, colour: one.colour, values: shifted(other, beside.shift, data.frames), dashed: true }];
      });
      return { title, unit: "°", series };
    });
}

function angle(data: ViewData, name: string, of: Float32Array | null = data.angles): Float32Array | null {
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
  return Uint8Array.from({ length: frames }, (_, t) => Number(columns.some((j) => doubtful[t * joints + j])));
}

function shifted(values: Float32Array, shift: number, frames: number): Float32Array {
  return Float32Array.from({ length: frames }, (_, i) => values[i + shift] ?? NaN);
}

/** Where xx, yy and zz stand in a covariance of six numbers. */
const DIAGONAL = [0, 3, 5] as const;

function coordinate(data: ViewData, joint: string, axis: number): Float32Array | null {
  const j = data.header.joint_names.indexOf(joint);
  if (j < 0) return null;
  return Float32Array.from({ length: data.frames }, (_, t) => data.positions[3 * (t * data.joints + j) + axis]!);
}

function place(data: ViewData, beside: Beside | null): Panel[] {
  const spread = (joint: string, axis: number): Float32Array => {
    const j = data.header.joint_names.indexOf(joint);
    return Float32Array.from({ length: data.frames }, (_, t) => Math.sqrt(data.covariance[6 * (t * data.joints + j) + DIAGONAL[axis]!]!));
  };
  const lines = (named: readonly [string, string, number, string][]): Series[] =>
    named.flatMap(([label, joint, axis, tone]): Series[] => {
      const values = coordinate(data, joint, axis);
      if (!values) return [];
      const one: Series = { label, colour: tone, values, sd: spread(joint, axis), doubtful: wrongJoints(data, [joint]) };
      const other = beside && coordinate(beside.data, joint, axis);
      return other ? [one, { label: beside!.name, colour: tone, values: shifted(other, beside!.shift, data.frames), dashed: true }] : [one];
    });
  const root = data.header.joint_names[0] ?? "pelvis";
  return [
    { title: "Pelvis", unit: "m", series: lines([["x", root, 0, "middle"], ["y", root, 1, "good"], ["z", root, 2, "other"]]) },
    { title: "Height of the hands", unit: "m", series: lines([["left", "left_wrist", 2, "left"], ["right", "right_wrist", 2, "right"]]) },
    { title: "Height of the ankles", unit: "m", series: lines([["left", "left_ankle", 2, "left"], ["right", "right_ankle", 2, "right"]]) },
  ].filter((p) => p.series.length);
}

const REGIONS: readonly [string, string, RegExp][] = [
  ["trunk", "middle", /^(pelvis|spine|chest|neck|head)$/],
  ["arms", "other", /(shoulder|elbow|wrist)$/],
  ["legs", "good", /(hip|knee|ankle)$/],
];

function quality(data: ViewData): Panel[] {
  const { frames, joints } = data;
  const mean = (values: Float32Array, columns: readonly number[], stride: number): Float32Array =>
    Float32Array.from({ length: frames }, (_, t) => {
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
    const worst = Float32Array.from({ length: frames }, (_, t) => {
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
    const values = Float32Array.from({ length: frames }, (_, t) => data.rivals!.weights[t * each]!);
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
