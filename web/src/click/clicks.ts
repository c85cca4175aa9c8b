import type { ClickedView, ClickJoint } from "../protocol";
import { memory } from "../ui/dom";

export interface Point {
  x: number;
  y: number;
  occluded: boolean;
}
/** Clicked joints of every camera; never changed, only replaced, so that undo keeps old ones. */
export type Clicks = Readonly<Record<string, Readonly<Record<string, Point>>>>;

const MOST = 200;

/** The clicks of one frame, with undo; kept in the browser, so that a closed tab loses nothing. */
export class ClickState {
  clicks: Clicks;
  camera: string;
  /** The joint that the next click places. */
  joint: string;
  private readonly done: Clicks[] = [];
  private readonly undone: Clicks[] = [];

  constructor(
    readonly joints: readonly ClickJoint[],
    readonly cameras: readonly string[],
    private readonly key: string,
    private readonly changed: () => void,
  ) {
    this.clicks = kept(key, cameras, joints);
    this.camera = cameras.find((c) => c === memory.get(`${key}.camera`)) ?? this.most ?? cameras[0] ?? "";
    this.joint = joints[0]?.joint ?? "";
    this.chooseNext(true);
  }

  /** Points of the camera shown. */
  get points(): Readonly<Record<string, Point>> {
    return this.clicks[this.camera] ?? {};
  }

  get count(): number {
    return Object.values(this.clicks).reduce((sum, points) => sum + Object.keys(points).length, 0);
  }

  /** The camera in which most is clicked. */
  get most(): string | undefined {
    const placed = (camera: string): number => Object.keys(this.clicks[camera] ?? {}).length;
    return this.cameras.filter(placed).sort((a, b) => placed(b) - placed(a))[0];
  }

  get canUndo(): boolean {
    return this.done.length > 0;
  }

  get canRedo(): boolean {
    return this.undone.length > 0;
  }

  views(): ClickedView[] {
    return Object.entries(this.clicks)
      .filter(([, points]) => Object.keys(points).length)
      .map(([camera, points]) => ({ camera, points: Object.entries(points).map(([joint, p]) => ({ joint, ...p })) }));
  }

  /** Puts the chosen joint at a pixel and goes on to the next that is missing. */
  place(x: number, y: number): void {
    if (!this.joint) return;
    const old = this.points[this.joint];
    this.set(this.joint, { x, y, occluded: old?.occluded ?? false });
    this.chooseNext();
    this.changed();
  }

  /** Moves a joint; first: the beginning of a drag, which is undone as a whole. */
  move(joint: string, x: number, y: number, first: boolean): void {
    const old = this.points[joint];
    if (!old) return;
    if (first) this.remember();
    this.replace(joint, { ...old, x, y });
    this.joint = joint;
    this.changed();
  }

  flipOccluded(): void {
    const old = this.points[this.joint];
    if (!old) return;
    this.set(this.joint, { ...old, occluded: !old.occluded });
    this.changed();
  }

  remove(): void {
    if (!this.points[this.joint]) return;
    this.remember();
    const rest = Object.fromEntries(Object.entries(this.points).filter(([name]) => name !== this.joint));
    this.clicks = { ...this.clicks, [this.camera]: rest };
    this.keep();
    this.changed();
  }

  clear(): void {
    if (!this.count) return;
    this.remember();
    this.clicks = {};
    this.joint = this.joints[0]?.joint ?? "";
    this.keep();
    this.changed();
  }

  undo(): void {
    this.swap(this.done, this.undone);
  }

  redo(): void {
    this.swap(this.undone, this.done);
  }

  choose(joint: string): void {
    this.joint = joint;
    this.changed();
  }

  /** Steps through the joints in order. */
  step(by: number): void {
    const at = this.joints.findIndex((j) => j.joint === this.joint);
    const n = this.joints.length;
    this.choose(this.joints[(at + by + n) % n]?.joint ?? "");
  }

  show(camera: string): void {
    this.camera = camera;
    memory.set(`${this.key}.camera`, camera);
    this.chooseNext(true);
    this.changed();
  }

  /** All joints of this camera are placed. */
  get complete(): boolean {
    return this.joints.every((j) => this.points[j.joint]);
  }

  private chooseNext(fromStart = false): void {
    const at = fromStart ? -1 : this.joints.findIndex((j) => j.joint === this.joint);
    const order = [...this.joints.slice(at + 1), ...this.joints.slice(0, at + 1)];
    const next = order.find((j) => !this.points[j.joint]);
    if (next) this.joint = next.joint;
  }

  private set(joint: string, point: Point): void {
    this.remember();
    this.replace(joint, point);
  }

  private replace(joint: string, point: Point): void {
    this.clicks = { ...this.clicks, [this.camera]: { ...this.points, [joint]: point } };
    this.keep();
  }

  private remember(): void {
    this.done.push(this.clicks);
    if (this.done.length > MOST) this.done.shift();
    this.undone.length = 0;
  }

  private swap(from: Clicks[], to: Clicks[]): void {
    const clicks = from.pop();
    if (!clicks) return;
    to.push(this.clicks);
    this.clicks = clicks;
    this.keep();
    if (this.points[this.joint]) this.chooseNext();
    this.changed();
  }

  private keep(): void {
    memory.set(this.key, JSON.stringify(this.clicks));
  }
}

/** What was clicked before; anything that does not belong to these cameras and joints is left out. */
function kept(key: string, cameras: readonly string[], joints: readonly ClickJoint[]): Clicks {
  try {
    const all = JSON.parse(memory.get(key) ?? "{}") as Record<string, Record<string, Point>>;
    const known = new Set(joints.map((j) => j.joint));
    return Object.fromEntries(
      cameras
        .filter((c) => all[c])
        .map((c) => [c, Object.fromEntries(Object.entries(all[c]!).filter(([j, p]) => known.has(j) && Number.isFinite(p.x + p.y)))]),
    );
  } catch {
    return {};
  }
}
