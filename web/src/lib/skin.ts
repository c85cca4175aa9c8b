import type { MeshData, ViewData } from "./bundle";

/** Linear blend skinning on the processor, for the few vertices that the pictures' overlays need. */
export class Skin {
  readonly vertices: Float32Array;
  private readonly local: Float32Array;
  private readonly matrices: Float32Array;
  private readonly influences: number;

  constructor(
    private readonly data: ViewData,
    readonly mesh: MeshData,
  ) {
    const n = mesh.vertices.length / 3;
    this.influences = mesh.skinIndex.length / n;
    this.vertices = new Float32Array(3 * n);
    this.matrices = new Float32Array(12 * data.joints);
    this.local = new Float32Array(3 * mesh.skinIndex.length);
    const rest = data.restJoints ?? new Float32Array(3 * data.joints);
    for (let i = 0; i < mesh.skinIndex.length; i++) {
      const v = Math.floor(i / this.influences);
      for (let k = 0; k < 3; k++) {
        this.local[3 * i + k] = mesh.vertices[3 * v + k]! - rest[3 * mesh.skinIndex[i]! + k]!;
      }
    }
  }

  /** Moves `vertices` (world, m) to the pose of a frame; false when that has none. */
  pose(row: number): boolean {
    const { positions, rotations, joints } = this.data;
    if (!rotations) return false;
    const m = this.matrices;
    for (let j = 0; j < joints; j++) {
      const q = 4 * (row * joints + j);
      if (!quaternionMatrix(rotations, q, m, 12 * j)) return false;
      for (let k = 0; k < 3; k++) m[12 * j + 9 + k] = positions[3 * (row * joints + j) + k]!;
    }
    const { skinIndex, skinWeight } = this.mesh;
    const w = this.influences;
    for (let v = 0; v < this.vertices.length / 3; v++) {
      let x = 0;
      let y = 0;
      let z = 0;
      for (let i = v * w; i < (v + 1) * w; i++) {
        const weight = skinWeight[i]!;
        if (weight === 0) continue;
        const o = 12 * skinIndex[i]!;
        const a = this.local[3 * i]!;
        const b = this.local[3 * i + 1]!;
        const c = this.local[3 * i + 2]!;
        x += weight * (m[o]! * a + m[o + 1]! * b + m[o + 2]! * c + m[o + 9]!);
        y += weight * (m[o + 3]! * a + m[o + 4]! * b + m[o + 5]! * c + m[o + 10]!);
        z += weight * (m[o + 6]! * a + m[o + 7]! * b + m[o + 8]! * c + m[o + 11]!);
      }
      this.vertices[3 * v] = x;
      this.vertices[3 * v + 1] = y;
      this.vertices[3 * v + 2] = z;
    }
    return true;
  }
}

/** Row-major rotation matrix of the quaternion x y z w at q[at]; false when it is not finite. */
function quaternionMatrix(q: Float32Array, at: number, out: Float32Array, to: number): boolean {
  const x = q[at]!;
  const y = q[at + 1]!;
  const z = q[at + 2]!;
  const w = q[at + 3]!;
  if (!Number.isFinite(x + y + z + w)) return false;
  out[to] = 1 - 2 * (y * y + z * z);
  out[to + 1] = 2 * (x * y - z * w);
  out[to + 2] = 2 * (x * z + y * w);
  out[to + 3] = 2 * (x * y + z * w);
  out[to + 4] = 1 - 2 * (x * x + z * z);
  out[to + 5] = 2 * (y * z - x * w);
  out[to + 6] = 2 * (x * z - y * w);
  out[to + 7] = 2 * (y * z + x * w);
  out[to + 8] = 1 - 2 * (x * x + y * y);
  return true;
}
