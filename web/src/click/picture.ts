import type { CameraInfo } from "../protocol";
import { h, sharpCanvas } from "../ui/dom";
import { colour, onTheme } from "../ui/theme";
import { side } from "../lib/bundle";
import { wheelFactor, Zoom, type XY } from "../lib/zoom";
import type { ClickState, Point } from "./clicks";
import { drawLoupe } from "./loupe";
import { LINES } from "./skeleton";

/** How near a point the pointer must be to take it: less while a click is to place the next joint. */
const NEAR_PX = 11;
const NEAR_PLACING_PX = 5;
const STEP_PX = 4;

/** One camera's picture: a click places the joint whose turn it is, points are dragged, the wheel zooms. */
export class ClickPicture {
  readonly element: HTMLElement;
  private readonly canvas: HTMLCanvasElement;
  private readonly redraw: () => void;
  private readonly stops: (() => void)[];
  private image: HTMLImageElement | null = null;
  private camera: CameraInfo | null = null;
  private expected: Record<string, XY> = {};
  private readonly zoom = new Zoom();
  /** Where the pointer or the keyboard's cross is, in pixels of the camera; null: outside. */
  private cursor: XY | null = null;
  private drag: { kind: "point"; joint: string; moved: boolean } | { kind: "pan"; from: XY } | null = null;
  private waiting = 0;

  constructor(
    private readonly state: ClickState,
    /** A drag has begun or ended. */
    private readonly moved: (dragging: boolean) => void,
  ) {
    const { canvas, redraw, stop } = sharpCanvas("The picture; Enter places the joint at the cross, arrows move it", (g, w, hgt) => {
      this.zoom.screen = [w, hgt];
      this.draw(g);
    });
    this.canvas = canvas;
    this.redraw = redraw;
    canvas.tabIndex = 0;
    canvas.classList.add("click-canvas");
    canvas.addEventListener("pointerdown", (e) => this.down(e));
    canvas.addEventListener("pointermove", (e) => this.move(e));
    canvas.addEventListener("pointerup", () => this.up());
    canvas.addEventListener("pointerleave", () => {
      if (!this.drag) this.cursor = null;
      this.later();
    });
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("wheel", (e) => this.wheel(e), { passive: false });
    canvas.addEventListener("keydown", (e) => this.key(e));
    this.element = h("div", { class: "click-picture" }, canvas);
    this.stops = [stop, onTheme(redraw)];
  }

  /** Shows a picture of a camera once it is loaded; the old one stays until then. */
  async load(camera: CameraInfo, address: string): Promise<void> {
    const image = new Image();
    image.src = address;
    const same = this.camera?.name === camera.name;
    await image.decode();
    this.image = image;
    this.camera = camera;
    this.zoom.picture = camera.size;
    if (!same) this.fit();
    this.later();
  }

  /** Where the fitted pose puts the joints, px of the camera. */
  show(expected: Record<string, XY>): void {
    this.expected = expected;
    this.later();
  }

  fit(): void {
    this.zoom.fit();
    this.later();
  }

  zoomBy(factor: number, at?: XY): void {
    this.zoom.by(factor, at);
    this.later();
  }

  close(): void {
    cancelAnimationFrame(this.waiting);
    for (const stop of this.stops) stop();
  }

  later(): void {
    this.waiting ||= requestAnimationFrame(() => {
      this.waiting = 0;
      this.redraw();
    });
  }

  private inside([x, y]: XY): boolean {
    const [w, h] = this.camera?.size ?? [0, 0];
    return x >= -0.5 && y >= -0.5 && x <= w - 0.5 && y <= h - 0.5;
  }

  private nearest(at: XY): string | null {
    let best: string | null = null;
    let least = this.state.points[this.state.joint] ? NEAR_PX : NEAR_PLACING_PX;
    for (const [joint, p] of Object.entries(this.state.points)) {
      const [u, v] = this.zoom.toScreen([p.x, p.y]);
      const distance = Math.hypot(u - at[0], v - at[1]);
      if (distance < least) [best, least] = [joint, distance];
    }
    return best;
  }

  private down(event: PointerEvent): void {
    const at: XY = [event.offsetX, event.offsetY];
    this.canvas.focus();
    if (!this.camera) return;
    this.canvas.setPointerCapture(event.pointerId);
    if (event.button !== 0) {
      this.drag = { kind: "pan", from: at };
      return;
    }
    const joint = event.shiftKey ? null : this.nearest(at);
    const p = this.zoom.toPicture(at);
    if (joint) {
      this.drag = { kind: "point", joint, moved: false };
      this.state.choose(joint);
    } else if (this.inside(p)) this.state.place(...p);
  }

  private move(event: PointerEvent): void {
    const at: XY = [event.offsetX, event.offsetY];
    const p = this.zoom.toPicture(at);
    this.cursor = this.inside(p) ? p : null;
    if (this.drag?.kind === "pan") {
      this.zoom.move(at[0] - this.drag.from[0], at[1] - this.drag.from[1]);
      this.drag.from = at;
    } else if (this.drag?.kind === "point" && this.inside(p)) {
      if (!this.drag.moved) this.moved(true);
      this.state.move(this.drag.joint, ...p, !this.drag.moved);
      this.drag.moved = true;
    }
    this.canvas.style.cursor = this.drag?.kind === "pan" ? "grabbing" : this.nearest(at) ? "grab" : "crosshair";
    this.later();
  }

  private up(): void {
    const dragged = this.drag?.kind === "point" && this.drag.moved;
    this.drag = null;
    if (dragged) this.moved(false);
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    this.zoomBy(wheelFactor(event), [event.offsetX, event.offsetY]);
  }

  /** The keyboard's way: arrows move the cross, or the chosen joint when it is placed; Enter places it. */
  private key(event: KeyboardEvent): void {
    const by = ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] } as const)[event.key as "ArrowLeft"] as
      | readonly [number, number]
      | undefined;
    if (!this.camera || event.altKey || event.ctrlKey || event.metaKey) return;
    const [w, h] = this.camera.size;
    const placed = this.state.points[this.state.joint];
    if (by && placed) {
      const step = event.shiftKey ? 5 : 1;
      this.state.move(this.state.joint, placed.x + step * by[0], placed.y + step * by[1], true);
    } else if (by) {
      const [x, y] = this.cursor ?? [w / 2, h / 2];
      const step = (event.shiftKey ? 5 : 1) * STEP_PX;
      this.cursor = [Math.min(w - 1, Math.max(0, x + step * by[0])), Math.min(h - 1, Math.max(0, y + step * by[1]))];
      this.later();
    } else if (event.key === "Enter") this.state.place(...(this.cursor ?? ([w / 2, h / 2] as XY)));
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  private draw(g: CanvasRenderingContext2D): void {
    g.fillStyle = colour("bg");
    g.fillRect(0, 0, ...this.zoom.screen);
    if (!this.image || !this.camera) return;
    const [left, top] = this.zoom.toScreen([-0.5, -0.5]);
    const [w, h] = this.camera.size;
    const { scale } = this.zoom;
    g.imageSmoothingEnabled = scale < 3;
    g.drawImage(this.image, left, top, w * scale, h * scale);
    this.drawExpected(g);
    this.drawPoints(g);
    if (!this.cursor) return;
    this.drawCross(g, this.zoom.toScreen(this.cursor));
    drawLoupe(g, this.image, this.camera.size, this.cursor, this.zoom.toScreen(this.cursor), this.zoom.screen, this.state.points);
  }

  /** The fitted pose in the picture: thin lines, and a short line from every click to where the pose puts it. */
  private drawExpected(g: CanvasRenderingContext2D): void {
    const at = (joint: string): XY | null => (this.expected[joint] ? this.zoom.toScreen(this.expected[joint]) : null);
    for (const [style, width] of [["rgb(0 0 0 / 45%)", 4], ["rgb(255 255 255 / 90%)", 1.5]] as const) {
      g.strokeStyle = style;
      g.lineWidth = width;
      g.beginPath();
      for (const [a, b] of LINES) {
        const [p, q] = [at(a), at(b)];
        if (!p || !q) continue;
        g.moveTo(...p);
        g.lineTo(...q);
      }
      g.stroke();
    }
    g.strokeStyle = colour("bad");
    g.lineWidth = 2;
    g.beginPath();
    for (const [joint, p] of Object.entries(this.state.points)) {
      const q = at(joint);
      if (!q) continue;
      g.moveTo(...this.zoom.toScreen([p.x, p.y]));
      g.lineTo(...q);
    }
    g.stroke();
  }

  private drawPoints(g: CanvasRenderingContext2D): void {
    for (const [joint, p] of Object.entries(this.state.points)) this.drawPoint(g, joint, p, joint === this.state.joint);
  }

  private drawPoint(g: CanvasRenderingContext2D, joint: string, p: Point, chosen: boolean): void {
    const [u, v] = this.zoom.toScreen([p.x, p.y]);
    g.beginPath();
    g.arc(u, v, chosen ? 7 : 5, 0, 2 * Math.PI);
    g.fillStyle = p.occluded ? "rgb(0 0 0 / 35%)" : colour(side(joint));
    g.fill();
    g.lineWidth = chosen ? 3 : 1.5;
    g.strokeStyle = chosen ? "#ffffff" : "rgb(0 0 0 / 75%)";
    g.setLineDash(p.occluded ? [3, 3] : []);
    if (p.occluded) g.strokeStyle = colour(side(joint));
    g.stroke();
    g.setLineDash([]);
  }

  private drawCross(g: CanvasRenderingContext2D, [u, v]: XY): void {
    for (const [style, width] of [["rgb(0 0 0 / 50%)", 3], ["#ffffff", 1]] as const) {
      g.strokeStyle = style;
      g.lineWidth = width;
      g.beginPath();
      for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]] as const) {
        g.moveTo(u + 5 * dx, v + 5 * dy);
        g.lineTo(u + 16 * dx, v + 16 * dy);
      }
      g.stroke();
    }
  }
}
