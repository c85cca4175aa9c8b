import { DEPTH, MAP, type GestureStep, type Picture } from "../protocol";
import { drawnBySoftware } from "../lib/software";
import { h, onResize } from "../ui/dom";

const SHOWN_MS = 400;

interface Learned {
  at: number;
  x: number;
  y: number;
  half: number;
  good: boolean;
}

/** The depth picture with what the session says about it: the box with its cross, what is learned, where votes lie. */
export class DepthStage {
  readonly element: HTMLElement;
  private readonly canvas: HTMLCanvasElement;
  /** Depth pictures that were on the screen. */
  drawn = 0;
  private undrawn = false;
  private readonly context: CanvasRenderingContext2D;
  private depth: ImageBitmap | null = null;
  private map: ImageBitmap | null = null;
  private step: GestureStep | null = null;
  private learned: Learned[] = [];
  private size: [number, number] = [640, 480];
  private box: [number, number] = [0, 0];
  /** CSS pixels per pixel of the picture, and pixels that are drawn for one. */
  private scale = 1;
  private fine = 1;
  private decoding = 0;
  private readonly acknowledge: number[] = [];
  private readonly stopResize: () => void;
  showMap = false;

  /** clicked: with the pixel of the picture; answered: when a picture with this number is on the screen; changed: draw()
   * is wanted. */
  constructor(
    clicked: (x: number, y: number) => void,
    private readonly answered: (seq: number) => void,
    private readonly changed: () => void,
  ) {
    this.canvas = h("canvas", { class: "depth", role: "img", "aria-label": "Depth picture" });
    const context = this.canvas.getContext("2d", { alpha: false, willReadFrequently: true });
    if (!context) throw new Error("This browser draws no pictures.");
    this.context = context;
    this.canvas.addEventListener("pointerdown", (event) => clicked(event.offsetX / this.scale, event.offsetY / this.scale));
    this.element = h("div", { class: "depth-box" }, this.canvas);
    this.stopResize = onResize(this.element, (width, height) => {
      this.box = [width, height];
      this.fit();
    });
  }

  setSize(size: [number, number]): void {
    this.size = size;
    this.depth = this.map = this.step = null;
    this.learned = [];
    this.fit();
  }

  /** Whether a picture is on its way, which will ask for draw() anyway. */
  get expects(): boolean {
    return this.decoding > 0;
  }

  async takePicture(picture: Picture): Promise<void> {
    this.decoding++;
    const type = picture.type === MAP ? "image/png" : "image/jpeg";
    const bitmap = await createImageBitmap(new Blob([picture.data], { type })).catch(() => null);
    if (bitmap && picture.type === DEPTH) {
      this.depth?.close();
      this.depth = bitmap;
      this.undrawn = true;
    } else if (bitmap && picture.type === MAP) {
      this.map?.close();
      this.map = bitmap;
    }
    this.acknowledge.push(picture.seq);
    this.decoding--;
    // a depth picture and its map are drawn together, unless they keep coming faster than they can be unpacked
    if (!this.decoding || this.acknowledge.length > 1) this.changed();
  }

  takeStep(step: GestureStep): void {
    this.step = step;
    const now = performance.now();
    this.learned = this.learned.filter((l) => now - l.at < SHOWN_MS);
    const half = step.box ? step.box[2] : 24;
    if (step.learned && step.phase === "positive" && step.box) {
      this.learned.push({ at: now, x: step.box[0], y: step.box[1], half: 0.5 * half, good: true });
    }
    for (const [x, y] of step.mined) this.learned.push({ at: now, x, y, half: 0.5 * half, good: false });
  }

  close(): void {
    this.stopResize();
    this.depth?.close();
    this.map?.close();
  }

  /** The canvas as large as it fits. Where the processor draws, its pixels are the picture's, and the browser enlarges
   * them with the rest of the page. */
  private fit(): void {
    const [width, height] = this.size;
    const [w, h] = this.box;
    if (!w || !h) return;
    this.scale = Math.min(w / width, h / height);
    this.fine = drawnBySoftware() ? 1 : this.scale * (window.devicePixelRatio || 1);
    this.canvas.width = Math.round(width * this.fine);
    this.canvas.height = Math.round(height * this.fine);
    const { style } = this.canvas;
    style.width = `${width * this.scale}px`;
    style.height = `${height * this.scale}px`;
    style.left = `${(w - width * this.scale) / 2}px`;
    style.top = `${(h - height * this.scale) / 2}px`;
    this.changed();
  }

  draw(): void {
    for (const seq of this.acknowledge.splice(0)) this.answered(seq);
    if (!this.box[0] || !this.box[1]) return;
    const [w, h] = this.size;
    const g = this.context;
    g.setTransform(this.fine, 0, 0, this.fine, 0, 0);
    if (this.depth) g.drawImage(this.depth, 0, 0, w, h);
    else {
      g.fillStyle = "#0c0f16";
      g.fillRect(0, 0, w, h);
    }
    // its cells are larger than pixels, and to smooth them costs a processor more than all the rest
    g.imageSmoothingEnabled = !drawnBySoftware();
    if (this.map && this.showMap) g.drawImage(this.map, 0, 0, w, h);
    if (this.step) this.drawStep(this.step, 1 / this.scale);
    if (this.undrawn) this.drawn++;
    this.undrawn = false;
  }

  /** one: a CSS pixel in pixels of the picture. */
  private drawStep(step: GestureStep, one: number): void {
    const g = this.context;
    const now = performance.now();
    for (const l of this.learned) {
      g.globalAlpha = Math.max(0, 1 - (now - l.at) / SHOWN_MS);
      square(g, l.x, l.y, l.half, l.good ? GOOD : BAD, 3 * one);
    }
    g.globalAlpha = 1;
    if (step.box) {
      const [x, y, half] = step.box;
      const wanted = step.phase === "do_gesture" || step.phase === "positive";
      if (wanted) {
        const colour = step.phase === "positive" ? GOOD : CALL;
        square(g, x, y, half, SHADE, 7 * one);
        square(g, x, y, half, colour, 4 * one);
        cross(g, x, y, 0.45 * half, SHADE, 5 * one);
        cross(g, x, y, 0.45 * half, colour, 2.5 * one);
      }
    }
    if (step.found) {
      for (const f of step.found) {
        if (f.score > 0) this.mark(f.x, f.y, f.threshold !== null && f.score >= f.threshold, one, f.gesture);
      }
    } else if (step.cross) this.mark(step.cross[0], step.cross[1], step.detected, one, "");
  }

  private mark(x: number, y: number, sure: boolean, one: number, name: string): void {
    const g = this.context;
    const r = (sure ? 22 : 9) * one;
    for (const [style, width] of [[SHADE, sure ? 7 : 4], [sure ? GOOD : FAINT, sure ? 4 : 2]] as const) {
      g.strokeStyle = style;
      g.lineWidth = width * one;
      g.beginPath();
      g.arc(x, y, r, 0, 2 * Math.PI);
      g.stroke();
    }
    if (!sure || !name) return;
    g.font = `700 ${22 * one}px system-ui, sans-serif`;
    g.lineWidth = 5 * one;
    g.strokeStyle = SHADE;
    g.strokeText(name, x + 30 * one, y + 8 * one);
    g.fillStyle = GOOD;
    g.fillText(name, x + 30 * one, y + 8 * one);
  }
}

// colours on the depth picture, which is as dark in both themes
const GOOD = "#5df09a";
const BAD = "#ff5d72";
const CALL = "#ffffff";
const FAINT = "rgb(255 255 255 / 55%)";
const SHADE = "rgb(6 10 14 / 75%)";

function square(g: CanvasRenderingContext2D, x: number, y: number, half: number, style: string, width: number): void {
  g.strokeStyle = style;
  g.lineWidth = width;
  g.strokeRect(x - half, y - half, 2 * half, 2 * half);
}

function cross(g: CanvasRenderingContext2D, x: number, y: number, half: number, style: string, width: number): void {
  g.strokeStyle = style;
  g.lineWidth = width;
  g.beginPath();
  g.moveTo(x - half, y);
  g.lineTo(x + half, y);
  g.moveTo(x, y - half);
  g.lineTo(x, y + half);
  g.stroke();
}
