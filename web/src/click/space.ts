import { Group, Vector3 } from "three";
import type { CameraData, ViewData } from "../lib/bundle";
import { Projector } from "../lib/camera";
import type { CameraInfo, Fit } from "../protocol";
import { onResize } from "../ui/dom";
import { onTheme } from "../ui/theme";
import { Ellipsoids } from "../view/ellipsoids";
import { SkinnedBody, Sticks } from "../view/figure";
import { Frusta } from "../view/frusta";
import { Stage } from "../view/stage";
import { JOINT_NAMES, PARENTS } from "./skeleton";

/** The fitted pose in 3D, with the body and its uncertainty, beside the cameras; rivals are thin. */
export class FitSpace {
  readonly stage: Stage;
  drawn = 0;
  private readonly sticks = new Sticks(PARENTS, JOINT_NAMES, null, 1.5);
  private readonly rival = new Sticks(PARENTS, JOINT_NAMES, "dim", 0.6);
  private readonly spread = new Ellipsoids(JOINT_NAMES.length);
  private readonly box = new Group();
  private readonly frusta: Frusta;
  private readonly eyes: Projector[];
  private readonly stops: (() => void)[];
  private body: { skinned: SkinnedBody; data: ViewData } | null = null;
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
    this.box.add(this.sticks.group, this.rival.group);
    this.box.visible = this.spread.mesh.visible = this.rival.group.visible = false;
    this.stage.scene.add(this.frusta.group);
    this.stage.over.add(this.spread.mesh, this.box);
    this.stage.name("The fitted pose in three dimensions");
    host.append(this.stage.canvas);
    this.lay(0);
    this.stage.look(new Vector3(0, 0, 0.9), new Vector3(0.6, -1, 0.55), Math.min(9, 1.05 * ring));
    this.stops = [
      onResize(host, (w, h) => this.stage.resize(w, h)),
      onTheme(() => this.recolour()),
    ];
    this.recolour();
  }

  /** The body that is fitted: a block of one frame, whose pose is changed to that of every fit. */
  setBody(data: ViewData): void {
    if (this.body) {
      this.stage.scene.remove(this.body.skinned.group);
      this.body.skinned.dispose();
    }
    this.body = { skinned: new SkinnedBody(data), data };
    this.stage.scene.add(this.body.skinned.group);
    this.placeBody();
    this.later();
  }

  /** Shows a fit: choice 0 is the best pose, k the k-th rival. */
  show(fit: Fit | null, choice: number): void {
    if (this.shown?.fit === fit && this.shown.choice === choice) return;
    this.shown = { fit, choice };
    this.box.visible = this.spread.mesh.visible = fit !== null;
    if (fit) {
      const best = Float32Array.from(fit.joints.flat());
      const rival = fit.alternatives[choice - 1];
      const chosen = rival ? Float32Array.from(rival.joints.flat()) : best;
      this.sticks.place(chosen, 0);
      this.rival.group.visible = rival !== undefined;
      if (rival) this.rival.place(best, 0);
      fit.covariance.forEach((c, j) => this.spread.ellipsoid(j, [chosen[3 * j]!, chosen[3 * j + 1]!, chosen[3 * j + 2]!], c));
      const low = Math.min(...fit.joints.map((j) => j[2]!)) - 0.09;
      if (!(Math.abs(low - this.floor) < 0.25)) this.lay(low, chosen[0]!, chosen[1]!);
      if (!this.looked) this.look(new Vector3().fromArray(chosen));
      this.looked = true;
    }
    this.placeBody();
    this.later();
  }

  /** At the person, from the side of the first camera, half turned, so that what it cannot see is seen. */
  private look(at: Vector3): void {
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

  private placeBody(): void {
    if (!this.body) return;
    const { skinned, data } = this.body;
    const fit = this.shown?.fit;
    skinned.group.visible = fit !== null && fit !== undefined;
    if (!fit) return;
    const one = fit.alternatives[this.shown!.choice - 1] ?? fit;
    data.positions.set(one.joints.flat());
    data.rotations?.set(one.rotations.flat());
    skinned.layShadow(this.floor);
    skinned.place(0);
  }

  private recolour(): void {
    this.sticks.recolour();
    this.rival.recolour();
    this.frusta.recolour();
    this.spread.recolour();
    this.body?.skinned.recolour();
    this.stage.recolour();
    if (Number.isFinite(this.floor)) this.lay(this.floor);
  }

  private later(): void {
    this.waiting ||= requestAnimationFrame(() => {
      this.waiting = 0;
      this.frusta.label(this.stage.camera, this.stage.canvas.clientHeight);
      this.stage.draw();
      this.drawn++;
    });
  }
}
