import { DynamicDrawUsage, Group, InstancedMesh, Matrix4, MeshBasicMaterial, SphereGeometry, Vector3 } from "three";
import type { CameraData } from "../lib/bundle";
import { Projector } from "../lib/camera";
import type { CameraInfo, Fit } from "../protocol";
import { onResize } from "../ui/dom";
import { colour, onTheme } from "../ui/theme";
import { Sticks } from "../view/figure";
import { Frusta } from "../view/frusta";
import { Stage } from "../view/stage";
import { JOINT_NAMES, PARENTS } from "./skeleton";

const SPREAD = 2; // standard deviations
const MOST_M = 0.4; // one standard deviation that is drawn at most

/** The fitted pose in 3D with its uncertainty, beside the cameras; rivals are thin. */
export class FitSpace {
  readonly stage: Stage;
  drawn = 0;
  private readonly sticks = new Sticks(PARENTS, JOINT_NAMES, null, 1.5);
  private readonly rival = new Sticks(PARENTS, JOINT_NAMES, "dim", 0.6);
  private readonly spread: InstancedMesh;
  private readonly box = new Group();
  private readonly frusta: Frusta;
  private readonly eyes: Projector[];
  private readonly stops: (() => void)[];
  private readonly matrix = new Matrix4();
  private waiting = 0;
  private looked = false;
  private shown: { fit: Fit | null; choice: number } | null = null;
  private floor = NaN;

  constructor(cameras: readonly CameraInfo[], host: HTMLElement) {
    this.stage = new Stage(() => this.later());
    const pinholes = cameras.map((c): CameraData => ({ ...c, distortion: [], fisheye: false, image_shift: [0, 0] }));
    this.eyes = pinholes.map((c) => new Projector(c));
    const ring = Math.max(1, ...this.eyes.map((e) => Math.hypot(...e.position)));
    this.frusta = new Frusta(pinholes, Math.min(0.6, Math.max(0.2, 0.09 * ring)));
    this.spread = new InstancedMesh(
      new SphereGeometry(1, 16, 12),
      new MeshBasicMaterial({ transparent: true, opacity: 0.26, depthWrite: false }),
      JOINT_NAMES.length,
    );
    this.spread.frustumCulled = false;
    this.spread.instanceMatrix.setUsage(DynamicDrawUsage);
    this.box.add(this.sticks.group, this.rival.group);
    this.box.visible = this.spread.visible = this.rival.group.visible = false;
    this.stage.scene.add(this.frusta.group);
    this.stage.over.add(this.spread, this.box);
    host.append(this.stage.canvas);
    this.lay(0);
    this.stage.look(new Vector3(0, 0, 0.9), new Vector3(0.6, -1, 0.55), Math.min(9, 1.05 * ring));
    this.stops = [
      onResize(host, (w, h) => {
        this.stage.resize(w, h);
        this.frusta.scale(h, this.stage.camera.fov);
      }),
      onTheme(() => this.recolour()),
    ];
    this.recolour();
  }

  /** Shows a fit: choice 0 is the best pose, k the k-th rival. */
  show(fit: Fit | null, choice: number): void {
    if (this.shown?.fit === fit && this.shown.choice === choice) return;
    this.shown = { fit, choice };
    this.box.visible = this.spread.visible = fit !== null;
    if (fit) {
      const best = Float32Array.from(fit.joints.flat());
      const rival = fit.alternatives[choice - 1];
      const chosen = rival ? Float32Array.from(rival.joints.flat()) : best;
      this.sticks.place(chosen, 0);
      this.rival.group.visible = rival !== undefined;
      if (rival) this.rival.place(best, 0);
      this.placeSpread(chosen, fit.covariance);
      const low = Math.min(...fit.joints.map((j) => j[2]!)) - 0.09;
      if (!(Math.abs(low - this.floor) < 0.25)) this.lay(low, chosen[0]!, chosen[1]!);
      if (!this.looked) this.look();
      this.looked = true;
    }
    this.later();
  }

  /** From the side of the first camera, half turned, so that what it cannot see is seen. */
  look(): void {
    const at = new Vector3();
    this.sticks.group.children[0]?.updateMatrixWorld();
    const mesh = this.sticks.group.children[0] as InstancedMesh;
    mesh.getMatrixAt(0, this.matrix);
    at.setFromMatrixPosition(this.matrix);
    const eye = this.eyes[0] ? new Vector3(...this.eyes[0].position) : new Vector3(0, -3, 1.5);
    const towards = eye.sub(at).setZ(0).normalize();
    const aside = towards.clone().cross(new Vector3(0, 0, 1));
    this.stage.look(at, towards.addScaledVector(aside, 1.1).setZ(0.35), 1.25);
  }

  close(): void {
    cancelAnimationFrame(this.waiting);
    for (const stop of this.stops) stop();
    this.stage.close();
  }

  private lay(height: number, x = 0, y = 0): void {
    this.floor = height;
    this.stage.layFloor(height, x, y, 3.5);
  }

  /** The unit sphere times the Cholesky factor of the covariance is the ellipsoid of one standard deviation. */
  private placeSpread(joints: Float32Array, covariance: readonly number[][]): void {
    covariance.forEach(([xx, xy, xz, yy, yz, zz], j) => {
      const a = Math.sqrt(Math.max(xx!, 1e-8));
      const [b, c] = [xy! / a, xz! / a];
      const d = Math.sqrt(Math.max(yy! - b * b, 1e-8));
      const e = (yz! - b * c) / d;
      const f = Math.sqrt(Math.max(zz! - c * c - e * e, 1e-8));
      // what is hardly known at all would cover everything
      const s = SPREAD * Math.min(1, MOST_M / Math.sqrt(xx! + yy! + zz!));
      this.matrix.set(
        s * a, 0, 0, joints[3 * j]!,
        s * b, s * d, 0, joints[3 * j + 1]!,
        s * c, s * e, s * f, joints[3 * j + 2]!,
        0, 0, 0, 1,
      );
      this.spread.setMatrixAt(j, this.matrix);
    });
    this.spread.instanceMatrix.needsUpdate = true;
  }

  private recolour(): void {
    this.sticks.recolour();
    this.rival.recolour();
    this.frusta.recolour();
    (this.spread.material as MeshBasicMaterial).color.set(colour("accent"));
    this.stage.recolour();
    if (Number.isFinite(this.floor)) this.lay(this.floor);
  }

  private later(): void {
    this.waiting ||= requestAnimationFrame(() => {
      this.waiting = 0;
      this.stage.draw();
      this.drawn++;
    });
  }
}
