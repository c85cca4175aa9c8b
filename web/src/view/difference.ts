import type { Series } from "../ui/plot";
import { angle, ANGLE_GROUPS, REGIONS, rms, shifted, type Beside, type Panel } from "./panels";
import { column, type ViewData } from "../lib/bundle";

/** How far two results are apart: between their joints, and in their angles, each with its root mean square. */
export function difference(data: ViewData, beside: Beside | null): Panel[] {
  if (!beside) return [];
  const series = REGIONS.flatMap(([label, tone, which]): Series[] => {
    const values = apart(data, beside, (name) => which.test(name));
    return values.some(Number.isFinite) ? [{ label, colour: tone, values, note: `RMS ${square(values).toFixed(0)}` }] : [];
  });
  const all = apart(data, beside, () => true);
  const panels: Panel[] = [{ title: `Joints apart, RMS ${square(all).toFixed(1)} mm`, unit: "mm", range: [0, 1], series }];
  for (const [, label, parts] of ANGLE_GROUPS.filter(([name]) => name === "legs" || name === "arms")) {
    const joints = parts.map(([title]) => title.split(" ")[0]!.toLowerCase());
    const named = new Set(joints).size === joints.length ? joints : parts.map(([title]) => title.toLowerCase());
    const curves = parts.flatMap(([, names], i): Series[] => {
      const both = names.map((n) => [angle(data, n), angle(beside.data, n)] as const);
      if (both.some(([a, b]) => !a || !b)) return [];
      const each = both.map(([a, b]) => [a!, shifted(b!, beside.shift, data.frames)] as const);
      // of both sides the larger one, so that none hides behind the other
      const values = column(new Float32Array(data.frames), (t) => Math.max(...each.map(([a, b]) => Math.abs(a[t]! - b[t]!))));
      const off = Math.sqrt(each.reduce((sum, [a, b]) => sum + rms(a, b) ** 2, 0) / each.length);
      return [{ label: named[i]!, colour: (["first", "second", "third"] as const)[i % 3]!, values, note: `RMS ${off.toFixed(1)}` }];
    });
    if (curves.length) panels.push({ title: `${label}: angles apart`, unit: "°", range: [0, 1], series: curves });
  }
  return panels;
}

const FAR_MM = 100;
const SAME_MM = 0.5;

/** How far two results are apart, in one sentence. */
export function apartInWords(data: ViewData, beside: Beside): string {
  const all = apart(data, beside, () => true);
  const known = [...all].filter(Number.isFinite);
  if (!known.length) return `${beside.name} shows no frame of this result.`;
  const mean = square(all);
  if (mean < SAME_MM) return `${beside.name} is the same motion.`;
  const regions = REGIONS.map(([label, , which]) => [label, square(apart(data, beside, (name) => which.test(name)))] as const).filter(([, mm]) => Number.isFinite(mm));
  const [most, mm] = regions.reduce((a, b) => (b[1] > a[1] ? b : a), ["", 0] as const);
  const worst = all.reduce((best, v, t) => (v > (all[best] ?? -1) || Number.isNaN(all[best]!) ? t : best), 0);
  const far = known.filter((v) => v > FAR_MM).length;
  const share = far ? `; in ${Math.max(1, Math.round((100 * far) / known.length))} % of the frames by more than ${FAR_MM / 10} cm` : "";
  return `The joints differ by ${mean.toFixed(0)} mm (root mean square), most in the ${most} (${mm.toFixed(0)} mm) and in frame ${worst + data.header.first_frame}${share}.`;
}

/** (T) mm: mean distance of the joints of one name in both, NaN where one of them is not known. */
function apart(data: ViewData, beside: Beside, which: (name: string) => boolean): Float32Array {
  const pairs = data.header.joint_names.flatMap((name, j) => {
    const k = beside.data.header.joint_names.indexOf(name);
    return k >= 0 && which(name) ? [[j, k] as const] : [];
  });
  return column(new Float32Array(data.frames), (t) => {
    const at = t + beside.shift;
    if (at < 0 || at >= beside.data.frames || !pairs.length) return NaN;
    let sum = 0;
    for (const [j, k] of pairs) {
      const [a, b] = [3 * (t * data.joints + j), 3 * (at * beside.data.joints + k)];
      sum += Math.hypot(...[0, 1, 2].map((i) => data.positions[a + i]! - beside.data.positions[b + i]!));
    }
    return (1000 * sum) / pairs.length;
  });
}

function square(values: Float32Array): number {
  return rms(values, new Float32Array(values.length));
}
