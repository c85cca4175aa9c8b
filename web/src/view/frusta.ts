import { BufferGeometry, Color, Float32BufferAttribute, Group, LineBasicMaterial, LineSegments, type PerspectiveCamera } from "three";
import type { CameraData } from "../lib/bundle";
import { Projector } from "../lib/camera";
import { colour } from "../ui/theme";
import { Labels } from "./labels";

/** The cameras as wire pyramids with their names. */
export class Frusta {
  readonly group = new Group();
  private readonly lines = new LineBasicMaterial();
  private readonly labels = new Labels();

  constructor(
    private readonly cameras: readonly CameraData[],
    depth: number,
  ) {
    for (const camera of cameras) {
      const eye = new Projector(camera);
      const [w, h] = camera.size;
      const o = eye.position;
      const corners = [[0, 0], [w, 0], [w, h], [0, h]].map(([x, y]) => eye.unproject(x! - 0.5, y! - 0.5, depth));
      const top = eye.unproject(w / 2, -0.18 * h, depth);
      const at: number[] = [];
      corners.forEach((c, i) => at.push(...o, ...c, ...c, ...corners[(i + 1) % 4]!));
      at.push(...corners[0]!, ...top, ...top, ...corners[1]!); // a roof shows which way is up
      const geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(at, 3));
      this.group.add(new LineSegments(geometry, this.lines));
    }
    this.group.add(this.labels.group);
    this.recolour();
  }

  /** Keeps the names readable in a picture of this height (px). */
  label(camera: PerspectiveCamera, height: number): void {
    this.labels.fit(camera, height);
  }

  recolour(): void {
    this.lines.color = new Color(colour("dim"));
    this.labels.put(
      this.cameras.map((camera) => {
        const [x, y, z] = new Projector(camera).position;
        return [camera.name, [x, y, z + 0.16]] as const;
      }),
    );
  }
}
