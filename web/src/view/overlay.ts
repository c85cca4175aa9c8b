import { doubtfulAt, rivalJoints, side, type CameraData, type ViewData } from "../lib/bundle";
import { Projector } from "../lib/camera";
import { Feet } from "../lib/feet";
import type { Skin } from "../lib/skin";
import { colour } from "../ui/theme";
import type { Beside } from "./plots";

export interface Shown {
  body: boolean;
  skeleton: boolean;
  rivals: boolean;
  masks: boolean;
  /** Small pictures are cut to the person. */
  close: boolean;
}

/** Draws a result over the pictures of one camera. Pixels are those of the calibrated size. */
export class Overlay {
  private readonly projector: Projector;
  private pixels: Float32Array;
  private readonly joints: Float32Array;
  private readonly feet: Feet;
  /** Another result, drawn as well, and its skin, which is in the pose of the row when `besidePosed`. */
  beside: Beside | null = null;
  besideSkin: Skin | null = null;
  besidePosed = false;

  constructor(
    private readonly data: ViewData,
    readonly camera: CameraData,
    private readonly skin: Skin | null,
  ) {
    this.projector = new Projector(camera);
    this.pixels = new Float32Array(skin ? (2 * skin.vertices.length) / 3 : 0);
    this.joints = new Float32Array(2 * data.joints);
    this.feet = new Feet(data);
  }

  /** The skin must be in the pose of `row`, `posed` says whether it has one. scale: screen per picture pixel. */
  draw(c: CanvasRenderingContext2D, row: number, posed: boolean, shown: Shown, scale: number): void {
    c.save();
    // pixel centres lie at integers, so the picture begins at -0.5
    c.scale(scale, scale);
    c.translate(0.5, 0.5);
    if (shown.body && posed && this.skin) this.body(c, this.skin, colour("accent"), 0.42);
    if (shown.body && this.besidePosed && this.besideSkin) this.body(c, this.besideSkin, BESIDE, 0.3);
    if (shown.rivals) this.rivals(c, row, scale);
    if (this.beside) this.other(c, row, scale);
    if (shown.skeleton) this.skeleton(c, row, scale);
    c.restore();
  }

  /** Where the joints of a row are in the picture, (J, 2) px; overwritten by what is drawn next. */
  pixelsOf(row: number): Float32Array {
    const { positions, joints } = this.data;
    this.projector.project(positions.subarray(3 * row * joints, 3 * (row + 1) * joints), this.joints);
    return this.joints;
  }

  /** The pixel of the recorded picture at an undistorted one. */
  asRecorded(x: number, y: number): [number, number] {
    return this.projector.asRecorded(x, y);
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
  private body(c: CanvasRenderingContext2D, skin: Skin, tone: string, alpha: number): void {
    const size = (2 * skin.vertices.length) / 3;
    if (this.pixels.length < size) this.pixels = new Float32Array(size);
    const p = this.pixels.subarray(0, size);
    this.projector.project(skin.vertices, p);
    const { faces } = skin.mesh;
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
    c.fillStyle = tone;
    c.globalAlpha = alpha;
    c.fill();
    c.globalAlpha = 1;
  }

  /** The other poses that explain the same frame: thin and dashed. */
  private rivals(c: CanvasRenderingContext2D, row: number, scale: number): void {
    const { rivals, joints } = this.data;
    if (!rivals) return;
    c.setLineDash([4 / scale, 3 / scale]);
    for (let k = 0; k < rivals.count; k++) {
      const other = rivalJoints(rivals, row, k, joints);
      if (other) this.lines(c, other, 1.4 / scale, () => "#ffffff");
    }
    c.setLineDash([]);
  }

  /** Another result beside this one. */
  private other(c: CanvasRenderingContext2D, row: number, scale: number): void {
    const { data, shift } = this.beside!;
    const at = row + shift;
    if (at < 0 || at >= data.frames || data.joints !== this.data.joints) return;
    this.lines(c, data.positions.subarray(3 * at * data.joints, 3 * (at + 1) * data.joints), 2.2 / scale, () => BESIDE);
  }

  private skeleton(c: CanvasRenderingContext2D, row: number, scale: number): void {
    const doubted = new Set(doubtfulAt(this.data, row));
    const here = this.feet.at(row);
    this.lines(c, here, 4.5 / scale, () => "rgb(0 0 0 / 65%)");
    this.lines(c, here, 2.2 / scale, (j) => (doubted.has(j) ? DOUBTFUL : LIMBS[side(this.feet.names[j]!)]));
  }

  private lines(c: CanvasRenderingContext2D, positions: Float32Array, width: number, tone: (joint: number) => string): void {
    const pixels = new Float32Array((2 * positions.length) / 3);
    this.projector.project(positions, pixels);
    c.lineCap = "round";
    c.lineWidth = width;
    this.feet.parents.forEach((p, j) => {
      if (p < 0 || 2 * j >= pixels.length) return;
      const [x0, y0] = [pixels[2 * p]!, pixels[2 * p + 1]!];
      const [x1, y1] = [pixels[2 * j]!, pixels[2 * j + 1]!];
      if (!Number.isFinite(x0 + y0 + x1 + y1)) return;
      c.strokeStyle = tone(j);
      c.beginPath();
      c.moveTo(x0, y0);
      c.lineTo(x1, y1);
      c.stroke();
    });
  }
}

/** On pictures the colours do not follow the theme: what is filmed does not either. */
const DOUBTFUL = "#ff5257";
const BESIDE = "#f7d9ff";
const LIMBS = { left: "#f5a04a", right: "#5bb2f5", middle: "#f2f5f7" };
