import type { CameraData } from "./bundle";

/** Projects points of the world into recorded pictures, lens distortion included (OpenCV's model). */
export class Projector {
  private readonly m: number[];
  private readonly d: number[];
  private readonly f: [number, number, number];
  private readonly c: [number, number];

  constructor(readonly camera: CameraData) {
    this.m = camera.camera_from_world.flat();
    this.d = Array.from({ length: 12 }, (_, i) => camera.distortion[i] ?? 0);
    const K = camera.K as [[number, number, number], [number, number, number]];
    this.f = [K[0][0], K[1][1], K[0][1]];
    this.c = [K[0][2] - camera.image_shift[0], K[1][2] - camera.image_shift[1]];
  }

  /** Writes the pixels (N, 2) of points (N, 3) m into `out`; NaN behind the camera. Pixels of the calibrated size. */
  project(points: Float32Array, out: Float32Array): void {
    const m = this.m as number[] & { [i: number]: number };
    const n = Math.min(points.length / 3, out.length / 2);
    for (let i = 0; i < n; i++) {
      const x = points[3 * i]!;
      const y = points[3 * i + 1]!;
      const z = points[3 * i + 2]!;
      const depth = m[8]! * x + m[9]! * y + m[10]! * z + m[11]!;
      if (!(depth > 1e-6)) {
        out[2 * i] = out[2 * i + 1] = NaN;
        continue;
      }
      const a = (m[0]! * x + m[1]! * y + m[2]! * z + m[3]!) / depth;
      const b = (m[4]! * x + m[5]! * y + m[6]! * z + m[7]!) / depth;
      const [u, v] = this.camera.fisheye ? this.fisheye(a, b) : this.distort(a, b);
      out[2 * i] = this.f[0] * u + this.f[2] * v + this.c[0];
      out[2 * i + 1] = this.f[1] * v + this.c[1];
    }
  }

  /** The pixel of the recorded picture at an undistorted pixel of K. */
  asRecorded(px: number, py: number): [number, number] {
    const K = this.camera.K as [[number, number, number], [number, number, number]];
    const y = (py - K[1][2]) / this.f[1];
    const x = (px - K[0][2] - this.f[2] * y) / this.f[0];
    const [u, v] = this.camera.fisheye ? this.fisheye(x, y) : this.distort(x, y);
    return [this.f[0] * u + this.f[2] * v + this.c[0], this.f[1] * v + this.c[1]];
  }

  /** k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4. */
  private distort(x: number, y: number): [number, number] {
    const [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] = this.d as [
      number, number, number, number, number, number, number, number, number, number, number, number,
    ];
    const r2 = x * x + y * y;
    const radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)));
    return [
      x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2),
      y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4),
    ];
  }

  private fisheye(x: number, y: number): [number, number] {
    const [k1, k2, k3, k4] = this.d as [number, number, number, number];
    const r = Math.hypot(x, y);
    if (r < 1e-9) return [x, y];
    const t = Math.atan(r);
    const t2 = t * t;
    const scale = (t * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))) / r;
    return [x * scale, y * scale];
  }

  /** Centre of the camera in the world, m. */
  get position(): [number, number, number] {
    const m = this.m as number[];
    const t = [m[3]!, m[7]!, m[11]!] as const;
    return [0, 1, 2].map((i) => -(m[i]! * t[0] + m[4 + i]! * t[1] + m[8 + i]! * t[2])) as [number, number, number];
  }

  /** A point of the world that is seen at a pixel, `depth` m in front of the camera; the lens taken as ideal. */
  unproject(px: number, py: number, depth: number): [number, number, number] {
    const m = this.m as number[];
    const y = (py - this.c[1]) / this.f[1];
    const x = (px - this.c[0] - this.f[2] * y) / this.f[0];
    const v = [x * depth - m[3]!, y * depth - m[7]!, depth - m[11]!] as const;
    return [0, 1, 2].map((i) => m[i]! * v[0] + m[4 + i]! * v[1] + m[8 + i]! * v[2]) as [number, number, number];
  }
}
