import { Group, Vector3 } from "three";
import { onResize } from "../ui/dom";
import { onTheme } from "../ui/theme";
import { Ellipsoids } from "../view/ellipsoids";
import { Sticks } from "../view/figure";
import { Stage } from "../view/stage";
import type { Person, SensorStatus } from "./messages";
import { Standing } from "./standing";

const HIPS = ["left_hip", "right_hip"];

interface Figure {
  sticks: Sticks;
  spread: Ellipsoids;
  joints: Float32Array;
}

/** Everybody who is seen just now, with the regions around the joints that hold them with 90 %, and the sensors. */
export class People {
  readonly stage: Stage;
  drawn = 0;
  private readonly figures = new Map<number, Figure>();
  private readonly box = new Group();
  private readonly stops: (() => void)[];
  readonly standing = new Standing((p) => this.upright(p));
  private sensors: readonly SensorStatus[] = [];
  private ring = 0;
  /** Its height, and the place in it below the person who was seen first (m). */
  private floor: [number, number, number] = [0, 0, 0];
  private waiting = 0;
  /** Which axis of the reference sensor points up, found when somebody is seen: index and sign. */
  private up: [number, number] | null = null;

  constructor(
    private readonly names: readonly string[],
    private readonly parents: readonly number[],
    host: HTMLElement,
  ) {
    this.stage = new Stage(() => this.later());
    this.stage.over.add(this.box);
    this.stage.scene.add(this.standing.group);
    this.stage.name("Who is seen, in three dimensions");
    host.append(this.stage.canvas);
    this.stage.layFloor(0, 0, 0, 4);
    this.stage.look(new Vector3(0, 0, 0.9), new Vector3(0.5, -1, 0.4), 2.2);
    this.stops = [
      onResize(host, (w, h) => this.stage.resize(w, h)),
      onTheme(() => {
        for (const f of this.figures.values()) {
          f.sticks.recolour();
          f.spread.recolour();
        }
        this.standing.recolour();
        this.stage.recolour();
      }),
    ];
  }

  show(people: readonly Person[]): void {
    const first = people[0];
    if (first && !this.up) this.find(first);
    for (const [id, figure] of this.figures) {
      if (people.some((p) => p.id === id)) continue;
      this.box.remove(figure.sticks.group, figure.spread.mesh);
      figure.sticks.dispose();
      figure.spread.dispose();
      this.figures.delete(id);
    }
    for (const person of people) this.place(this.figures.get(person.id) ?? this.add(person.id), person);
    this.later();
  }

  /** Where the sensors stand, once it is known what is up; who looks is taken back until all of them are seen. */
  stand(sensors: readonly SensorStatus[]): void {
    this.sensors = sensors;
    if (!this.up || !this.standing.show(sensors)) return;
    const { target } = this.stage.controls;
    const ring = Math.max(0, ...this.standing.places.map((p) => new Vector3(...p).distanceTo(target)));
    if (ring > this.ring + 0.25) {
      this.ring = ring;
      this.stage.layFloor(...this.floor, Math.max(4, 1.5 * ring)); // its fog begins behind them
      const closer = this.stage.camera.aspect > 1.4 ? 0.75 : 1; // they stand beside each other rather than above
      this.stage.look(target.clone(), this.stage.camera.position.clone().sub(target).setZ(1.8), closer * ring);
    }
    this.later();
  }

  close(): void {
    cancelAnimationFrame(this.waiting);
    for (const stop of this.stops) stop();
    this.stage.close();
  }

  private add(id: number): Figure {
    const spread = new Ellipsoids(this.names.length);
    const sticks = new Sticks(this.parents, this.names, null, 1.4);
    const figure = { sticks, spread, joints: new Float32Array(3 * this.names.length) };
    this.box.add(sticks.group, spread.mesh);
    this.figures.set(id, figure);
    return figure;
  }

  private place(figure: Figure, person: Person): void {
    person.joints.forEach((joint, j) => {
      const p = this.upright(joint);
      figure.joints.set(p, 3 * j);
      figure.spread.sphere(j, p, person.sd[j] ?? 0);
    });
    figure.sticks.place(figure.joints, 0);
  }

  /** Up is the axis along which this person's neck lies farthest above the hips; the floor lies below the feet. */
  private find(person: Person): void {
    const at = (name: string): Vector3 => new Vector3().fromArray(person.joints[this.names.indexOf(name)]!.map((v) => v ?? NaN));
    const hips = HIPS.map(at).reduce((a, b) => a.add(b)).divideScalar(HIPS.length);
    const rise = at("neck").sub(hips).toArray();
    const axis = [0, 1, 2].reduce((a, b) => (Math.abs(rise[b]!) > Math.abs(rise[a]!) ? b : a));
    if (!Number.isFinite(rise[axis])) return;
    this.up = [axis, Math.sign(rise[axis]!)];
    const places = person.joints.map((j) => this.upright(j)).filter((p) => Number.isFinite(p[2]));
    const low = Math.min(...places.map((p) => p[2])) - 0.08;
    const [x, y] = this.upright(hips.toArray());
    this.floor = [low, x, y];
    this.stage.layFloor(...this.floor, 4);
    this.stage.look(new Vector3(x, y, low + 0.9), new Vector3(0.5, -1, 0.35), 1.6);
    this.stand(this.sensors);
  }

  /** A point of the sensor's frame in one whose z axis points up. */
  private upright(p: readonly (number | null)[]): [number, number, number] {
    const v = [0, 1, 2].map((k) => p[k] ?? NaN) as [number, number, number];
    const [axis, sign] = this.up ?? [2, 1];
    if (axis === 2) return sign > 0 ? v : [v[0], -v[1], -v[2]];
    // the other two axes keep their handedness
    const [a, b] = axis === 1 ? [v[2], v[0]] : [v[1], v[2]];
    return sign > 0 ? [a, b, v[axis]!] : [b, a, -v[axis]!];
  }

  private later(): void {
    this.waiting ||= requestAnimationFrame(() => {
      this.waiting = 0;
      this.standing.fit(this.stage.camera, this.stage.canvas.clientHeight);
      this.stage.draw();
      this.drawn++;
    });
  }
}
