import { BufferGeometry, Color, Float32BufferAttribute, Group, LineBasicMaterial, LineSegments, type PerspectiveCamera } from "three";
import { colour } from "../ui/theme";
import { Labels } from "../view/labels";
import type { SensorStatus } from "./messages";

type XYZ = [number, number, number];

const DEPTH = 0.35; // m: how long the pyramids are
const [WIDE, HIGH] = [0.55, 0.43]; // half sides at 1 m, as depth cameras have them
/** The eye and the four corners that it looks at; sensors whose y axis points up or down look the same. */
const PYRAMID: XYZ[] = [[0, 0, 0], ...[[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]): XYZ => [x! * WIDE * DEPTH, y! * HIGH * DEPTH, DEPTH])];
const EDGES = [0, 1, 0, 2, 0, 3, 0, 4, 1, 2, 2, 3, 3, 4, 4, 1];

/** Where the sensors stand, as wire pyramids with their names. */
export class Standing {
  readonly group = new Group();
  private readonly lines = new LineSegments(new BufferGeometry(), new LineBasicMaterial());
  private readonly labels = new Labels();
  private shown = "";
  private named: [string, XYZ][] = [];

  /** upright: a point of the sensors' common frame (m) in the one that is drawn. */
  constructor(private readonly upright: (p: readonly number[]) => XYZ) {
    this.lines.frustumCulled = false;
    this.group.add(this.lines, this.labels.group);
    this.recolour();
  }

  /** Whether anything has moved. */
  show(sensors: readonly SensorStatus[]): boolean {
    const placed = sensors.filter((s) => s.alive && s.place);
    const points = placed.map((s) => PYRAMID.map((p) => this.upright(moved(s.place!, p))));
    const shown = JSON.stringify([placed.map((s) => s.name), points]);
    if (shown === this.shown) return false;
    this.shown = shown;
    const at = points.flatMap((p) => EDGES.flatMap((k) => p[k]!));
    this.lines.geometry.dispose();
    this.lines.geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(at, 3));
    this.named = placed.map((s, i) => [s.name, [points[i]![0]![0], points[i]![0]![1], points[i]![0]![2] + 0.16]]);
    this.labels.put(this.named);
    return true;
  }

  /** The places (m) that are shown. */
  get places(): XYZ[] {
    return this.named.map(([, place]) => place);
  }

  fit(camera: PerspectiveCamera, height: number): void {
    this.labels.fit(camera, height);
  }

  recolour(): void {
    this.lines.material.color = new Color(colour("dim"));
    this.labels.put(this.named);
  }
}

/** A point of a sensor's frame in the common one. */
function moved(place: readonly (readonly number[])[], p: XYZ): XYZ {
  return [0, 1, 2].map((i) => place[i]![0]! * p[0] + place[i]![1]! * p[1] + place[i]![2]! * p[2] + place[i]![3]!) as XYZ;
}
