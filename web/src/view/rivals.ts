import { Group } from "three";
import { rivalJoints, type Rivals, type ViewData } from "../lib/bundle";
import { Sticks } from "./figure";

const THICKNESS = 0.5;

/** The other poses that explain the same pictures, as thin skeletons: what one camera leaves open. */
export class RivalPoses {
  readonly group = new Group();
  private readonly sticks: Sticks[];

  constructor(
    private readonly data: ViewData,
    private readonly rivals: Rivals,
  ) {
    const { parents, joint_names } = data.header;
    this.sticks = Array.from({ length: rivals.count }, () => new Sticks(parents, joint_names, "dim", THICKNESS));
    this.group.add(...this.sticks.map((s) => s.group));
  }

  recolour(): void {
    for (const sticks of this.sticks) sticks.recolour();
  }

  place(row: number): void {
    this.sticks.forEach((sticks, k) => {
      const joints = rivalJoints(this.rivals, row, k, this.data.joints);
      sticks.group.visible = joints !== null;
      if (joints) sticks.place(joints, 0);
    });
  }
}

/** How many poses there are at a frame, and the weight of the one that is shown. */
export function openness({ weights, count }: Rivals, row: number): string {
  const own = weights.subarray(row * (count + 1), (row + 1) * (count + 1));
  const poses = own.reduce((n, w) => n + Number(Number.isFinite(w)), 0);
  if (!poses) return "";
  return poses === 1 ? "one pose" : `${poses} poses, the one shown ${Math.round(100 * own[0]!)} %`;
}
