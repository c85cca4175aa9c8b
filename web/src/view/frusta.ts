import {
  BufferGeometry, CanvasTexture, Color, Float32BufferAttribute, Group, LineBasicMaterial, LineSegments,
  type PerspectiveCamera, Sprite, SpriteMaterial, SRGBColorSpace, Vector3,
} from "three";
import type { CameraData } from "../lib/bundle";
import { Projector } from "../lib/camera";
import { colour } from "../ui/theme";

/** The cameras as wire pyramids with their names. */
export class Frusta {
  readonly group = new Group();
  private readonly lines: LineBasicMaterial[] = [];
  private readonly at = new Vector3();

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
      const material = new LineBasicMaterial();
      const geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(at, 3));
      this.lines.push(material);
      this.group.add(new LineSegments(geometry, material));
    }
    this.recolour();
  }

  /** Keeps the names 12 px high in a picture of this height (px), and leaves out those that its edge would cut. */
  label(camera: PerspectiveCamera, height: number): void {
    const share = LABEL_PX / Math.max(1, height);
    const one = 2 * Math.tan((camera.fov * Math.PI) / 360) * share;
    camera.updateMatrixWorld();
    for (const sprite of this.labels()) {
      const aspect = sprite.userData["aspect"] as number;
      sprite.scale.set(one * aspect, one, 1);
      const { x, y, z } = this.at.copy(sprite.position).project(camera);
      sprite.visible = z < 1 && Math.abs(x) + (share * aspect) / camera.aspect < 1 && Math.abs(y) + share < 1;
    }
  }

  private labels(): Sprite[] {
    return this.group.children.filter((c): c is Sprite => c instanceof Sprite);
  }

  recolour(): void {
    for (const material of this.lines) material.color = new Color(colour("dim"));
    for (const old of this.labels()) {
      old.material.map?.dispose();
      old.material.dispose();
      this.group.remove(old);
    }
    for (const camera of this.cameras) {
      const sprite = label(camera.name);
      const [x, y, z] = new Projector(camera).position;
      sprite.position.set(x, y, z + 0.16);
      this.group.add(sprite);
    }
  }
}

const LABEL_PX = 17; // 34 px of the canvas for letters of 26 px, seen at half the size

function label(text: string): Sprite {
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("2d")!;
  const font = "500 26px system-ui, sans-serif";
  context.font = font;
  canvas.width = Math.ceil(context.measureText(text).width) + 8;
  canvas.height = 34;
  context.font = font;
  context.fillStyle = colour("ink");
  context.textBaseline = "middle";
  context.fillText(text, 4, 18);
  const map = new CanvasTexture(canvas);
  map.colorSpace = SRGBColorSpace;
  const sprite = new Sprite(new SpriteMaterial({ map, sizeAttenuation: false, depthTest: false, fog: false }));
  sprite.userData["aspect"] = canvas.width / canvas.height;
  return sprite;
}
