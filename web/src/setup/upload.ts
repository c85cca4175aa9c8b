import { address, post, put } from "../api";
import type { NewRecording, Recording, Upload } from "../protocol";
import { button, select } from "../ui/buttons";
import { h } from "../ui/dom";
import { icon } from "../ui/icons";
import { toast } from "../ui/toast";

interface Dropped {
  file: File;
  /** How much of it is there. */
  bar: HTMLProgressElement;
  upload: (Upload & { problem?: string }) | null;
  error: string | null;
  /** What the file is for: the video of a camera, its empty room, or nothing. */
  role: "video" | "background" | "none";
  camera: string;
}

/** Names that people give to pictures of a room without anybody in it. */
const EMPTY_ROOM = /background|empty|plate|(^|[^a-z])bg([^a-z]|$)/i;

/** Drop videos and their calibration, say which camera is which, and a recording is made of them. */
export class NewRecordingForm {
  readonly element: HTMLElement;
  private readonly files: Dropped[] = [];
  private readonly list = h("div", { class: "dropped" });
  private readonly form = h("form", { class: "new-recording", hidden: true });
  private readonly error = h("p", { class: "bad", role: "alert" });
  private readonly name = h("input", { type: "text", value: "recording", required: true, maxlength: 60, pattern: "[A-Za-z0-9_.\\-]+", "aria-label": "Name of the recording" });
  private readonly height = h("input", { type: "number", min: 40, max: 280, step: 0.5, "aria-label": "Height of the person in cm" });
  private up = "z";
  private unit = "auto";
  private readonly make = button("Make the recording", () => undefined, { kind: "primary", icon: "done" });

  constructor(private readonly made: (recording: Recording) => void) {
    const chooser = h("input", { type: "file", multiple: true, class: "sr-only", "aria-label": "Videos and calibration", tabindex: -1 });
    chooser.addEventListener("change", () => {
      this.add([...(chooser.files ?? [])]);
      chooser.value = "";
    });
    const zone = h(
      "div",
      { class: "drop" },
      icon("download"),
      h("div", {}, h("b", {}, "Drop the videos of all cameras and their calibration"), h("p", { class: "dim" }, "One video per camera, the calibration file (Pose2Sim, anipose, OpenCV, Qualisys, …), and pictures of the empty room if there are any.")),
      button("Choose files", () => chooser.click(), {}),
      chooser,
    );
    for (const kind of ["dragover", "dragleave", "drop"] as const) {
      zone.addEventListener(kind, (event) => {
        event.preventDefault();
        zone.toggleAttribute("data-over", kind === "dragover");
        if (kind === "drop") this.add([...(event.dataTransfer?.files ?? [])]);
      });
    }
    this.make.type = "submit";
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.submit();
    });
    this.element = h("section", { class: "card", "aria-label": "New recording" }, h("h2", {}, "New recording"), zone, this.list, this.form);
    this.drawForm();
  }

  private add(files: File[]): void {
    for (const file of files) {
      const one: Dropped = { file, bar: h("progress", { max: 1, value: 0, "aria-label": `Sending ${file.name}` }), upload: null, error: null, role: "none", camera: "" };
      this.files.push(one);
      put<Upload>(`/api/uploads/${encodeURIComponent(file.name)}`, file, (share) => (one.bar.value = share))
        .then((upload) => {
          one.upload = upload;
          const empty = upload.kind === "image" || (upload.kind === "video" && EMPTY_ROOM.test(upload.name));
          one.role = empty ? "background" : upload.kind === "video" ? "video" : "none";
          this.guess();
        })
        .catch((error: Error) => (one.error = error.message))
        .finally(() => this.draw());
    }
    this.draw();
  }

  private get cameras(): string[] {
    return this.files.flatMap((f) => (f.upload?.kind === "calibration" ? (f.upload.cameras ?? []) : []));
  }

  private get calibration(): Dropped | undefined {
    return this.files.find((f) => f.upload?.kind === "calibration");
  }

  /** Cameras for files that have none yet: by the name, else the next that is free. */
  private guess(): void {
    const cameras = this.cameras;
    for (const role of ["video", "background"] as const) {
      const mine = this.files.filter((f) => f.role === role);
      for (const f of mine) if (!cameras.includes(f.camera)) f.camera = named(f.file.name, cameras);
      for (const f of mine) {
        if (f.camera) continue;
        f.camera = cameras.find((c) => !mine.some((other) => other.camera === c)) ?? "";
      }
    }
  }

  private remove(one: Dropped): void {
    this.files.splice(this.files.indexOf(one), 1);
    if (one.upload) void fetch(address(`/api/uploads/${one.upload.upload}`), { method: "DELETE" });
    this.draw();
  }

  private draw(): void {
    this.list.replaceChildren(...this.files.map((f) => this.row(f)));
    const ready = this.calibration && this.files.some((f) => f.role === "video" && f.camera);
    this.form.hidden = !this.files.length;
    this.make.disabled = !ready || this.files.some((f) => !f.upload && !f.error);
    this.error.textContent = this.missing();
  }

  private missing(): string {
    if (!this.files.length || this.files.some((f) => !f.upload && !f.error)) return "";
    if (!this.calibration) return "The calibration is missing: drop the file that says where the cameras stand.";
    if (!this.files.some((f) => f.role === "video")) return "The videos are missing: drop one per camera.";
    const cameras = this.files.filter((f) => f.role === "video").map((f) => f.camera);
    const twice = cameras.find((c, k) => c && cameras.indexOf(c) !== k);
    return twice ? `Two videos are of the camera ${twice}; choose another camera for one of them.` : "";
  }

  private row(f: Dropped): HTMLElement {
    const facts = f.error ?? (f.upload ? (f.upload.problem ?? told(f.upload)) : "being sent");
    const usable = f.upload?.kind === "video" || f.upload?.kind === "image";
    return h(
      "div",
      { class: "dropped-file" },
      icon(f.upload?.kind === "video" ? "camera" : f.upload?.kind === "image" ? "picture" : "report"),
      h("div", { class: "grow" }, h("b", {}, f.file.name), h("div", { class: f.error || f.upload?.problem ? "bad" : "dim" }, facts), f.upload || f.error ? null : f.bar),
      usable
        ? select("What it is", [{ value: "video", label: "video of" }, { value: "background", label: "empty room of" }, { value: "none", label: "not used" }], f.role, (role) => {
            f.role = role as Dropped["role"];
            this.draw();
          })
        : null,
      usable && f.role !== "none"
        ? select("Camera", [{ value: "", label: "choose a camera" }, ...this.cameras.map((c) => ({ value: c, label: c }))], f.camera, (camera) => {
            f.camera = camera;
            this.draw();
          })
        : null,
      button("", () => this.remove(f), { icon: "close", kind: "quiet", title: `Remove ${f.file.name}` }),
    );
  }

  private drawForm(): void {
    const field = (name: string, ...inputs: HTMLElement[]): HTMLElement =>
      h("div", { class: "field" }, h("span", { class: "field-name" }, name), h("div", { class: "row" }, ...inputs));
    this.form.append(
      field("Name", this.name),
      field("Height", this.height, h("span", { class: "dim" }, "cm, of the person, if known")),
      field(
        "Calibration",
        select("Up", ["z", "y", "x", "-y", "-z", "-x"].map((v) => ({ value: v, label: `${v} points up` })), this.up, (v) => (this.up = v)),
        select("Unit", [{ value: "auto", label: "unit as it seems" }, { value: "m", label: "metres" }, { value: "mm", label: "millimetres" }, { value: "cm", label: "centimetres" }], this.unit, (v) => (this.unit = v)),
      ),
      this.error,
      h("div", { class: "row" }, this.make),
    );
  }

  private async submit(): Promise<void> {
    const background = (camera: string): Dropped | undefined => this.files.find((f) => f.role === "background" && f.camera === camera);
    const views = this.files
      .filter((f) => f.role === "video" && f.upload && f.camera)
      .map((f) => {
        const empty = background(f.camera)?.upload?.upload;
        return { name: f.camera, camera: f.camera, video: f.upload!.upload, ...(empty ? { background: empty } : {}) };
      });
    const wanted: NewRecording = { name: this.name.value.trim(), calibration: this.calibration?.upload?.upload ?? "", views };
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
      this.error.textContent = (error as Error).message;
    }
  }
}

function told(upload: Upload): string {
  if (upload.kind === "calibration") return `calibration of ${(upload.cameras ?? []).join(", ")}`;
  if (upload.kind === "other") return "no video, picture or calibration; it is not used";
  const size = upload.size ? `${upload.size[0]} × ${upload.size[1]}` : "";
  if (upload.kind === "image") return `picture, ${size}`;
  return [`video, ${size}`, `${upload.frames ?? "?"} frames`, upload.frame_rate ? `${upload.frame_rate.toFixed(1).replace(/\.0$/, "")} frames/s` : ""].filter(Boolean).join(", ");
}

/** The camera whose name a file carries: the same name, or the longest that is part of it. */
function named(file: string, cameras: readonly string[]): string {
  const stem = file.replace(/\.[^.]*$/, "").toLowerCase();
  const same = cameras.find((c) => c.toLowerCase() === stem);
  const part = [...cameras].sort((a, b) => b.length - a.length).find((c) => stem.includes(c.toLowerCase()));
  return same ?? part ?? "";
}
