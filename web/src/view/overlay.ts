import { side, type CameraData, type ViewData } from "../lib/bundle";
import { Projector } from "../lib/camera";
import type { Skin } from "../lib/skin";
import { colour } from "../ui/theme";

export interface Shown {
  body: boolean;
  skeleton: boolean;
  masks: boolean;
}

/** Draws a result over the pictures of one camera. Pixels are those of the calibrated size. */
export class Overlay {
  private readonly projector: Projector;
  private readonly pixels: Float32Array;
  private readonly joints: Float32Array;

  constructor(
    private readonly data: ViewData,
    readonly camera: CameraData,
    private readonly skin: Skin | null,
  ) {
    this.projector = new Projector(camera);
    this.pixels = new Float32Array(skin ? (2 * skin.vertices.length) / 3 : 0);
    this.joints = new Float32Array(2 * data.joints);
  }

  /** The skin must be in the pose of `row`, `posed` says whether it has one. scale: screen per picture pixel. */
  draw(c: CanvasRenderingContext2D, row: number, posed: boolean, shown: Shown, scale: number): void {
    c.save();
    // pixel centres lie at integers, so the picture begins at -0.5
    c.scale(scale, scale);
    c.translate(0.5, 0.5);
    if (shown.body && posed) this.body(c);
    if (shown.skeleton) this.skeleton(c, row, scale);
    c.restore();
  }

  /** The measured silhouette's edge. */
  masks(c: CanvasRenderingContext2D, polygons: readonly number[][], scale: number): void {
    c.save();
    c.scale(scale, scale);
    c.translate(0.5, 0.5);
    c.beginPath();
    for (const line of polygons) {
      for (let i = 0; i + 1 < line.length; i += 2) {
        if (i) c.lineTo(line[i]!, line[i + 1]!);
        else c.moveTo(line[i]!, line[i + 1]!);
      }
      c.closePath();
    }
    c.strokeStyle = colour("mask");
    c.lineWidth = 1.5 / scale;
    c.stroke();
    c.restore();
  }

  /** The triangles that face the camera cover the silhouette, so one path of them is filled without seams. */
  private body(c: CanvasRenderingContext2D): void {
    if (!this.skin) return;
    const p = this.pixels;
    this.projector.project(this.skin.vertices, p);
    const { faces } = this.skin.mesh;
    c.beginPath();
    for (let f = 0; f < faces.length; f += 3) {
      const [a, b, d] = [2 * faces[f]!, 2 * faces[f + 1]!, 2 * faces[f + 2]!];
      const area = (p[b]! - p[a]!) * (p[d + 1]! - p[a + 1]!) - (p[b + 1]! - p[a + 1]!) * (p[d]! - p[a]!);
      if (!(area < 0)) continue; // seen from outside: clockwise with y down; NaN: behind the camera
      c.moveTo(p[a]!, p[a + 1]!);
      c.lineTo(p[b]!, p[b + 1]!);
      c.lineTo(p[d]!, p[d + 1]!);
      c.closePath();
    }
    c.fillStyle = colour("accent");
    c.globalAlpha = 0.42;
    c.fill();
    c.globalAlpha = 1;
  }

  private skeleton(c: CanvasRenderingContext2D, row: number, scale: number): void {
    const { positions, joints, header } = this.data;
    this.projector.project(positions.subarray(3 * row * joints, 3 * (row + 1) * joints), this.joints);
    c.lineCap = "round";
    for (const [width, of] of [[4.5, null], [2.2, side]] as const) {
      c.lineWidth = width / scale;
      header.parents.forEach((p, j) => {
        if (p < 0) return;
        const [x0, y0] = [this.joints[2 * p]!, this.joints[2 * p + 1]!];
        const [x1, y1] = [this.joints[2 * j]!, this.joints[2 * j + 1]!];
        if (!Number.isFinite(x0 + y0 + x1 + y1)) return;
        c.strokeStyle = of ? LIMBS[of(header.joint_names[j]!)] : "rgb(0 0 0 / 65%)";
        c.beginPath();
        c.moveTo(x0, y0);
        c.lineTo(x1, y1);
        c.stroke();
      });
    }
  }
}

/** On pictures the colours do not follow the theme: what is filmed does not either. */
const LIMBS = { left: "#f5a04a", right: "#5bb2f5", middle: "#f2f5f7" };
