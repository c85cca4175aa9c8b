import { side } from "../lib/bundle";
import type { Series } from "../ui/plot";
import type { Panel } from "./panels";

/** What the server finds of how somebody walks: when feet strike (s of the motion's times) and leave the ground, figures
 * of the steps, and the angles from strike to strike, in degrees at 0 to 100 %. */
export interface Gait {
  events: { time: number; side: "left" | "right"; kind: "strike" | "off" }[];
  figures: { name: string; unit: string; mean: number; low: number; high: number; n: number }[];
  cycles: { name: string; mean: number[]; sd: number[]; n: number }[];
}

export const PERCENT = Float64Array.from({ length: 101 }, (_, k) => k);

/** Angles over the gait cycle: the mean of all strides, and the band of one standard deviation between them. */
export function cycles(gait: Gait, panels: readonly [string, readonly string[]][]): Panel[] {
  return panels.flatMap(([title, names]): Panel[] => {
    const tones = ["first", "second", "third"] as const;
    const series = names.flatMap((name, i): Series[] => {
      const found = gait.cycles.find((c) => c.name === name);
      if (!found) return [];
      const own = side(name);
      return [{
        label: names.length === 2 ? own : (name.split("_").pop() ?? name), colour: names.length === 2 ? own : tones[i % 3]!,
        values: Float32Array.from(found.mean, (v) => v ?? NaN), sd: Float32Array.from(found.sd, (v) => v ?? NaN), note: `${found.n} ${found.n === 1 ? "stride" : "strides"}`,
      }];
    });
    return series.length ? [{ title, unit: "°", series, cycle: true }] : [];
  });
}
