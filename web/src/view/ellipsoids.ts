import { DynamicDrawUsage, InstancedMesh, Matrix4, MeshBasicMaterial, SphereGeometry } from "three";
import { colour } from "../ui/theme";

const SPREAD = 2.5003; // standard deviations: nine in ten of a normal distribution in space
const MOST_M = 0.4; // one standard deviation that is drawn at most: what is hardly known would cover everything
const LEAST_M2 = 1e-8;

/** How sure the joints are: regions that hold them with 90 %. */
export class Ellipsoids {
  readonly mesh: InstancedMesh<SphereGeometry, MeshBasicMaterial>;
  private readonly matrix = new Matrix4();

  constructor(joints: number) {
    const material = new MeshBasicMaterial({ transparent: true, opacity: 0.27, depthWrite: false });
    this.mesh = new InstancedMesh(new SphereGeometry(1, 14, 10), material, joints);
    this.mesh.frustumCulled = false;
    this.mesh.instanceMatrix.setUsage(DynamicDrawUsage);
    this.recolour();
  }

  recolour(): void {
    this.mesh.material.color.set(colour("accent"));
  }

  /** A ball around joint j at p (m); sd: m per axis, anything but a positive number hides it. */
  sphere(j: number, p: readonly [number, number, number], sd: number): void {
    if (!(sd > 0) || !Number.isFinite(p[0])) return this.hide(j);
    const r = SPREAD * Math.min(sd, MOST_M);
    this.put(j, this.matrix.makeScale(r, r, r).setPosition(...p));
  }

  /** An ellipsoid around joint j at p (m). covariance: xx xy xz yy yz zz (m^2) from `at` on. */
  ellipsoid(j: number, p: readonly [number, number, number], covariance: ArrayLike<number>, at = 0): void {
    const [xx, xy, xz, yy, yz, zz] = Array.from({ length: 6 }, (_, k) => covariance[at + k]!) as [number, number, number, number, number, number];
    if (!Number.isFinite(xx + yy + zz + p[0])) return this.hide(j);
    // the unit sphere times the Cholesky factor is the ellipsoid of one standard deviation
    const a = Math.sqrt(Math.max(xx, LEAST_M2));
    const [b, c] = [xy / a, xz / a];
    const d = Math.sqrt(Math.max(yy - b * b, LEAST_M2));
    const e = (yz - b * c) / d;
    const f = Math.sqrt(Math.max(zz - c * c - e * e, LEAST_M2));
    const s = SPREAD * Math.min(1, MOST_M / Math.sqrt(Math.max(xx + yy + zz, LEAST_M2)));
    this.put(j, this.matrix.set(s * a, 0, 0, p[0], s * b, s * d, 0, p[1], s * c, s * e, s * f, p[2], 0, 0, 0, 1));
  }

  hide(j: number): void {
    this.put(j, this.matrix.makeScale(0, 0, 0));
  }

  dispose(): void {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
    this.mesh.dispose();
  }

  private put(j: number, matrix: Matrix4): void {
    this.mesh.setMatrixAt(j, matrix);
    this.mesh.instanceMatrix.needsUpdate = true;
  }
}
