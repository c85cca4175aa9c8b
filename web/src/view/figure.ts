import {
  Bone, BufferGeometry, Color, CylinderGeometry, DynamicDrawUsage, Float32BufferAttribute, Group, InstancedMesh, Line,
  LineBasicMaterial, Matrix4, MeshBasicMaterial, MeshLambertMaterial, type Object3D, Quaternion, Skeleton, SkinnedMesh,
  SphereGeometry, Uint16BufferAttribute, Uint32BufferAttribute, Vector3,
} from "three";
import { LOST, side, type MeshData, type ViewData } from "../lib/bundle";
import { colour } from "../ui/theme";
import { Ellipsoids } from "./ellipsoids";

const TRAIL_S = 2;
const BONE_R = 0.011;
const JOINT_R = 0.02;

/** Joints and bones. Colours: by side, or one for all. */
export class Sticks {
  readonly group = new Group();
  private readonly balls: InstancedMesh;
  private readonly sticks: InstancedMesh;
  private readonly bones: [number, number][] = [];
  private readonly matrix = new Matrix4();
  private readonly from = new Vector3();
  private readonly to = new Vector3();
  private readonly turn = new Quaternion();
  private readonly middle = new Vector3();
  private readonly size = new Vector3();
  private doubted = "";

  constructor(
    parents: readonly number[],
    private readonly names: readonly string[],
    private readonly one: string | null,
    thickness = 1,
  ) {
    parents.forEach((p, j) => p >= 0 && this.bones.push([p, j]));
    const ball = new SphereGeometry(JOINT_R * thickness, 12, 8);
    const stick = new CylinderGeometry(BONE_R * thickness, BONE_R * thickness, 1, 8, 1);
    this.balls = new InstancedMesh(ball, new MeshLambertMaterial(), parents.length);
    this.sticks = new InstancedMesh(stick, new MeshLambertMaterial(), Math.max(1, this.bones.length));
    for (const mesh of [this.balls, this.sticks]) {
      mesh.frustumCulled = false;
      mesh.instanceMatrix.setUsage(DynamicDrawUsage);
      this.group.add(mesh);
    }
    this.recolour();
  }

  recolour(): void {
    const doubted = new Set(this.doubted ? this.doubted.split(",").map(Number) : []);
    const of = (j: number): Color => new Color(colour(doubted.has(j) ? "doubtful" : (this.one ?? side(this.names[j] ?? ""))));
    for (let j = 0; j < this.balls.count; j++) this.balls.setColorAt(j, of(j));
    this.bones.forEach(([, child], i) => this.sticks.setColorAt(i, of(child)));
    for (const mesh of [this.balls, this.sticks]) if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
  }

  /** Frees what the graphics card holds of it. */
  dispose(): void {
    for (const mesh of [this.balls, this.sticks]) {
      mesh.geometry.dispose();
      (mesh.material as MeshLambertMaterial).dispose();
      mesh.dispose();
    }
  }

  /** Shows some joints, and the bones that end in them, as doubtful. */
  doubt(joints: readonly number[]): void {
    const key = joints.join();
    if (key === this.doubted) return;
    this.doubted = key;
    this.recolour();
  }

  /** Moves to the joints (J, 3) that begin at `at`. */
  place(joints: Float32Array, at: number): void {
    for (let j = 0; j < this.balls.count; j++) {
      this.from.fromArray(joints, at + 3 * j);
      this.matrix.makeTranslation(this.from);
      if (!Number.isFinite(this.from.x)) this.matrix.makeScale(0, 0, 0);
      this.balls.setMatrixAt(j, this.matrix);
    }
    this.bones.forEach(([a, b], i) => {
      this.from.fromArray(joints, at + 3 * a);
      this.to.fromArray(joints, at + 3 * b);
      const length = this.from.distanceTo(this.to);
      if (length > 1e-6) {
        this.middle.addVectors(this.from, this.to).multiplyScalar(0.5);
        this.to.sub(this.from).divideScalar(length);
        this.turn.setFromUnitVectors(Y, this.to);
        this.matrix.compose(this.middle, this.turn, this.size.set(1, length, 1));
      } else this.matrix.makeScale(0, 0, 0);
      this.sticks.setMatrixAt(i, this.matrix);
    });
    this.balls.instanceMatrix.needsUpdate = this.sticks.instanceMatrix.needsUpdate = true;
  }
}
const Y = new Vector3(0, 1, 0);

/** The skinned body, moved by the graphics card, and its shadow on the floor. */
export class SkinnedBody {
  readonly group = new Group();
  private readonly bones: Bone[] = [];
  private readonly flat: Bone[] = [];
  private readonly material = new MeshLambertMaterial();
  private readonly shade = new MeshBasicMaterial();
  private readonly flatten = new Matrix4();
  private readonly position = new Vector3();
  private readonly turn = new Quaternion();
  private readonly one = new Vector3(1, 1, 1);

  /** tone: the name of its colour; clear: another body is seen through it. */
  constructor(
    private readonly data: ViewData,
    private readonly tone = "body",
    clear = false,
  ) {
    if (clear) Object.assign(this.material, { transparent: true, opacity: 0.45, depthWrite: false });
    const mesh = data.fine;
    const rest = data.restJoints;
    if (!mesh || !rest) throw new Error("no body");
    this.layShadow(data.header.floor);
    // nobody sees the detail of a shadow
    const low = data.coarse ?? mesh;
    for (const [bones, material, one] of [[this.bones, this.material, mesh], [this.flat, this.shade, low]] as const) {
      const inverses: Matrix4[] = [];
      for (let j = 0; j < data.joints; j++) {
        const bone = new Bone();
        bone.matrixAutoUpdate = bone.matrixWorldAutoUpdate = false;
        bones.push(bone);
        inverses.push(new Matrix4().makeTranslation(-rest[3 * j]!, -rest[3 * j + 1]!, -rest[3 * j + 2]!));
      }
      const skinned = new SkinnedMesh(geometryOf(one), material);
      skinned.bindMode = "detached";
      skinned.bind(new Skeleton(bones, inverses), new Matrix4());
      skinned.frustumCulled = false;
      this.group.add(skinned);
    }
    this.recolour();
  }

  /** Frees what the graphics card holds of it. */
  dispose(): void {
    for (const mesh of this.group.children as SkinnedMesh[]) {
      mesh.geometry.dispose();
      mesh.skeleton.dispose();
    }
    this.material.dispose();
    this.shade.dispose();
  }

  /** The shadow falls on a floor of this height (m), with the next frame that is placed. */
  layShadow(floor: number): void {
    // light from high above, a little from the side: x and y move with the height above the floor
    const f = floor + 0.002;
    this.flatten.set(1, 0, -0.25, 0.25 * f, 0, 1, 0.3, -0.3 * f, 0, 0, 0.001, f, 0, 0, 0, 1);
  }

  recolour(): void {
    this.material.color.set(colour(this.tone));
    this.shade.color.set(colour("shadow"));
  }

  /** Moves to a frame; a frame without a pose hides the body. */
  place(row: number): void {
    const { positions, rotations, joints } = this.data;
    if (!rotations) return;
    const known = Number.isFinite(rotations[4 * row * joints]!) && Number.isFinite(positions[3 * row * joints]!);
    for (const child of this.group.children) child.visible = known;
    if (!known) return;
    for (let j = 0; j < joints; j++) {
      const at = row * joints + j;
      this.position.fromArray(positions, 3 * at);
      this.turn.fromArray(rotations, 4 * at);
      const world = this.bones[j]!.matrixWorld.compose(this.position, this.turn, this.one);
      this.flat[j]!.matrixWorld.multiplyMatrices(this.flatten, world);
    }
    this.material.emissive.set(this.data.flags[row] === LOST ? colour("lost") : "#000000");
    this.material.emissiveIntensity = 0.35;
  }
}

function geometryOf(mesh: MeshData): BufferGeometry {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(mesh.vertices, 3));
  geometry.setAttribute("skinIndex", new Uint16BufferAttribute(mesh.skinIndex, 4));
  geometry.setAttribute("skinWeight", new Float32BufferAttribute(mesh.skinWeight, 4));
  geometry.setIndex(new Uint32BufferAttribute(mesh.faces, 1));
  geometry.computeVertexNormals();
  return geometry;
}

/** How sure the joints of a result are, at one frame. */
export class Spread {
  private readonly ellipsoids: Ellipsoids;

  constructor(private readonly data: ViewData) {
    this.ellipsoids = new Ellipsoids(data.joints);
  }

  get mesh(): Object3D {
    return this.ellipsoids.mesh;
  }

  recolour(): void {
    this.ellipsoids.recolour();
  }

  place(row: number): void {
    const { positions, covariance, joints } = this.data;
    for (let j = 0; j < joints; j++) {
      const at = row * joints + j;
      const p = [positions[3 * at]!, positions[3 * at + 1]!, positions[3 * at + 2]!] as const;
      this.ellipsoids.ellipsoid(j, p, covariance, 6 * at);
    }
  }
}

const TRAILED = ["pelvis", "left_wrist", "right_wrist", "left_ankle", "right_ankle"];

/** Where pelvis, hands and feet went in the last seconds. */
export class Trails {
  readonly group = new Group();
  private readonly before: number;

  constructor(data: ViewData) {
    this.before = Math.max(2, Math.round(TRAIL_S * data.header.frame_rate));
    data.header.joint_names.forEach((name, j) => {
      if (!TRAILED.includes(name)) return;
      const path = new Float32Array(3 * data.frames);
      for (let t = 0; t < data.frames; t++) {
        for (let k = 0; k < 3; k++) path[3 * t + k] = data.positions[3 * (t * data.joints + j) + k]!;
      }
      const geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(path, 3));
      const line = new Line(geometry, new LineBasicMaterial());
      line.name = name;
      line.frustumCulled = false;
      this.group.add(line);
    });
    this.recolour();
  }

  recolour(): void {
    for (const line of this.group.children as Line<BufferGeometry, LineBasicMaterial>[]) {
      line.material.color.set(colour(side(line.name)));
    }
  }

  place(row: number): void {
    const first = Math.max(0, row - this.before);
    for (const line of this.group.children as Line[]) line.geometry.setDrawRange(first, row - first + 1);
  }
}
