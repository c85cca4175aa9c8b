import { address, post, put } from "../api";
import type { NewRecording, Recording, Upload } from "../protocol";
import { button, select } from "../ui/buttons";
import { h } from "../ui/dom";
import { icon } from "../ui/icons";
import { toast } from "../ui/toast";
import { assign, camerasOf, chosenCalibration, obstacle, OF_A_CAMERA, type Role, type Seen } from "./assign";
import { filesOfInput, onDrop, type DroppedFile } from "./dropped";

interface Ready extends DroppedFile {
  /** How much of it is there. */
  bar: HTMLProgressElement;
  thumbnail: HTMLElement;
  upload: (Upload & { problem?: string }) | null;
  error: string | null;
  role: Role;
  camera: string;
  /** The user has said what it is, and of which camera. */
  said: { role: boolean; camera: boolean };
}

const AT_ONCE = 3;
const MOST = 60;
const USABLE = /\.(mp4|avi|mov|mkv|m4v|webm|mpe?g|wmv|mts|png|jpe?g|bmp|tiff?|webp|toml|json|ya?ml|xml|csv|txt|pickle|npz|npy|h5)$/i;
/** Pictures and tables of which a folder has one per frame. */
const NUMBERED = /\d{3,}(_keypoints)?\.(png|jpe?g|bmp|tiff?|webp|json|txt)$/i;
/** The server's sentence about a video of another shape than the calibration's pictures; the view's name is in it. */
export const STRETCHED = /View (.+?): .*accept_scaled/;
const ROLES: Record<Role, string> = {
  video: "video of", background: "empty room of", masks: "masks of", keypoints: "key points of", board: "board seen by", calibration: "calibration", none: "not used",
};
const MAY_BE: Record<Upload["kind"], readonly Role[]> = {
  video: ["video", "background", "masks", "board", "none"],
  image: ["video", "background", "board", "none"], keypoints: ["keypoints", "none"], calibration: ["calibration", "none"], other: [],
};

/** What a view may consist of. */
const SHOWS: readonly Role[] = ["video", "masks", "keypoints"];

/** Drop videos and their calibration, say which camera is which, and a recording is made of them. */
export class NewRecordingForm {
  readonly element: HTMLElement;
  private readonly files: Ready[] = [];
  private readonly queue: Ready[] = [];
  /** Cameras whose video was stretched, as the user has said. */
  private readonly stretched = new Set<string>();
  private sending = 0;
  private readonly list = h("div", { class: "dropped" });
  private readonly left = h("p", { class: "dim" });
  private readonly form = h("form", { class: "new-recording", hidden: true });
  private readonly error = h("p", { class: "bad", role: "alert" });
  private readonly name = h("input", { type: "text", value: "recording", required: true, maxlength: 60, pattern: "[A-Za-z0-9_.\\-]+", "aria-label": "Name of the recording" });
  private readonly height = h("input", { type: "number", min: 40, max: 280, step: 0.5, "aria-label": "Height of the person in cm" });
  private up = "z";
  private unit = "auto";
  /** Of a calibration that is dropped; one that is made here is known. */
  private readonly world = h("div", { class: "field" });
  private readonly make = button("Make the recording", () => undefined, { kind: "primary", icon: "done" });
  private readonly stop: () => void;

  constructor(private readonly made: (recording: Recording) => void) {
    const chooser = this.chooser({ multiple: true, "aria-label": "Videos and calibration" });
    const folder = this.chooser({ webkitdirectory: true, "aria-label": "A folder of files" });
    const zone = h(
      "div",
      { class: "drop" },
      icon("download"),
      h("div", {}, h("b", {}, "Drop what you have filmed"), h("p", { class: "dim" }, "Files or whole folders, anywhere on the page: a video per camera; clips of a calibration board, or a calibration (Pose2Sim, anipose, OpenCV, Qualisys, …); the empty room, key points and masks if there are any.")),
      h("div", { class: "drop-choose" }, button("Choose files", () => chooser.click(), {}), button("Choose a folder", () => folder.click(), {})),
      chooser,
      folder,
    );
    this.make.type = "submit";
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.submit();
    });
    this.element = h("section", { class: "card", "aria-label": "New recording" }, h("h2", {}, "New recording"), zone, this.list, this.left, this.form);
    this.drawForm();
    this.stop = onDrop((files) => this.add(files));
  }

  close(): void {
    this.stop();
  }

  private chooser(props: Record<string, unknown>): HTMLInputElement {
    const input = h("input", { type: "file", class: "sr-only", tabindex: -1, ...props });
    input.addEventListener("change", () => {
      this.add(filesOfInput(input));
      input.value = "";
    });
    return input;
  }

  private add(files: readonly DroppedFile[]): void {
    const whole = files.filter((f) => !(f.path.includes("/") && NUMBERED.test(f.path)));
    const usable = whole.filter((f) => USABLE.test(f.file.name));
    const fresh = usable.filter((f) => !this.files.some((old) => same(old, f)));
    const taken = fresh.slice(0, Math.max(0, MOST - this.files.length));
    const told: string[] = [];
    if (usable.length > fresh.length) told.push(`${number(usable.length - fresh.length, "file")} already here`);
    if (files.length > whole.length) told.push(`${number(files.length - whole.length, "file")} left out, of folders with one per frame: name these in recording.toml, where they lie`);
    if (whole.length > usable.length) told.push(`${number(whole.length - usable.length, "file")} left out: no video, picture, calibration or key points`);
    if (fresh.length > taken.length) told.push(`${number(fresh.length - taken.length, "file")} left out: ${MOST} at most`);
    this.left.textContent = told.length ? `${told.join("; ")}.` : "";
    for (const { file, path } of taken) {
      const one: Ready = {
        file, path, upload: null, error: null, role: "none", camera: "", said: { role: false, camera: false },
        bar: h("progress", { max: 1, value: 0, "aria-label": `Sending ${file.name}` }),
        thumbnail: h("span", { class: "thumbnail dropped-picture" }),
      };
      this.files.push(one);
      this.queue.push(one);
    }
    this.files.sort((a, b) => a.path.localeCompare(b.path, undefined, { numeric: true }));
    this.draw();
    this.send();
  }

  private send(): void {
    while (this.sending < AT_ONCE && this.queue.length) {
      const one = this.queue.shift()!;
      this.sending++;
      put<Upload>(`/api/uploads/${encodeURIComponent(one.file.name)}`, one.file, (share) => (one.bar.value = share))
        .then((upload) => {
          one.upload = upload;
          if (upload.kind === "video" || upload.kind === "image") {
            one.thumbnail.append(h("img", { src: address(`/api/uploads/${upload.upload}/picture.jpg`), alt: `First picture of ${one.file.name}` }));
          }
          if (!this.files.includes(one)) this.forget(one); // removed while it was on its way
        })
        .catch((error: Error) => (one.error = error.message))
        .finally(() => {
          this.sending--;
          if (!this.coming) this.assign();
          this.draw();
          this.send();
        });
    }
  }

  /** Files that are not there yet. Before all are, no camera is given to any: their order says nothing. */
  private get coming(): number {
    return this.files.filter((f) => !f.upload && !f.error).length;
  }

  /** As the calibration calls them; without one, as their videos are called. */
  private get cameras(): string[] {
    return this.calibrated.length ? this.calibrated : camerasOf(this.files.filter((f) => f.upload));
  }

  private get calibrated(): string[] {
    const all = this.files.filter((f) => f.upload);
    const chosen = chosenCalibration(all.map(seen));
    return chosen === undefined ? [] : (all[chosen]!.upload!.cameras ?? []);
  }

  private assign(): void {
    const all = this.files.filter((f) => f.upload);
    const found = assign(all.map(seen), this.calibrated);
    all.forEach((f, k) => (f.role = found[k]!.role));
    const { cameras } = this;
    all.forEach((f, k) => {
      if (!f.said.camera || !cameras.includes(f.camera)) f.camera = found[k]!.camera;
    });
  }

  private remove(one: Ready): void {
    this.files.splice(this.files.indexOf(one), 1);
    if (this.queue.includes(one)) this.queue.splice(this.queue.indexOf(one), 1);
    this.forget(one);
    if (!this.coming) this.assign();
    this.draw();
  }

  private forget(one: Ready): void {
    if (one.upload) void fetch(address(`/api/uploads/${one.upload.upload}`), { method: "DELETE" });
  }

  private draw(): void {
    this.list.replaceChildren(...this.files.map((f) => this.row(f)));
    const missing = this.coming ? "" : obstacle(this.files.filter((f) => f.upload).map((f) => ({ ...f, name: f.path })));
    this.form.hidden = !this.files.length;
    this.world.hidden = !this.files.some((f) => f.role === "calibration");
    this.make.disabled = this.coming > 0 || missing !== "";
    this.error.textContent = missing;
    const without = this.cameras.filter((c) => !this.files.some((f) => SHOWS.includes(f.role) && f.camera === c));
    const some = !this.coming && !missing && without.length > 0;
    this.error.classList.toggle("bad", !some);
    if (some) this.error.textContent = `No video of ${without.join(", ")}: the recording is made without.`;
  }

  private row(f: Ready): HTMLElement {
    const facts = f.error ?? (f.upload ? (f.upload.problem ?? told(f.upload)) : "being sent");
    const kind = f.upload?.kind;
    const roles = kind ? MAY_BE[kind] : [];
    const open = OF_A_CAMERA.includes(f.role) && (!f.camera || this.files.some((o) => o !== f && o.role === f.role && o.camera === f.camera));
    const cameras = select("Camera", [{ value: "", label: "choose a camera" }, ...this.cameras.map((c) => ({ value: c, label: c }))], f.camera, (camera) => {
      f.camera = camera;
      f.said.camera = camera !== "";
      this.draw();
    });
    cameras.toggleAttribute("data-open", open);
    const name = f.path.split("/").pop() ?? f.path;
    const folders = f.path.slice(0, -name.length);
    return h(
      "div",
      { class: "dropped-file", "data-file": f.path },
      f.thumbnail.hasChildNodes() ? f.thumbnail : h("span", { class: "thumbnail dropped-picture" }, icon(kind === "video" ? "camera" : kind === "image" ? "picture" : kind === "keypoints" ? "skeleton" : "report")),
      h("div", { class: "grow" }, h("b", {}, folders ? h("span", { class: "dim" }, folders) : null, name), h("div", { class: f.error || f.upload?.problem ? "bad" : "dim" }, facts), f.upload || f.error ? null : f.bar),
      this.coming || !roles.length
        ? null
        : select("What it is", roles.map((value) => ({ value, label: ROLES[value] })), f.role, (role) => {
            f.role = role;
            f.said.role = true;
            this.assign();
            this.draw();
          }),
      this.coming || !roles.length || f.role === "none" || f.role === "calibration" ? null : cameras,
      button("", () => this.remove(f), { icon: "close", kind: "quiet", title: `Remove ${name}` }),
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
      const found = this.files.find((f) => f.role === role && f.camera === camera)?.upload?.upload;
      return found ? { [role]: found } : {};
    };
    const calibration = this.files.find((f) => f.role === "calibration")?.upload?.upload;
    const cameras = [...new Set(this.files.filter((f) => SHOWS.includes(f.role) && f.upload).map((f) => f.camera))];
    const views = cameras.map((camera) => ({
      name: camera, camera, ...Object.assign({}, ...OF_A_CAMERA.filter((r) => r !== "board" || !calibration).map((r) => of(r, camera))),
      ...(this.stretched.has(camera) ? { accept_scaled: true } : {}),
    }));
    const wanted: NewRecording = { name: this.name.value.trim(), ...(calibration ? { calibration } : {}), views };
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
  return { path: f.path, kind: f.upload!.kind, role: f.said.role ? f.role : undefined, cameras: f.upload!.cameras };
}

/** The same file again: dropped twice, or once by itself and once with its folder. */
function same(a: DroppedFile, b: DroppedFile): boolean {
  const alone = !a.path.includes("/") || !b.path.includes("/");
  const named = a.file.name === b.file.name && a.file.size === b.file.size && a.file.lastModified === b.file.lastModified;
  return named && (alone || a.path === b.path);
}

function number(count: number, what: string): string {
  return `${count} ${what}${count === 1 ? "" : "s"}`;
}

function told(upload: Upload): string {
  if (upload.kind === "calibration") return `calibration of ${(upload.cameras ?? []).join(", ")}`;
  if (upload.kind === "other") return "no video, picture or calibration; it is not used";
  if (upload.kind === "keypoints") return `key points of ${number(upload.frames ?? 0, "frame")}`;
  const size = upload.size ? `${upload.size[0]} × ${upload.size[1]}` : "";
  if (upload.kind === "image") return `picture, ${size}`;
  return [size, `${upload.frames ?? "?"} frames`, upload.frame_rate ? `${upload.frame_rate.toFixed(1).replace(/\.0$/, "")} fps` : ""].filter(Boolean).join(", ");
}
