/** What the page and the server exchange; docs/studio-protocol.md says what it means. */

export type Id = string;

export interface RecordingEntry { id: Id; name: string; path: string; results: Id[] }
export interface ResultEntry {
  id: Id; name: string; path: string; recording: Id | null; recipe: string; frames: number; frame_rate: number;
  complete: boolean; changed: number;
  /** It can be tracked again from a corrected frame. */
  correctable: boolean;
  /** There are pictures beside it. */
  pictured: boolean;
  /** Absent where the motion cannot be read; lost: share of the frames. */
  assessment?: "good" | "look" | "not to be trusted" | null; sentence?: string | null; iou?: number | null; sd_mm?: number | null; lost?: number;
}
/** A recording of live sensors; result: what it was fused to. */
export interface SkeletonsEntry { id: Id; name: string; path: string; result: Id | null }
export interface ModelEntry {
  id: Id; path: string; gesture: string; threshold: number | null;
}
export interface SourceEntry { value: string; title: string; gestures?: string[]; missing?: string }

export interface State {
  version: string; root: string; recordings: RecordingEntry[]; results: ResultEntry[];
  models: ModelEntry[]; sources: SourceEntry[];
  skeletons: SkeletonsEntry[]; jobs: Job[];
}

/** An option of a job, as its command declares it; choices: empty where any value of its kind is taken. */
export interface JobOption { name: string; kind: string; default: unknown; help: string; choices: string[] }
/** The options of each kind of job that a page may set. */
export type JobForms = Record<string, JobOption[]>;

export interface CameraInfo {
  name: string; K: number[][]; camera_from_world: number[][]; size: [number, number]; pictures: boolean;
}
export interface ViewInfo {
  name: string; camera: string; video: string | null; background: string | null; masks: string | null;
  keypoints: string | null; depth: string | null;
}
export type MaskSettings = Record<string, number | boolean | string>;
/** done: it has been put right since. */
export interface Finding { done?: boolean; fault: boolean; sentence: string; views: string[]; kind: string; cure?: string }
/** stale: the recording has been changed since. */
export interface Check {
  stale: boolean;
  healthy: boolean; facts: string[]; warnings: string[]; findings: Finding[]; page: string | null;
  views: { name: string; residual_px: number | null; left_out_px: number | null; tangency_px: number | null }[];
}
export interface Recording {
  id: Id; name: string; path: string; problem: string | null; frame_rate: number; frames: number;
  frame_range: [number, number] | null; subject_height: number | null; views: ViewInfo[]; cameras: CameraInfo[];
  notes: string[]; mask_settings: MaskSettings; check: Check | null;
  subject: { stature_m: number; sizes_cm: Record<string, number> } | null; results: Id[]; starts: string[];
  /** Views that were left out; a refined calibration that is not used yet. */
  left_out: string[]; refined: string | null;
  /** Kind of the next job on the way to a motion, null: the user is to act; the same recording on one clock. */
  next: JobKind | null; in_step: Id | null;
  /** Frames by which each view is late. */
  offsets: number[] | null;
  /** Clips of a calibration board: their cameras; whether these are calibrated; when the sheet of what was seen was made. */
  board: { cameras: string[]; calibrated: boolean; sheet: number | null } | null;
  /** How many frames late each view was found to be. */
  sync: { by: string; views: { name: string; late: number; how: string }[] } | null;
}

/** What in a folder can be part of a recording; path: from that folder. */
export interface FoundFile {
  path: string; kind: "video" | "image" | "images" | "keypoints" | "calibration" | "other"; size?: [number, number]; frames?: number;
  frame_rate?: number | null; cameras?: string[]; problem?: string;
}
/** A folder of the served one; path: from there, as of its folders. */
export interface FolderEntry {
  name: string; path: string; recording: Id | null; folders: { name: string; path: string }[]; files: FoundFile[]; left_out: number;
}
/** Files by their paths in the folder. */
export interface NewView {
  name: string; camera: string; video?: string; background?: string; masks?: string; keypoints?: string; board?: string; accept_scaled?: boolean;
}
export interface NewRecording {
  folder: string; name: string; calibration?: string; frame_rate?: number; world_up?: string; calibration_unit?: string;
  subject_height?: number; views: NewView[];
}

export type JobKind = "calibrate" | "sync" | "in_step" | "check" | "keypoints" | "silhouettes" | "subject" | "track" | "correct" | "export" | "demo" | "refine" | "fuse";
export type JobState = "queued" | "running" | "done" | "failed" | "cancelled";
export interface Stage {
  name: string; title: string; done: number; total: number; seconds: number; unit: string;
}
export interface Job {
  /** The next job on the way to a motion follows by itself. */
  go_on: boolean;
  id: Id; kind: JobKind; title: string; command: string; recording: Id | null; result: Id | null; makes?: Id | null; state: JobState;
  options: Record<string, unknown>; stages: Stage[]; lines: string[]; error: string | null; created: number;
  began: number | null; ended: number | null; resumable: boolean;
}
export interface NewJob { kind: JobKind; recording?: Id; result?: Id; options?: Record<string, unknown> }
export type JobsMessage = { t: "jobs"; jobs: Job[] } | { t: "job"; job: Job } | { t: "files" };

export interface ClickedPoint { joint: string; x: number; y: number; occluded?: boolean }
/** recorded: in pixels of the picture as it was recorded; else undistorted ones. */
export interface ClickedView { camera: string; points: ClickedPoint[]; recorded?: boolean }
export interface FitRequest {
  recording?: Id | null; result?: Id | null; frame: number; height?: number | null; start?: number[] | null;
  views: ClickedView[];
}
export interface Fit {
  pose: number[]; joints: number[][]; rotations: number[][]; joint_sd: number[]; covariance: number[][];
  pixels: Record<string, Record<string, [number, number]>>; rms_px: number;
  worst: { camera: string; joint: string; px: number } | null; depth_sd: number | null; notes: string[];
  alternatives: { pose: number[]; joints: number[][]; rotations: number[][]; cost: number; flipped: string[] }[];
}
export interface ClickJoint { joint: string; title: string }

export type Phase = "do_gesture" | "positive" | "release" | "negative" | "test";
export type GestureCommand = "next" | "undo" | "pause" | "continue" | "again" | "test";
export interface PhaseSeconds { do_gesture: number; positive: number; release: number; negative: number }
export type GestureRequest =
  | {
      t: "start"; mode: "train"; gesture: string; source: string; resume?: Id | null; rounds?: number;
      seconds?: Partial<PhaseSeconds>; seed?: number; fast?: boolean;
    }
  | { t: "start"; mode: "run"; models: Id[]; source: string; seed?: number; fast?: boolean }
  | { t: "command"; command: GestureCommand }
  | { t: "box"; x: number; y: number }
  | { t: "threshold"; value: number | null }
  | { t: "hold"; seconds: number }
  | { t: "map"; on: boolean }
  | { t: "save" }
  | { t: "stop" }
  | { t: "ack"; seq: number };

/** [time, score, high, low, threshold, phase] */
export type HistoryRow = [number, number | null, number | null, number | null, number | null, string];
export interface GestureSession {
  mode: "train" | "run"; gestures: string[]; models: Id[]; source: string; title: string; size: [number, number];
  rounds: number; seconds: PhaseSeconds; folder: string | null; resume: Id | null;
  history: HistoryRow[]; judged: GestureJudged | null;
}
export interface GestureEvent { event: "start" | "end"; gesture: string; time: number; x: number; y: number; score: number }
export interface GestureFound { gesture: string; score: number; x: number; y: number; threshold: number | null }
export interface GestureStep {
  t: "step"; seq: number; time: number; phase: Phase; prompt: string; left_s: number | null; round: number;
  paused: boolean; box: [number, number, number] | null; cross: [number, number] | null;
  position: [number, number, number] | null; learned: number[] | null; mined: [number, number][];
  score: number | null; high: number | null; low: number | null; threshold: number | null; manual: boolean;
  detected: boolean;
  counts: { gesture: number; negative: number; pixels: number; nodes: number; segments: number };
  events: GestureEvent[]; found?: GestureFound[];
}
export interface GestureJudged {
  t: "judged"; on: "segments" | "test"; ap: number | null; frames: number; positives: number; precision: number[]; recall: number[];
  scores: number[]; false_per_min: number | null; tested_s: number;
}
export type GestureMessage =
  | { t: "hello"; session: GestureSession | null }
  | GestureStep
  | GestureJudged
  | { t: "saved"; model: Id; path: string; recording: Id | null }
  | { t: "said"; text: string }
  | { t: "error"; error: string }
  | { t: "ended"; why: string };

export const DEPTH = 1;
export const MAP = 2;
/** A binary WebSocket message: 16 bytes of header, then the picture. */
export interface Picture { type: number; stream: number; seq: number; time: number; data: Uint8Array<ArrayBuffer> }

export function readPicture(message: ArrayBuffer): Picture {
  const view = new DataView(message);
  return {
    type: view.getUint8(0),
    stream: view.getUint8(1),
    seq: view.getUint32(4, true),
    time: view.getFloat64(8, true),
    data: new Uint8Array(message, 16),
  };
}
