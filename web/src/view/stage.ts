import {
  AmbientLight, BufferGeometry, CircleGeometry, Color, DirectionalLight, Float32BufferAttribute, Fog, LineBasicMaterial,
  LineSegments, Mesh, PerspectiveCamera, Scene, ShaderMaterial, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { drawnBySoftware } from "../lib/software";
import { colour } from "../ui/theme";

const FOV = 34;
// Where the processor draws: pixels per CSS pixel while things move, fewer when frames take longer than SLOW_MS, more
// again below FAST_MS, and SETTLED ones once all rests.
const MOVING = [1, 0.75, 0.6] as const;
const SLOW_MS = 48;
const FAST_MS = 30;
const SETTLED = 1.5;
const SETTLE_MS = 600; // late enough not to be in the way of somebody who clicks on

/** The 3D picture: floor, light, a camera to move around, and two layers, `over` seen through everything in `scene`. */
export class Stage {
  readonly scene = new Scene();
  readonly over = new Scene();
  readonly camera = new PerspectiveCamera(FOV, 1, 0.05, 200);
  readonly controls: OrbitControls;
  readonly canvas: HTMLCanvasElement;
  /** Drawn by the processor: no smoothing while things move, more pixels when they rest. */
  readonly software: boolean;
  private readonly renderer: WebGLRenderer;
  private readonly floor = new Mesh(new CircleGeometry(1, 72), plainMaterial());
  private readonly grid = new LineSegments(
    new BufferGeometry(),
    new LineBasicMaterial({ vertexColors: true, transparent: true }),
  );
  private settle = 0;
  private ratio = 0;
  private coarse = 0;
  private drawn = 0;
  private usual = FAST_MS;

  constructor(private readonly dirty: () => void) {
    const software = drawnBySoftware();
    if (software === null) {
      throw new Error("This browser shows no 3D (WebGL 2 is off); switch it on, or use another browser.");
    }
    this.software = software;
    this.renderer = new WebGLRenderer({ antialias: !this.software, powerPreference: "high-performance" });
    this.renderer.autoClear = false;
    this.canvas = this.renderer.domElement;
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(3, -4, 2);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.maxPolarAngle = Math.PI * 0.54;
    this.controls.minDistance = 0.3;
    this.controls.maxDistance = 60;
    this.controls.addEventListener("change", dirty);
    steer(this);
    const sun = new DirectionalLight(0xffffff, 2.4);
    sun.position.set(2, -3, 6);
    const back = new DirectionalLight(0xffffff, 0.7);
    back.position.set(-4, 3, 2);
    this.scene.add(this.floor, this.grid, sun, back, new AmbientLight(0xffffff, 1.5));
    const light = new DirectionalLight(0xffffff, 1.6);
    light.position.set(2, -3, 6);
    this.over.add(light, new AmbientLight(0xffffff, 1.6));
  }

  /** Says what is shown, to who hears the page. */
  name(what: string): void {
    this.canvas.setAttribute("aria-label", `${what}; arrows turn it, Shift and arrows move it, + and − come closer and go away`);
  }

  /** Turns by angles (radians) about the target: to the side, and up. */
  turn(aside: number, up: number): void {
    const { target } = this.controls;
    const arm = this.camera.position.clone().sub(target);
    const flat = Math.hypot(arm.x, arm.y);
    const low = Math.PI / 2 - this.controls.maxPolarAngle;
    const height = Math.min(Math.PI / 2 - 0.02, Math.max(low, Math.atan2(arm.z, flat) + up));
    const heading = Math.atan2(arm.y, arm.x) + aside;
    const r = arm.length();
    arm.set(r * Math.cos(height) * Math.cos(heading), r * Math.cos(height) * Math.sin(heading), r * Math.sin(height));
    this.camera.position.copy(target).add(arm);
    this.controls.update();
    this.dirty();
  }

  /** Comes closer (below 1) or goes away. */
  approach(factor: number): void {
    const { target, minDistance, maxDistance } = this.controls;
    const arm = this.camera.position.clone().sub(target);
    arm.setLength(Math.min(maxDistance, Math.max(minDistance, factor * arm.length())));
    this.camera.position.copy(target).add(arm);
    this.controls.update();
    this.dirty();
  }

  /** Moves what is looked at by shares of its distance: to the right, and up. */
  shift(right: number, up: number): void {
    const distance = this.camera.position.distanceTo(this.controls.target);
    const [x, y] = [0, 1].map((k) => new Vector3().setFromMatrixColumn(this.camera.matrix, k));
    const step = x!.multiplyScalar(right * distance).addScaledVector(y!, up * distance);
    this.camera.position.add(step);
    this.controls.target.add(step);
    this.controls.update();
    this.dirty();
  }

  /** Lays a floor of squares of 0.5 m at a height (m) around a point; it fades out at `radius`. */
  layFloor(height: number, x: number, y: number, radius: number): void {
    const [cx, cy] = [Math.round(x), Math.round(y)];
    this.floor.position.set(cx, cy, height - 0.004);
    this.floor.scale.setScalar(radius * 1.02);
    const at: number[] = [];
    const rgba: number[] = [];
    const line = new Color(colour("floor-line"));
    const add = (px: number, py: number, strength: number): void => {
      at.push(cx + px, cy + py, height);
      rgba.push(line.r, line.g, line.b, strength * Math.max(0, 1 - Math.hypot(px, py) / radius));
    };
    for (let k = -Math.floor(2 * radius); k <= 2 * radius; k++) {
      const u = k / 2;
      const half = Math.sqrt(Math.max(0, radius * radius - u * u));
      const strength = k % 2 === 0 ? 1 : 0.45;
      const pieces = Math.max(2, Math.ceil(half * 2));
      for (let i = 0; i < pieces; i++) {
        const a = -half + (2 * half * i) / pieces;
        const b = -half + (2 * half * (i + 1)) / pieces;
        add(u, a, strength);
        add(u, b, strength);
        add(a, u, strength);
        add(b, u, strength);
      }
    }
    this.grid.geometry.dispose();
    this.grid.geometry = new BufferGeometry()
      .setAttribute("position", new Float32BufferAttribute(at, 3))
      .setAttribute("color", new Float32BufferAttribute(rgba, 4));
    this.scene.fog = new Fog(colour("sky"), radius * 1.5, radius * 4);
    this.recolour();
  }

  recolour(): void {
    this.renderer.setClearColor(new Color(colour("sky")));
    this.floor.material.uniforms["plain"]!.value.set(colour("floor")).convertLinearToSRGB();
    this.dirty();
  }

  resize(width: number, height: number): void {
    if (width < 2 || height < 2) return;
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.renderer.setSize(width, height);
    this.canvas.style.width = this.canvas.style.height = "100%";
    this.dirty();
  }

  /** Looks at a point from a direction (x, y, z) so that a sphere of `radius` m is seen whole. */
  look(target: Vector3, direction: Vector3, radius: number): void {
    this.camera.fov = FOV;
    this.camera.updateProjectionMatrix();
    const half = Math.min(FOV, 2 * Math.atan(Math.tan((FOV * Math.PI) / 360) * this.camera.aspect) * (180 / Math.PI)) / 2;
    const distance = radius / Math.sin((half * Math.PI) / 180);
    this.controls.target.copy(target);
    this.camera.position.copy(target).addScaledVector(direction.clone().normalize(), distance);
    this.controls.update();
    this.dirty();
  }

  /** Stands where a camera stands and looks along `towards`, with its angle of view (degrees, vertical). */
  lookAs(position: Vector3, towards: Vector3, fov: number): void {
    this.camera.fov = fov;
    this.camera.updateProjectionMatrix();
    this.camera.position.copy(position);
    this.controls.target.copy(towards);
    this.controls.update();
    this.dirty();
  }

  /** passed: ms from the frame drawn before to the next one; by default to now. */
  draw(passed?: number): void {
    if (!this.software) return this.drawAt(Math.min(2, window.devicePixelRatio));
    this.drawAt(this.movingRatio(passed));
    clearTimeout(this.settle);
    this.settle = window.setTimeout(() => this.drawAt(SETTLED), SETTLE_MS);
  }

  /** By the usual time from one frame to the next; what comes after a pause says nothing about that. */
  private movingRatio(given?: number): number {
    const now = performance.now();
    const passed = given ?? now - this.drawn;
    this.drawn = now;
    if (passed > 400) return MOVING[this.coarse]!;
    this.usual += 0.2 * (passed - this.usual);
    const step = this.usual > SLOW_MS ? 1 : this.usual < FAST_MS ? -1 : 0;
    const next = Math.min(MOVING.length - 1, Math.max(0, this.coarse + step));
    if (next !== this.coarse) this.usual = (SLOW_MS + FAST_MS) / 2;
    this.coarse = next;
    return MOVING[next]!;
  }

  private drawAt(ratio: number): void {
    if (ratio !== this.ratio) {
      this.renderer.setPixelRatio(ratio);
      this.ratio = ratio;
    }
    this.renderer.clear();
    this.renderer.render(this.scene, this.camera);
    this.renderer.clearDepth();
    this.renderer.render(this.over, this.camera);
  }

  /** Numbers of geometries and textures held, to see that nothing piles up. */
  get held(): { geometries: number; textures: number } {
    return this.renderer.info.memory;
  }

  close(): void {
    clearTimeout(this.settle);
    this.controls.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }
}

/** One colour and nothing else: the floor fills half the picture, and light or gamma per pixel would cost too much. */
function plainMaterial(): ShaderMaterial {
  return new ShaderMaterial({
    uniforms: { plain: { value: new Color() } },
    vertexShader: "void main() { gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }",
    fragmentShader: "uniform vec3 plain; void main() { gl_FragColor = vec4(plain, 1.0); }",
  });
}

const TURN = Math.PI / 24;
const SHIFT = 0.06;
const CLOSER = 0.88;

/** Steers with the keys while the picture has the focus. A click does not give it that: arrows then go on to mean frames. */
function steer(stage: Stage): void {
  const { canvas } = stage;
  const keys: Record<string, () => void> = {
    ArrowLeft: () => stage.turn(-TURN, 0),
    ArrowRight: () => stage.turn(TURN, 0),
    ArrowUp: () => stage.turn(0, TURN),
    ArrowDown: () => stage.turn(0, -TURN),
    "Shift+ArrowLeft": () => stage.shift(-SHIFT, 0),
    "Shift+ArrowRight": () => stage.shift(SHIFT, 0),
    "Shift+ArrowUp": () => stage.shift(0, SHIFT),
    "Shift+ArrowDown": () => stage.shift(0, -SHIFT),
    "+": () => stage.approach(CLOSER),
    "=": () => stage.approach(CLOSER),
    "-": () => stage.approach(1 / CLOSER),
  };
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "application");
  canvas.addEventListener("mousedown", (event) => {
    event.preventDefault();
    if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
  });
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const act = keys[(event.shiftKey && event.key.length > 1 ? "Shift+" : "") + event.key];
    if (!act) return;
    act();
    event.preventDefault();
  });
}
