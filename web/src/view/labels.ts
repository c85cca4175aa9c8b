import { CanvasTexture, Group, type PerspectiveCamera, Sprite, SpriteMaterial, SRGBColorSpace, Vector3 } from "three";
import { colour } from "../ui/theme";

const LABEL_PX = 17; // 34 px of the canvas for letters of 26 px, seen at half the size

/** Names that stand at places in space, at the same size from wherever one looks. */
export class Labels {
  readonly group = new Group();
  private readonly at = new Vector3();

  /** Keeps them 12 px high in a picture of this height (px), and leaves out those that its edge would cut. */
  fit(camera: PerspectiveCamera, height: number): void {
    const share = LABEL_PX / Math.max(1, height);
    const one = 2 * Math.tan((camera.fov * Math.PI) / 360) * share;
    camera.updateMatrixWorld();
    for (const sprite of this.sprites()) {
      const aspect = sprite.userData["aspect"] as number;
      sprite.scale.set(one * aspect, one, 1);
      const { x, y, z } = this.at.copy(sprite.position).project(camera);
      sprite.visible = z < 1 && Math.abs(x) + (share * aspect) / camera.aspect < 1 && Math.abs(y) + share < 1;
    }
  }

  /** These names at these places (m), in place of those before. */
  put(named: Iterable<readonly [string, readonly [number, number, number]]>): void {
    for (const old of this.sprites()) {
      old.material.map?.dispose();
      old.material.dispose();
    }
    this.group.clear();
    for (const [name, place] of named) {
      const sprite = written(name);
      sprite.position.set(...place);
      this.group.add(sprite);
    }
  }

  private sprites(): Sprite[] {
    return this.group.children as Sprite[];
  }
}

function written(text: string): Sprite {
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
