import type { ViewData } from "../lib/bundle";
import { Skin } from "../lib/skin";
import { wheelFactor, Zoom, type XY } from "../lib/zoom";
import { button, toggle } from "../ui/buttons";
import { h, memory, onResize } from "../ui/dom";
import { onTheme } from "../ui/theme";
import { Overlay, type Shown } from "./overlay";
import type { Beside } from "./plots";
import type { Outlines, Source } from "./source";

const GAP = 4;
const WIDTHS = [240, 320, 480, 640, 960, 1280, 1920];
const CLOSER = 1.3; // by one press of a key
const STEP_PX = 40;
const ROOM = 1.3; // of a close-up: its side is so many times the person's
const SAMPLED = 40; // rows in which the person is measured for it
const MOST_CLOSE_PX = 960; // width of pictures for close-ups

interface Tile {
  box: HTMLElement;
  canvas: HTMLCanvasElement;
  note: HTMLElement;
  overlay: Overlay;
  image: ImageBitmap | null;
  /** What is shown of the picture. */
  zoom: Zoom;
  /** How many times larger than the whole picture the person fills the tile. */
  near: number;
}

/** Something that is done with the pointer in the pictures; x, y, px: pixels of the calibrated size, px per one of the
 * screen. */
export interface PictureEdit {
  draw(c: CanvasRenderingContext2D, tile: number, overlay: Overlay, row: number, scale: number): void;
  /** Whether something is taken hold of. */
  down(tile: number, overlay: Overlay, x: number, y: number, px: number): boolean;
  move(overlay: Overlay, x: number, y: number): void;
  up(): void;
}

const LATE_MS = 300; // sooner nobody waits

/** The recorded pictures of all cameras at the frame shown, with what was found drawn over them. */
export class CameraPane {
  readonly element: HTMLElement;
  /** Frame of the pictures that are shown; they follow the frame of the screen as fast as they arrive. */
  row = -1;
  private readonly grid: HTMLElement;
  private readonly tiles: Tile[];
  private readonly skin: Skin | null;
  private readonly shown: Shown;
  private readonly stop: (() => void)[] = [];
  private readonly abort = new AbortController();
  private readonly outlines = new Map<number, Outlines | null>();
  /** Says that the edges of the masks are on their way: the first time that takes seconds. */
  private readonly coming = h("output", { class: "masks-coming", hidden: true }, "The masks are being made…");
  private making = false;
  private editing: PictureEdit | null = null;
  private beside: Beside | null = null;
  private besideSkin: Skin | null = null;
  private enlarged = -1;
  private shownWidth = 480;
  private width = 480;
  private wanted = 0;
  private fetched = "";
  private busy = false;

  constructor(
    private readonly data: ViewData,
    private readonly source: Source,
    private readonly failed: (message: string) => void,
  ) {
    this.shown = { body: true, skeleton: true, rivals: true, masks: false, close: true, ...(JSON.parse(memory.get("overlays") ?? "{}") as object) };
    this.skin = data.coarse ? new Skin(data, data.coarse) : null;
    this.tiles = data.header.cameras.map((camera, i) => {
      const canvas = h("canvas", { role: "img", "aria-label": `Picture of ${camera.name}` });
      const note = h("span", { class: "tile-note dim" });
      const enlarge = button("", () => this.enlarge(this.enlarged === i ? -1 : i), {
        kind: "quiet",
        icon: "expand",
        title: `Enlarge ${camera.name}`,
        key: i < 9 ? String(i + 1) : "",
      });
      const box = h("div", { class: "tile" }, canvas, h("span", { class: "tile-name" }, camera.name), note, enlarge);
      box.addEventListener("dblclick", () => !this.editing && this.enlarge(this.enlarged === i ? -1 : i));
      const overlay = new Overlay(data, camera, this.skin);
      const tile: Tile = { box, canvas, note, overlay, image: null, zoom: new Zoom(), near: nearness(data, overlay) };
      this.listen(tile, i);
      return tile;
    });
    this.grid = h("div", { class: "tiles" }, ...this.tiles.map((t) => t.box));
    this.element = h("div", { class: "cameras" }, this.tiles.length ? this.grid : this.empty(), this.coming);
    this.stop.push(
      onResize(this.grid, (w, height) => this.layout(w, height)),
      onTheme(() => this.draw()),
    );
  }

  /** Buttons for what is drawn over the pictures. */
  tools(): HTMLElement[] {
    if (!this.tiles.length) return [];
    const change = (what: keyof Shown) => (on: boolean) => {
      this.shown[what] = on;
      memory.set("overlays", JSON.stringify(this.shown));
      if (what === "masks") void this.needOutlines();
      if (what === "close") this.need();
      this.draw();
    };
    const made = [
      toggle("Close-up", this.shown.close, change("close"), { icon: "fit", title: "Close-up of the person in the pictures" }),
      toggle("Body", this.shown.body, change("body"), { icon: "body", title: "Body on the pictures" }),
      toggle("Skeleton", this.shown.skeleton, change("skeleton"), { icon: "skeleton", title: "Skeleton on the pictures" }),
    ];
    if (this.data.rivals) made.push(toggle("Other poses", this.shown.rivals, change("rivals"), { icon: "rivals", title: "Other poses on the pictures" }));
    if (this.source.id !== null) {
      made.push(toggle("Masks", this.shown.masks, change("masks"), { icon: "edge", title: "Edge of the masks" }));
    }
    for (const { element } of made) element.setAttribute("aria-label", element.title); // in 3D are buttons of the same words
    return made.map((t) => t.element);
  }

  /** Shows a frame as soon as its pictures are there; frames asked for meanwhile are passed over. */
  show(row: number): void {
    this.wanted = row;
    if (!this.busy) void this.fetch();
  }

  /** Lets something be done with the pointer in the pictures; null ends it. */
  edit(edit: PictureEdit | null): void {
    this.editing = edit;
    this.grid.toggleAttribute("data-editing", edit !== null);
    this.draw();
  }

  overlayOf(camera: string): Overlay | undefined {
    return this.tiles.find((t) => t.overlay.camera.name === camera)?.overlay;
  }

  private listen(tile: Tile, index: number): void {
    const { canvas, overlay, zoom } = tile;
    const at = (event: PointerEvent): [number, number, number] => [...zoom.toPicture([event.offsetX, event.offsetY]), 1 / zoom.scale];
    let held: "joint" | XY | null = null;
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button === 0 && this.editing?.down(index, overlay, ...at(event))) held = "joint";
      else if (this.enlarged === index && zoom.times > 1) held = [event.clientX, event.clientY];
      else return;
      canvas.setPointerCapture(event.pointerId);
      event.preventDefault();
    });
    canvas.addEventListener("pointermove", (event) => {
      if (held === "joint") {
        const [x, y] = at(event);
        this.editing?.move(overlay, x, y);
      } else if (held) {
        this.pan(event.clientX - held[0], event.clientY - held[1]);
        held = [event.clientX, event.clientY];
      }
    });
    canvas.addEventListener("lostpointercapture", () => {
      if (held === "joint") this.editing?.up();
      held = null;
    });
    // with the focus by a click, arrows would no longer mean frames
    canvas.addEventListener("mousedown", (event) => event.preventDefault());
    canvas.addEventListener("contextmenu", (event) => this.enlarged === index && event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      if (this.enlarged !== index) return;
      event.preventDefault();
      this.zoomBy(wheelFactor(event), [event.offsetX, event.offsetY]);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const [dx, dy] = PANS[event.key] ?? [0, 0];
      if (this.enlarged !== index || zoom.times === 1 || !(dx || dy) || event.ctrlKey || event.metaKey || event.altKey) return;
      this.pan(STEP_PX * dx, STEP_PX * dy);
      event.preventDefault();
    });
  }

  /** The enlarged picture larger (+1) or smaller (-1); false when none is enlarged. */
  closer(direction: 1 | -1): boolean {
    if (this.enlarged < 0) return false;
    this.zoomBy(CLOSER ** direction);
    return true;
  }

  private zoomBy(factor: number, at?: XY): void {
    const { zoom, canvas } = this.tiles[this.enlarged]!;
    zoom.by(factor, at);
    canvas.toggleAttribute("data-closer", zoom.times > 1);
    this.need();
    this.draw();
  }

  private pan(dx: number, dy: number): void {
    this.tiles[this.enlarged]!.zoom.move(dx, dy);
    this.draw();
  }

  /** Pictures as large as they are shown. */
  private need(): void {
    const one = this.tiles[this.enlarged];
    const nearest = this.shown.close ? Math.max(...this.tiles.map((t) => t.near)) : 1;
    const wide = one ? this.shownWidth * one.zoom.times : Math.min(this.shownWidth * nearest, Math.max(this.shownWidth, MOST_CLOSE_PX));
    this.width = WIDTHS.find((x) => x >= wide) ?? 1920;
    this.show(this.wanted);
  }

  /** Another result in the pictures as well; null takes it away. */
  compare(beside: Beside | null): void {
    this.beside = beside;
    this.besideSkin = beside?.data.coarse && beside.data.restJoints ? new Skin(beside.data, beside.data.coarse) : null;
    for (const { overlay } of this.tiles) [overlay.beside, overlay.besideSkin] = [beside, this.besideSkin];
    this.draw();
  }

  enlarge(index: number): void {
    if (index >= this.tiles.length) return;
    this.enlarged = index;
    this.tiles.forEach((t, i) => {
      t.zoom.fit();
      t.box.hidden = index >= 0 && i !== index;
      t.canvas.removeAttribute("data-closer");
      // an enlarged picture is moved with the keys once it has the focus
      if (i === index) t.canvas.tabIndex = 0;
      else t.canvas.removeAttribute("tabindex");
    });
    this.layout(this.grid.clientWidth, this.grid.clientHeight);
  }

  /** One view more or less enlarged; false when none was. */
  shrink(): boolean {
    if (this.enlarged < 0) return false;
    this.enlarge(-1);
    return true;
  }

  close(): void {
    this.abort.abort();
    for (const stop of this.stop) stop();
    for (const tile of this.tiles) {
      tile.image?.close();
      tile.image = null; // what comes later must not draw it
    }
  }

  private async fetch(): Promise<void> {
    this.busy = true;
    try {
      while (!this.abort.signal.aborted && this.fetched !== `${this.wanted}/${this.width}`) {
        const row = this.wanted;
        this.fetched = `${row}/${this.width}`;
        const found = this.hasPictures() ? await this.source.pictures(row, this.width, this.abort.signal) : null;
        const images = await Promise.all((found?.files ?? []).map((f) => (f ? createImageBitmap(f) : null)));
        this.tiles.forEach((tile, i) => {
          tile.image?.close();
          tile.image = images[i] ?? null;
          const camera = this.data.header.cameras[i];
          const away = found && found.row !== row ? `frame ${found.row + this.data.header.first_frame}` : "";
          tile.note.textContent = tile.image ? away : camera?.pictures ? "no picture of this frame" : "no pictures";
        });
        this.row = found?.row ?? row;
        void this.needOutlines();
        this.draw();
      }
    } catch (error) {
      if (!this.abort.signal.aborted) this.failed((error as Error).message);
    } finally {
      this.busy = false;
    }
  }

  private hasPictures(): boolean {
    return this.data.header.cameras.some((c) => c.pictures);
  }

  /** One question at a time, always of the frame that is shown: of those that are played past nobody waits for the edges,
   * and they would keep the pictures waiting. */
  private async needOutlines(): Promise<void> {
    const wanted = (): boolean => this.shown.masks && this.tiles.length > 0 && this.row >= 0 && !this.outlines.has(this.row) && this.source.id !== null;
    if (this.making) return;
    this.making = true;
    let late = 0;
    try {
      while (wanted()) {
        const row = this.row;
        late = window.setTimeout(() => (this.coming.hidden = false), LATE_MS);
        this.outlines.set(row, await this.source.outlines(row, this.abort.signal));
        clearTimeout(late);
        this.coming.hidden = true;
        for (const old of this.outlines.keys()) {
          if (this.outlines.size <= 100) break;
          this.outlines.delete(old);
        }
        if (row === this.row) this.draw();
      }
    } catch (error) {
      if (!this.abort.signal.aborted) this.failed((error as Error).message);
    }
    clearTimeout(late);
    this.coming.hidden = true;
    this.making = false;
  }

  /** Tiles as large as possible: the number of columns that wastes least. */
  private layout(width: number, height: number): void {
    const sizes = this.data.header.cameras.map((c) => c.size);
    const n = this.enlarged < 0 ? sizes.length : 1;
    const first = sizes[Math.max(0, this.enlarged)];
    if (!first || width < 20 || height < 20) return;
    const aspect = first[0] / first[1];
    let best = { w: 0, h: 0, columns: 1 };
    for (let columns = 1; columns <= n; columns++) {
      const rows = Math.ceil(n / columns);
      const w = Math.min((width - GAP * (columns - 1)) / columns, aspect * ((height - GAP * (rows - 1)) / rows));
      if (w > best.w) best = { w, h: w / aspect, columns };
    }
    this.grid.style.setProperty("--columns", String(best.columns));
    const ratio = window.devicePixelRatio || 1;
    this.tiles.forEach((tile, i) => {
      const size = sizes[i];
      if (!size) return;
      const scale = Math.min(best.w / size[0], best.h / size[1]);
      const [w, hgt] = [Math.max(1, Math.floor(size[0] * scale)), Math.max(1, Math.floor(size[1] * scale))];
      tile.box.style.width = tile.canvas.style.width = `${w}px`;
      tile.box.style.height = tile.canvas.style.height = `${hgt}px`;
      tile.canvas.width = Math.round(w * ratio);
      tile.canvas.height = Math.round(hgt * ratio);
      [tile.zoom.picture, tile.zoom.screen] = [size, [w, hgt]];
    });
    this.shownWidth = best.w * ratio;
    this.need();
    this.draw();
  }

  draw(): void {
    const row = Math.max(0, this.row);
    const posed = this.shown.body && this.skin ? this.skin.pose(row) : false;
    const other = row + (this.beside?.shift ?? 0);
    const known = this.beside !== null && other >= 0 && other < this.beside.data.frames;
    const besidePosed = known && this.shown.body && this.besideSkin ? this.besideSkin.pose(other) : false;
    this.tiles.forEach((tile, i) => {
      tile.overlay.besidePosed = besidePosed;
      const c = tile.canvas.getContext("2d", { alpha: false });
      if (!c || tile.box.hidden) return;
      const { width, height } = tile.canvas;
      if (this.enlarged < 0) this.look(tile, row);
      const { times, screen } = tile.zoom;
      const [left, top] = tile.zoom.toScreen([-0.5, -0.5]).map((at) => (at * width) / screen[0]) as XY;
      c.setTransform(1, 0, 0, 1, 0, 0);
      if (!tile.image || times > 1) {
        c.fillStyle = "#22282e";
        c.fillRect(0, 0, width, height);
      }
      c.setTransform(1, 0, 0, 1, left, top);
      if (tile.image) c.drawImage(tile.image, 0, 0, width * times, height * times);
      if (this.row < 0) return;
      const scale = (width * times) / tile.overlay.camera.size[0];
      tile.overlay.draw(c, row, posed, this.shown, scale);
      const edges = this.shown.masks ? this.outlines.get(row)?.[i] : null;
      if (edges) tile.overlay.masks(c, edges, scale);
      this.editing?.draw(c, i, tile.overlay, row, scale);
    });
  }

  /** Turns a small picture to the person, where close-ups are wanted and the person is in it. */
  private look(tile: Tile, row: number): void {
    const found = this.shown.close ? extent(tile.overlay.pixelsOf(row)) : null;
    if (found) tile.zoom.look(tile.near, [(found[0] + found[2]) / 2, (found[1] + found[3]) / 2]);
    else tile.zoom.fit();
  }

  private empty(): HTMLElement {
    return h(
      "div",
      { class: "empty" },
      h("h2", {}, "No cameras"),
      h("p", {}, "What is fused of skeletons has no pictures. The pictures of other results are seen where these lie in their recording: put them into "),
      h("code", {}, "RECORDING/results/NAME"),
      h("p", {}, "and open that recording's folder."),
    );
  }
}

/** Left, top, right and bottom of points (x, y, x, y, ...); null where none is known. */
function extent(pixels: Float32Array): [number, number, number, number] | null {
  const out: [number, number, number, number] = [Infinity, Infinity, -Infinity, -Infinity];
  for (let i = 0; i < pixels.length; i += 2) {
    const [x, y] = [pixels[i]!, pixels[i + 1]!];
    if (Number.isNaN(x + y)) continue;
    [out[0], out[1], out[2], out[3]] = [Math.min(out[0], x), Math.min(out[1], y), Math.max(out[2], x), Math.max(out[3], y)];
  }
  return out[0] < out[2] ? out : null;
}

/** How many times larger than the whole picture the person may be shown in all frames. */
function nearness(data: ViewData, overlay: Overlay): number {
  let near = Infinity;
  for (let row = 0; row < data.frames; row += Math.max(1, Math.floor(data.frames / SAMPLED))) {
    const found = extent(overlay.pixelsOf(row));
    if (found) near = Math.min(near, overlay.camera.size[0] / (ROOM * (found[2] - found[0])), overlay.camera.size[1] / (ROOM * (found[3] - found[1])));
  }
  return Math.max(1, Math.min(near, 6));
}

/** Where the picture goes when one looks to the left, right, up or down. */
const PANS: Readonly<Record<string, XY>> = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
