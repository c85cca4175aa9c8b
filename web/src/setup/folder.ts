import { address, get, post } from "../api";
import type { FolderEntry, FoundFile, NewRecording, Recording } from "../protocol";
import { button, select } from "../ui/buttons";
import { h } from "../ui/dom";
import { icon } from "../ui/icons";
import { toast } from "../ui/toast";
import { assign, camerasOf, chosenCalibration, obstacle, OF_A_CAMERA, type Role, type Seen } from "./assign";

interface Ready extends FoundFile {
  role: Role;
  camera: string;
  /** The user has said what it is, and of which camera. */
  said: { role: boolean; camera: boolean };
}

/** The server's sentence about a video of another shape than the calibration's pictures; the view's name is in it. */
export const STRETCHED = /View (.+?): .*accept_scaled/;
const ROLES: Record<Role, string> = {
  video: "video of", background: "empty room of", masks: "masks of", keypoints: "key points of", board: "board seen by", calibration: "calibration", none: "not used",
};
const FILMED: readonly Role[] = ["video", "background", "masks", "board", "none"];
const MAY_BE: Record<FoundFile["kind"], readonly Role[]> = {
  video: FILMED, images: FILMED, image: ["video", "background", "board", "none"], keypoints: ["keypoints", "none"], calibration: ["calibration", "none"], other: [],
};

/** What a view may consist of. */
const SHOWS: readonly Role[] = ["video", "masks", "keypoints"];

/** Choose the folder with the videos and their calibration, say which camera is which, and it is a recording. */
export class NewRecordingForm {
  readonly element: HTMLElement;
  private folder: FolderEntry | null = null;
  private asked = 0;
  private files: Ready[] = [];
  /** Cameras whose video was stretched, as the user has said. */
  private readonly stretched = new Set<string>();
  private readonly path = h("input", { type: "text", class: "grow", maxlength: 1000, spellcheck: "false", placeholder: "or type its path", "aria-label": "Folder" });
  private readonly folders = h("div", { class: "folder-rows" });
  private readonly list = h("div", { class: "found-files" });
  private readonly left = h("p", { class: "dim", role: "status" });
  private readonly form = h("form", { class: "new-recording", hidden: true });
  private readonly error = h("p", { class: "bad", role: "alert" });
  private readonly name = h("input", { type: "text", required: true, maxlength: 60, "aria-label": "Name of the recording" });
  private readonly height = h("input", { type: "number", min: 40, max: 280, step: 0.5, "aria-label": "Height of the person in cm" });
  private up = "z";
  private unit = "auto";
  /** Of a calibration that is there; one that is made here is known. */
  private readonly world = h("div", { class: "field" });
  private readonly make = button("Make the recording", () => undefined, { kind: "primary", icon: "done" });

  constructor(private readonly made: (recording: Recording) => void) {
    this.make.type = "submit";
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.submit();
    });
    const where = h("form", { class: "row" }, this.path, button("Look", () => void this.open(this.path.value), {}));
    where.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.open(this.path.value);
    });
    this.element = h(
      "section",
      { class: "card", "aria-label": "New recording" },
      h("h2", {}, "New recording"),
      h("p", { class: "dim" }, "Choose the folder with what you have filmed: a video per camera; clips of a calibration board, or a calibration (Pose2Sim, anipose, OpenCV, Qualisys, …), or neither; the empty room, key points and masks if there are any. The files stay where they are."),
      this.folders,
      where,
      this.list,
      this.left,
      this.form,
    );
    this.drawForm();
    void this.open("", false);
  }

  /** Shows a folder. An answer that comes after another folder was asked for is dropped, and leaves what was typed meanwhile. */
  private async open(path: string, within = true): Promise<void> {
    const asked = ++this.asked;
    const typed = this.path.value;
    let folder: FolderEntry;
    try {
      folder = await get<FolderEntry>(`/api/folder?path=${encodeURIComponent(path)}${within ? "&within" : ""}`);
    } catch (error) {
      return toast((error as Error).message, "error");
    }
    if (asked !== this.asked) return;
    this.folder = folder;
    if (this.path.value === typed) this.path.value = within ? folder.path : "";
    this.name.value = this.folder.name.replace(/[^A-Za-z0-9_.-]+/g, "-");
    this.stretched.clear();
    this.files = this.folder.files.map((f) => ({ ...f, role: "none", camera: "", said: { role: false, camera: false } }));
    const { left_out, recording, name } = this.folder;
    this.left.replaceChildren(
      ...(recording ? [`${name} is a recording: `, h("a", { href: `#/setup/${recording}` }, "go on with it"), "."] : []),
      left_out ? `${left_out} more files are not shown; name them in recording.toml.` : "",
      within && !recording && !this.files.length ? `Nothing in ${name} can be part of a recording.` : "",
    );
    this.assign();
    this.draw(within);
  }

  /** As the calibration calls them; without one, as their videos are called. */
  private get cameras(): string[] {
    const chosen = chosenCalibration(this.files.map(seen));
    return (chosen === undefined ? undefined : this.files[chosen]!.cameras) ?? camerasOf(this.files);
  }

  private assign(): void {
    const chosen = chosenCalibration(this.files.map(seen));
    const found = assign(this.files.map(seen), (chosen === undefined ? undefined : this.files[chosen]!.cameras) ?? []);
    this.files.forEach((f, k) => (f.role = found[k]!.role));
    const { cameras } = this;
    this.files.forEach((f, k) => {
      if (!f.said.camera || !cameras.includes(f.camera)) f.camera = found[k]!.camera;
    });
  }

  private draw(within = true): void {
    const row = (name: string, path: string, sign: "folder" | "back", inside = true): HTMLElement =>
      h("button", { type: "button", class: "folder-row", onclick: () => void this.open(path, inside) }, icon(sign), h("span", {}, name));
    const { folders = [], path = "", name = "" } = this.folder ?? {};
    this.folders.replaceChildren(
      within ? row("All folders", "", "back", false) : row(`${name} itself`, "", "folder"),
      ...(within && path.includes("/") ? [row("One up", path.replace(/\/[^/]*$/, ""), "back")] : []),
      ...folders.map((f) => row(f.name, f.path, "folder")),
    );
    this.list.replaceChildren(...this.files.map((f) => this.row(f)));
    const missing = obstacle(this.files.filter((f) => f.kind !== "other").map((f) => ({ ...f, name: f.path })));
    this.form.hidden = !this.files.length;
    this.world.hidden = !this.files.some((f) => f.role === "calibration");
    this.make.disabled = missing !== "";
    const without = this.cameras.filter((c) => !this.files.some((f) => SHOWS.includes(f.role) && f.camera === c));
    this.error.classList.toggle("bad", missing !== "");
    const bare = !this.files.some((f) => f.role === "calibration" || f.role === "board");
    this.error.textContent = missing || (bare ? "No calibration and no clips of a board are here, which need not be: the cameras are found from the person, who walks about and whose height you give, or by a board that you film later." : "") || (without.length ? `No video of ${without.join(", ")}: the recording is made without.` : "");
  }

  private row(f: Ready): HTMLElement {
    const roles = MAY_BE[f.kind];
    const open = OF_A_CAMERA.includes(f.role) && (!f.camera || this.files.some((o) => o !== f && o.role === f.role && o.camera === f.camera));
    const cameras = select("Camera", [{ value: "", label: "choose a camera" }, ...this.cameras.map((c) => ({ value: c, label: c }))], f.camera, (camera) => {
      f.camera = camera;
      f.said.camera = camera !== "";
      this.draw();
    });
    cameras.toggleAttribute("data-open", open);
    const name = f.path.split("/").pop() ?? f.path;
    const folders = f.path.slice(0, -name.length);
    const picture = FILMED === MAY_BE[f.kind] || f.kind === "image";
    const at = [this.folder!.path, f.path].filter(Boolean).join("/");
    return h(
      "div",
      { class: "found-file", "data-file": f.path },
      h("span", { class: "thumbnail file-picture" }, picture ? h("img", { src: address("/api/folder/picture.jpg", { path: at }), alt: `First picture of ${f.path}`, loading: "lazy" }) : icon(f.kind === "keypoints" ? "skeleton" : "report")),
      h("div", { class: "grow" }, h("b", {}, folders ? h("span", { class: "dim" }, folders) : null, name), h("div", { class: f.problem ? "bad" : "dim" }, f.problem ?? told(f))),
      !roles.length
        ? null
        : select("What it is", roles.map((value) => ({ value, label: ROLES[value] })), f.role, (role) => {
            f.role = role;
            f.said.role = true;
            this.assign();
            this.draw();
          }),
      OF_A_CAMERA.includes(f.role) ? cameras : null,
    );
  }

  private drawForm(): void {
    const field = (name: string, ...inputs: HTMLElement[]): HTMLElement =>
      h("div", { class: "field" }, h("span", { class: "field-name" }, name), h("div", { class: "row wrap" }, ...inputs));
    this.world.append(
      h("span", { class: "field-name" }, "Calibration"),
      h(
        "div",
        { class: "row wrap" },
        select("Up", ["z", "y", "x", "-y", "-z", "-x"].map((v) => ({ value: v, label: `${v} points up` })), this.up, (v) => (this.up = v)),
        select("Unit", [{ value: "auto", label: "unit as it seems" }, { value: "m", label: "metres" }, { value: "mm", label: "millimetres" }, { value: "cm", label: "centimetres" }], this.unit, (v) => (this.unit = v)),
      ),
    );
    this.form.append(
      field("Name", this.name),
      field("Height", this.height, h("span", { class: "dim" }, "cm, of the person, if known")),
      this.world,
      this.error,
      h("div", { class: "row" }, this.make),
    );
  }

  private async submit(): Promise<void> {
    const of = (role: Role, camera: string): { [key: string]: string } => {
      const found = this.files.find((f) => f.role === role && f.camera === camera);
      return found ? { [role]: found.path } : {};
    };
    const calibration = this.files.find((f) => f.role === "calibration")?.path;
    const cameras = [...new Set(this.files.filter((f) => SHOWS.includes(f.role)).map((f) => f.camera))];
    const views = cameras.map((camera) => ({
      name: camera, camera, ...Object.assign({}, ...OF_A_CAMERA.filter((r) => r !== "board" || !calibration).map((r) => of(r, camera))),
      ...(this.stretched.has(camera) ? { accept_scaled: true } : {}),
    }));
    const wanted: NewRecording = { folder: this.folder!.path, name: this.name.value.trim(), ...(calibration ? { calibration } : {}), views };
    if (this.up !== "z") wanted.world_up = this.up;
    if (this.unit !== "auto") wanted.calibration_unit = this.unit;
    if (this.height.value) wanted.subject_height = Number(this.height.value) / 100;
    this.make.disabled = true;
    try {
      const recording = await post<Recording>("/api/recordings", wanted);
      toast(`${recording.name} is ready.`, "done");
      this.made(recording);
    } catch (error) {
      this.draw();
      this.error.classList.add("bad");
      const { message } = error as Error;
      const [, camera] = STRETCHED.exec(message) ?? [];
      this.error.textContent = camera ? message.replace(/, set accept_scaled.*$/, ", accept it.") : message;
      if (!camera) return;
      this.error.append(" ", button("It was stretched: accept it", () => {
        this.stretched.add(camera);
        void this.submit();
      }, { icon: "done" }));
    }
  }
}

function seen(f: Ready): Seen {
  return { path: f.path, kind: f.kind, role: f.said.role ? f.role : undefined, cameras: f.cameras };
}

function told(file: FoundFile): string {
  if (file.kind === "calibration") return `calibration of ${(file.cameras ?? []).join(", ")}`;
  if (file.kind === "keypoints") return `key points of ${file.frames ?? 0} frames`;
  const size = file.size ? `${file.size[0]} × ${file.size[1]}` : "";
  if (file.kind === "image") return `picture, ${size}`;
  return [size, `${file.frames ?? "?"} frames`, file.frame_rate ? `${file.frame_rate.toFixed(1).replace(/\.0$/, "")} fps` : ""].filter(Boolean).join(", ");
}
