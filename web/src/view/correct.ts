import { get, post } from "../api";
import { toLookAt, type ViewData } from "../lib/bundle";
import type { ClickedView, Fit, Job, ResultEntry } from "../protocol";
import { button, select } from "../ui/buttons";
import { h, setText } from "../ui/dom";
import { icon } from "../ui/icons";
import { toast } from "../ui/toast";
import type { PictureEdit } from "./cameras";
import type { Overlay } from "./overlay";
import type { ResultView } from "./result";

type Points = Readonly<Record<string, Readonly<Record<string, readonly [number, number]>>>>;

const NEAR_PX = 16; // how near a joint the pointer must be to take it
const AROUND_S = 0.5; // what is tracked again beyond the stretch that is doubtful
const ASK_MS = 300;
/** Joints that people can point at; the others follow from them. */
const HANDLES = /^(neck|head|(left|right)_(shoulder|elbow|wrist|hip|knee|ankle))$/;

interface Reach {
  value: string;
  label: string;
  since: number;
  until: number;
}

/**
 * The frame looked at is put right: joints of the tracked skeleton are dragged in the pictures, the pose that fits is
 * shown everywhere, and the frames around are tracked again from it, backwards and forwards. Nothing is written before
 * that, and what was tracked stays as it is.
 */
export class Corrector implements PictureEdit {
  readonly element = h("div", { class: "correcting", hidden: true, role: "region", "aria-label": "Correction" });
  readonly opener: HTMLButtonElement;
  private readonly what = h("p", { "aria-live": "polite" });
  private readonly undoButton = button("Undo", () => this.undo(), { icon: "undo", title: "Take the last drag back" });
  private readonly go = button("Track again from here", () => void this.again(), { kind: "primary", icon: "play" });
  private readonly far = h("span", { class: "row" });
  private readonly handles: number[];
  private row = -1;
  private points: Points = {};
  private undone: Points[] = [];
  private drag: { tile: number; joint: string; moved: boolean } | null = null;
  private before: { positions: Float32Array; rotations: Float32Array | null; doubtful: Uint8Array | null } | null = null;
  private fit: Fit | null = null;
  private asking = false;
  private askAgain = false;
  private reaches: Reach[] = [];
  private reach = 0;
  private tracking = false;
  private closed = false;

  constructor(
    private readonly view: ResultView,
    private readonly data: ViewData,
    private readonly entry: ResultEntry,
  ) {
    this.handles = data.header.joint_names.flatMap((n, j) => (HANDLES.test(n) ? [j] : []));
    this.opener = button("Correct this frame", () => this.flip(), { icon: "edit", title: "Drag joints that are wrong to where they are, and track again from here", key: "e" });
    this.element.append(
      icon("edit"),
      this.what,
      h("span", { class: "grow" }),
      this.far,
      this.undoButton,
      this.go,
      button("", () => this.leave(), { icon: "close", kind: "quiet", title: "Leave it as it was" }),
    );
  }

  get on(): boolean {
    return this.row >= 0;
  }

  flip(): void {
    if (this.on) this.leave();
    else this.begin(this.view.player.row);
  }

  /** Begins at a frame; name: clicks that were saved before. */
  begin(row: number, name?: string): void {
    this.view.go(row);
    this.row = row;
    const { joints, positions, rotations, doubtful } = this.data;
    const at = row * joints;
    this.before = {
      positions: positions.slice(3 * at, 3 * (at + joints)),
      rotations: rotations?.slice(4 * at, 4 * (at + joints)) ?? null,
      doubtful: doubtful?.slice(at, at + joints) ?? null,
    };
    this.points = {};
    this.undone = [];
    this.fit = null;
    this.reaches = reaches(this.data, row);
    this.reach = 0;
    const choices = this.reaches.map((r) => ({ value: r.value, label: r.label }));
    this.far.replaceChildren(select("Frames to track again", choices, choices[0]!.value, (value) => (this.reach = choices.findIndex((c) => c.value === value))));
    this.element.hidden = false;
    this.view.cameras.edit(this);
    this.show();
    if (name) void this.reopen(name);
  }

  /** Puts everything back as it was tracked. */
  leave(): void {
    if (!this.on) return;
    this.restore();
    this.row = -1;
    this.points = {};
    this.element.hidden = true;
    this.view.cameras.edit(null);
    this.view.redraw();
  }

  close(): void {
    this.closed = true;
  }

  undo(): void {
    const last = this.undone.pop();
    if (!last || this.tracking) return;
    this.points = last;
    void this.ask();
    this.show();
  }

  // ---- in the pictures

  draw(c: CanvasRenderingContext2D, tile: number, overlay: Overlay, row: number, scale: number): void {
    if (row !== this.row) return;
    const at = overlay.pixelsOf(row);
    const mine = this.points[overlay.camera.name] ?? {};
    c.save();
    c.scale(scale, scale);
    c.translate(0.5, 0.5);
    for (const j of this.handles) {
      const name = this.data.header.joint_names[j]!;
      const [x, y] = mine[name] ?? [at[2 * j]!, at[2 * j + 1]!];
      if (!Number.isFinite(x + y)) continue;
      const held = this.drag?.tile === tile && this.drag.joint === name;
      c.beginPath();
      c.arc(x, y, (held ? 8 : 4.5) / scale, 0, 2 * Math.PI);
      c.fillStyle = name in mine ? "#ffffff" : "rgb(0 0 0 / 35%)";
      c.fill();
      c.lineWidth = 2 / scale;
      c.strokeStyle = name in mine ? "#111820" : "#ffffff";
      c.stroke();
    }
    c.restore();
  }

  down(tile: number, overlay: Overlay, x: number, y: number, px: number): boolean {
    if (this.view.cameras.row !== this.row || this.tracking) return false;
    const at = overlay.pixelsOf(this.row);
    const mine = this.points[overlay.camera.name] ?? {};
    let least = NEAR_PX * px;
    let joint = "";
    for (const j of this.handles) {
      const name = this.data.header.joint_names[j]!;
      const [u, v] = mine[name] ?? [at[2 * j]!, at[2 * j + 1]!];
      const distance = Math.hypot(u - x, v - y);
      if (distance < least) [least, joint] = [distance, name];
    }
    if (joint) this.drag = { tile, joint, moved: false };
    return joint !== "";
  }

  move(overlay: Overlay, x: number, y: number): void {
    const { drag } = this;
    if (!drag) return;
    if (!drag.moved) this.undone.push(this.points);
    drag.moved = true;
    const { name } = overlay.camera;
    this.points = { ...this.points, [name]: { ...this.points[name], [drag.joint]: [x, y] } };
    void this.ask();
    this.view.redraw();
  }

  up(): void {
    const moved = this.drag?.moved;
    this.drag = null;
    if (!moved) return;
    void this.ask();
    this.show();
  }

  // ---- the pose that fits

  private views(): ClickedView[] {
    return Object.entries(this.points)
      .map(([camera, points]) => ({ camera, recorded: true, points: Object.entries(points).map(([joint, [x, y]]) => ({ joint, x, y })) }))
      .filter((v) => v.points.length);
  }

  /** One question at a time, always the newest. */
  private async ask(): Promise<void> {
    if (this.asking) {
      this.askAgain = true;
      return;
    }
    this.asking = true;
    do {
      this.askAgain = false;
      const [row, views] = [this.row, this.views()];
      try {
        const found = views.length
          ? await post<Fit>("/api/fit-clicks", { result: this.entry.id, frame: row + this.data.header.first_frame, views })
          : null;
        if (this.closed || !this.on || row !== this.row) continue; // another frame may have been asked for meanwhile
        this.fit = found;
        if (found) this.patch(found);
        else this.restore();
      } catch (error) {
        toast((error as Error).message, "error");
      }
    } while (this.askAgain);
    this.asking = false;
    if (this.on) this.show();
  }

  private patch(fit: Fit): void {
    const { joints, positions, rotations, doubtful, header } = this.data;
    const at = this.row * joints;
    positions.set(fit.joints.flat(), 3 * at);
    rotations?.set(fit.rotations.flat(), 4 * at);
    if (this.before?.doubtful) doubtful?.set(this.before.doubtful, at);
    for (const name of this.moved()) {
      // what has been put where it belongs is not doubtful any more, nor what hangs on it
      const j = header.joint_names.indexOf(name);
      for (const k of [j, header.parents[j] ?? -1, header.parents.indexOf(j)]) if (k >= 0 && doubtful) doubtful[at + k] = 0;
    }
    this.view.redraw();
  }

  private restore(): void {
    const { joints, positions, rotations, doubtful } = this.data;
    const at = this.row * joints;
    if (!this.before) return;
    positions.set(this.before.positions, 3 * at);
    if (this.before.rotations) rotations?.set(this.before.rotations, 4 * at);
    if (this.before.doubtful) doubtful?.set(this.before.doubtful, at);
    this.view.redraw();
  }

  private moved(): string[] {
    return [...new Set(Object.values(this.points).flatMap((p) => Object.keys(p)))];
  }

  private show(): void {
    const frame = this.row + this.data.header.first_frame;
    const names = this.moved();
    const pictures = this.views().length;
    const where = `Correcting frame ${frame} of ${this.entry.name}`;
    const done = this.fit && names.length
      ? `${names.map((n) => `${n.replaceAll("_", " ")} ${this.distance(n)}`).join(", ")}${pictures === 1 ? " in one picture; drag it in a second one too, if you can" : ""}`
      : "drag the joints that are wrong, in one picture or several";
    setText(this.what, `${where}: ${done}.`);
    this.undoButton.disabled = !this.undone.length || this.tracking;
    this.go.disabled = !this.fit || this.tracking;
    this.view.redraw();
  }

  /** How far a joint has been moved, in words. */
  private distance(name: string): string {
    const j = this.data.header.joint_names.indexOf(name);
    const now = 3 * (this.row * this.data.joints + j);
    const [old, positions] = [this.before!.positions, this.data.positions];
    const metres = Math.hypot(...[0, 1, 2].map((k) => positions[now + k]! - old[3 * j + k]!));
    return `${(100 * metres).toFixed(0)} cm`;
  }

  // ---- kept, and tracked again

  private async again(): Promise<void> {
    const { first_frame } = this.data.header;
    const reach = this.reaches[this.reach]!;
    const recording = this.entry.recording!;
    const frame = this.row + first_frame;
    const name = `${this.entry.name}-frame-${frame}`;
    const row = this.row;
    this.tracking = true;
    this.show();
    try {
      const views = this.views();
      const camera = views.sort((a, b) => b.points.length - a.points.length)[0]!.camera;
      const saved = await post<{ name: string }>(`/api/recordings/${recording}/starts`, {
        result: this.entry.id, frame, since: reach.since + first_frame, until: reach.until + first_frame, views, name, camera,
      });
      const job = await post<Job>("/api/jobs", { kind: "correct", result: this.entry.id, options: { start: `clicks:${saved.name}` } });
      const done = await this.finished(job);
      if (this.closed || !done.result) return;
      toast(`Frames ${reach.since + first_frame} to ${reach.until + first_frame - 1} are tracked again; ${this.entry.name} stays as it was.`, "done");
      location.hash = `#/view/${done.result}/${row}`;
    } catch (error) {
      toast((error as Error).message, "error");
      this.tracking = false;
      if (this.on) this.show();
    }
  }

  private async finished(job: Job): Promise<Job> {
    for (let now = job; ; now = await get<Job>(`/api/jobs/${job.id}`)) {
      if (now.state === "done" || this.closed) return now;
      if (now.state === "failed" || now.state === "cancelled") throw new Error(now.error ?? "The correction was stopped.");
      const stage = now.stages.find((s) => s.done < s.total);
      setText(this.what, `Tracking again from frame ${this.row + this.data.header.first_frame}${stage ? `: ${stage.title.toLowerCase()}, ${stage.done} of ${stage.total}` : ""}…`);
      await new Promise((done) => setTimeout(done, ASK_MS));
    }
  }

  /** Shows clicks that were saved before, as if they were dragged now. */
  private async reopen(name: string): Promise<void> {
    try {
      const saved = await get<{ views: ClickedView[] }>(`/api/recordings/${this.entry.recording}/starts/${encodeURIComponent(name)}`);
      this.points = Object.fromEntries(
        saved.views.map((v) => {
          const overlay = this.view.cameras.overlayOf(v.camera);
          return [v.camera, Object.fromEntries(v.points.map((p) => [p.joint, overlay ? overlay.asRecorded(p.x, p.y) : ([p.x, p.y] as const)]))];
        }),
      );
      await this.ask();
    } catch (error) {
      toast((error as Error).message, "error");
    }
  }
}

/** How far a correction may reach: the stretch that is doubtful first, then more. Rows, `until` after the last. */
function reaches(data: ViewData, row: number): Reach[] {
  const rate = Math.max(1, data.header.frame_rate);
  const around = Math.round(AROUND_S * rate);
  const stretch = toLookAt(data, around).find((s) => s.first - around <= row && row <= s.last + around);
  const clamp = (since: number, until: number): [number, number] => [Math.max(0, since), Math.min(data.frames, until)];
  const make = (value: string, what: string, [since, until]: [number, number]): Reach => ({
    value, since, until, label: `${what} (${since + data.header.first_frame} to ${until - 1 + data.header.first_frame})`,
  });
  const second = Math.round(rate);
  return [
    ...(stretch ? [make("stretch", "the doubtful stretch", clamp(Math.min(stretch.first, row) - around, Math.max(stretch.last, row) + 1 + around))] : []),
    make("around", "one second around", clamp(row - second, row + second + 1)),
    make("on", "from here to the end", [row, data.frames]),
    make("all", "everything", [0, data.frames]),
  ];
}
