import { Box3, Group, Vector3 } from "three";
import { doubtfulAt, type ViewData } from "../lib/bundle";
import { Projector } from "../lib/camera";
import { Feet } from "../lib/feet";
import { memory } from "../ui/dom";
import { onTheme } from "../ui/theme";
import { SkinnedBody, Spread, Sticks, Trails } from "./figure";
import { Frusta } from "./frusta";
import type { Beside } from "./plots";
import { RivalPoses } from "./rivals";
import { Stage } from "./stage";

export const LAYERS = ["body", "skeleton", "spread", "rivals", "trails", "cameras", "truth"] as const;
export type Layer = (typeof LAYERS)[number];
export type Direction = "fit" | "front" | "side" | "top" | number;

/** The 3D picture of a result: who moved, where, and how sure that is. */
export class Space {
  readonly stage: Stage;
  readonly on: Record<Layer, boolean>;
  follow = false;
  private readonly feet: Feet;
  private readonly sticks: Sticks;
  private readonly body: SkinnedBody | null;
  private readonly spread: Spread;
  private readonly rivals: RivalPoses | null;
  private readonly trails: Trails;
  private readonly frusta: Frusta;
  private readonly truth: Sticks | null;
  private other: { sticks: Sticks; body: SkinnedBody | null; beside: Beside } | null = null;
  private readonly otherBox = new Group();
  private readonly otherBodyBox = new Group();
  private readonly reach: { centre: Vector3; radius: number };
  private readonly stop: () => void;
  private row = 0;
  private height = 1;

  constructor(
    private readonly data: ViewData,
    dirty: () => void,
  ) {
    const { header } = data;
    this.stage = new Stage(dirty);
    this.on = {
      body: true,
      skeleton: true,
      spread: false,
      rivals: true,
      trails: true,
      cameras: true,
      truth: true,
      ...(JSON.parse(memory.get("layers") ?? "{}") as object),
    };
    this.feet = new Feet(data);
    this.sticks = new Sticks(this.feet.parents, this.feet.names, null);
    this.body = data.fine && data.rotations ? new SkinnedBody(data) : null;
    this.spread = new Spread(data);
    this.rivals = data.rivals ? new RivalPoses(data, data.rivals) : null;
    this.trails = new Trails(data);
    const ring = Math.max(0, ...header.cameras.map((c) => Math.hypot(...new Projector(c).position)));
    this.frusta = new Frusta(header.cameras, Math.min(0.6, Math.max(0.2, 0.09 * ring)));
    this.truth = data.truth && header.truth ? new Sticks(header.truth.parents, [], "other", 0.75) : null;
    this.stage.scene.add(this.trails.group, this.frusta.group);
    if (this.body) this.stage.scene.add(this.body.group);
    this.stage.scene.add(this.otherBodyBox);
    this.stage.over.add(this.spread.mesh, this.sticks.group, this.otherBox);
    for (const part of [this.rivals, this.truth]) if (part) this.stage.over.add(part.group);
    this.reach = reach(data);
    const cameras = header.cameras.map((c) => new Vector3(...new Projector(c).position).distanceTo(this.reach.centre));
    const radius = Math.min(30, Math.max(2.5, this.reach.radius + 1, 1.05 * Math.max(0, ...cameras)));
    const { x, y } = this.reach.centre;
    this.stage.layFloor(header.floor, x, y, radius);
    this.stop = onTheme(() => {
      this.stage.layFloor(header.floor, x, y, radius);
      for (const part of [this.sticks, this.body, this.spread, this.rivals, this.trails, this.frusta, this.truth, this.other?.sticks, this.other?.body]) {
        part?.recolour();
      }
    });
    this.apply();
    this.look("fit");
  }

  get hasBody(): boolean {
    return this.body !== null;
  }

  get hasTruth(): boolean {
    return this.truth !== null;
  }

  set(layer: Layer, on: boolean): void {
    this.on[layer] = on;
    memory.set("layers", JSON.stringify(this.on));
    this.apply();
    this.show(this.row);
  }

  /** Moves everything that is on to a frame; draw() makes it seen. */
  show(row: number): void {
    this.row = row;
    if (this.on.skeleton || !this.body) {
      this.sticks.doubt(doubtfulAt(this.data, row));
      this.sticks.place(this.feet.at(row), 0);
    }
    if (this.on.body) this.body?.place(row);
    if (this.on.spread) this.spread.place(row);
    if (this.on.rivals) this.rivals?.place(row);
    if (this.on.trails) this.trails.place(row);
    if (this.truth && this.on.truth) {
      const joints = this.data.header.truth!.parents.length;
      const known = (row + 1) * joints * 3 <= this.data.truth!.length;
      this.truth.group.visible = known;
      if (known) this.truth.place(this.data.truth!, 3 * row * joints);
    }
    if (this.other) {
      const { data, shift } = this.other.beside;
      const at = row + shift;
      this.other.sticks.group.visible = at >= 0 && at < data.frames;
      const there = this.other.sticks.group.visible;
      this.otherBodyBox.visible = there && this.on.body;
      if (there) this.other.sticks.place(data.positions, 3 * at * data.joints);
      if (this.otherBodyBox.visible) this.other.body?.place(at);
    }
    if (this.follow) this.track(row);
  }

  resize(width: number, height: number): void {
    this.height = height;
    this.stage.resize(width, height);
  }

  /** passed: ms that the frame drawn before took until the next could begin, where that is known. */
  draw(passed?: number): void {
    if (this.on.cameras) this.frusta.label(this.stage.camera, this.height);
    this.stage.draw(passed);
  }

  /** Another run in one colour beside the one shown; null takes it away. */
  compare(beside: Beside | null): void {
    this.otherBox.clear();
    this.otherBodyBox.clear();
    this.other?.sticks.dispose();
    this.other?.body?.dispose();
    this.other = null;
    if (beside) {
      const { data } = beside;
      const { header } = data;
      const body = data.fine && data.rotations && data.restJoints ? new SkinnedBody(data, "beside", true) : null;
      this.other = { beside, body, sticks: new Sticks(header.parents, header.joint_names, "beside", 0.75) };
      this.otherBox.add(this.other.sticks.group);
      if (body) this.otherBodyBox.add(body.group);
    }
    this.show(this.row);
  }

  /** Frames the person, or looks from a side of the person, or as a camera of the recording does. */
  look(from: Direction): void {
    const { centre, radius } = this.reach;
    if (typeof from === "number") {
      const camera = this.data.header.cameras[from];
      if (!camera) return;
      const eye = new Projector(camera);
      const [w, h] = camera.size;
      const position = new Vector3(...eye.position);
      const distance = position.distanceTo(centre);
      const fov = (2 * Math.atan(h / (2 * camera.K[1]![1]!)) * 180) / Math.PI;
      this.stage.lookAs(position, new Vector3(...eye.unproject(w / 2 - 0.5, h / 2 - 0.5, distance)), fov);
      return;
    }
    const here = this.person(this.row) ?? centre;
    const [left, ahead] = this.facing();
    if (from === "fit") this.stage.look(centre, ahead.clone().addScaledVector(left, 0.75).setZ(0.42), radius);
    if (from === "front") this.stage.look(here, ahead, PERSON);
    if (from === "side") this.stage.look(here, left, PERSON);
    if (from === "top") this.stage.look(centre, new Vector3(0, -0.02, 1), Math.max(radius, 1.2));
  }

  close(): void {
    this.stop();
    this.stage.close();
  }

  private apply(): void {
    if (this.body) this.body.group.visible = this.on.body;
    this.sticks.group.visible = this.on.skeleton || !this.body;
    this.spread.mesh.visible = this.on.spread;
    if (this.rivals) this.rivals.group.visible = this.on.rivals;
    this.trails.group.visible = this.on.trails;
    this.frusta.group.visible = this.on.cameras;
    if (this.truth) this.truth.group.visible = this.on.truth;
  }

  /** Moves camera and target along with the person. */
  private track(row: number): void {
    const here = this.person(row);
    if (!here) return;
    const { controls, camera } = this.stage;
    const step = here.sub(controls.target);
    controls.target.add(step);
    camera.position.add(step);
    controls.update();
  }

  private person(row: number): Vector3 | null {
    const at = new Vector3().fromArray(this.data.positions, 3 * row * this.data.joints);
    return Number.isFinite(at.x + at.y + at.z) ? at : null;
  }

  /** Directions to the person's left and ahead, level, at the frame shown. */
  private facing(): [Vector3, Vector3] {
    const names = this.data.header.joint_names;
    const joint = (name: string): Vector3 =>
      new Vector3().fromArray(this.data.positions, 3 * (this.row * this.data.joints + Math.max(0, names.indexOf(name))));
    const left = joint("left_hip").sub(joint("right_hip")).setZ(0);
    if (!(left.length() > 1e-3)) left.set(1, 0, 0);
    left.normalize();
    return [left, left.clone().cross(new Vector3(0, 0, 1))];
  }
}
const PERSON = 1.1; // m: a person fits into a sphere of this radius around the hips

/** Sphere around where the person was, leaving out the far ends, where somebody lost may have been. */
function reach(data: ViewData): { centre: Vector3; radius: number } {
  const sides: number[][] = [[], [], []];
  const every = Math.max(1, Math.floor(data.frames / 500));
  for (let t = 0; t < data.frames; t += every) {
    for (let j = 0; j < data.joints; j++) {
      const at = 3 * (t * data.joints + j);
      if (!Number.isFinite(data.positions[at]!)) continue;
      for (let k = 0; k < 3; k++) sides[k]!.push(data.positions[at + k]!);
    }
  }
  if (!sides[0]!.length) return { centre: new Vector3(0, 0, 1), radius: 1.5 };
  const box = new Box3();
  for (const share of [0.01, 0.99]) {
    const at = sides.map((s) => s.sort((a, b) => a - b)[Math.floor(share * (s.length - 1))]!);
    box.expandByPoint(new Vector3(at[0], at[1], at[2]));
  }
  const centre = box.getCenter(new Vector3());
  return { centre, radius: Math.min(8, Math.max(1.05, 0.44 * box.getSize(new Vector3()).length() + 0.1)) };
}
