import { Quaternion, Vector3 } from "three";
import type { ViewData } from "./bundle";

/** A heel or toe: the joint of the ankle that it moves with, and where it lies from there at rest, m. */
interface Tip {
  name: string;
  ankle: number;
  offset: Vector3;
}

/** A skeleton with its feet: bones end in ankles, so heels and toes are taken from the skin that moves with them. */
export class Feet {
  readonly names: readonly string[];
  readonly parents: readonly number[];
  private readonly tips: Tip[];
  private readonly out: Float32Array;
  private readonly turn = new Quaternion();
  private readonly point = new Vector3();

  constructor(private readonly data: ViewData) {
    const { header, joints } = data;
    this.tips = tips(data);
    this.names = [...header.joint_names, ...this.tips.map((t) => t.name)];
    this.parents = [...header.parents, ...this.tips.map((t) => t.ankle)];
    this.out = new Float32Array(3 * (joints + this.tips.length));
  }

  /** Joints, toes and heels (J + 4, 3) m at a row; overwritten by the next. */
  at(row: number): Float32Array {
    const { positions, rotations, joints } = this.data;
    this.out.set(positions.subarray(3 * row * joints, 3 * (row + 1) * joints));
    this.tips.forEach(({ ankle, offset }, k) => {
      this.turn.fromArray(rotations!, 4 * (row * joints + ankle));
      this.point.copy(offset).applyQuaternion(this.turn);
      for (const [i, x] of [this.point.x, this.point.y, this.point.z].entries()) this.out[3 * (joints + k) + i] = x + positions[3 * (row * joints + ankle) + i]!;
    });
    return this.out;
  }
}

/** Of each foot the two points of its skin that lie farthest apart; the toe is the one farther from the ankle. */
function tips({ header, coarse, fine, restJoints, rotations }: ViewData): Tip[] {
  const mesh = coarse ?? fine;
  if (!mesh || !restJoints || !rotations) return [];
  const influences = (3 * mesh.skinIndex.length) / mesh.vertices.length;
  return header.joint_names.flatMap((name, ankle) => {
    if (!name.endsWith("ankle")) return [];
    const rest = new Vector3().fromArray(restJoints, 3 * ankle);
    const skin: Vector3[] = [];
    for (let v = 0; 3 * v < mesh.vertices.length; v++) {
      let weight = 0;
      for (let i = v * influences; i < (v + 1) * influences; i++) if (mesh.skinIndex[i] === ankle) weight += mesh.skinWeight[i]!;
      if (weight > 0.5) skin.push(new Vector3().fromArray(mesh.vertices, 3 * v).sub(rest));
    }
    const farthest = (from: Vector3): Vector3 | undefined => skin.reduce<Vector3 | undefined>((best, p) => (best && best.distanceTo(from) >= p.distanceTo(from) ? best : p), undefined);
    const toe = farthest(new Vector3());
    const heel = toe && farthest(toe);
    if (!toe || !heel) return [];
    const sideOf = name.replace("ankle", "");
    return [{ name: `${sideOf}toe`, ankle, offset: toe }, { name: `${sideOf}heel`, ankle, offset: heel }];
  });
}
