/** What /ws/fuse sends (docs/studio-protocol.md, docs/live.md). */
export interface Person {
  id: number;
  seen: boolean;
  sensors: string[];
  joints: (number | null)[][];
  sd: (number | null)[];
}
export interface SensorStatus {
  name: string;
  alive: boolean;
  rate: number;
  registered: boolean;
  residual: number | null;
  /** (4, 4) to the frame of the first sensor, m. */
  place: number[][] | null;
}
/** How live cameras run (/ws/cameras). played: the recording's own videos. */
export interface CamerasRunning {
  recording: string;
  cameras: string[];
  ws: number;
  osc: string | null;
  vmc: string | null;
  record: string | null;
  played: boolean;
  /** (4, 4) of every camera to the world, m. */
  places: number[][][];
}
export interface CameraStatus {
  name: string;
  rate: number;
  lost: number;
  trouble: string;
}
/** A pose as on /out (docs/cameras-live.md). */
export interface CameraPose {
  id: number;
  n: number;
  latency_ms: number;
  lost: boolean;
  cameras: string[];
  joints: (number | null)[][];
  sd: (number | null)[];
}
export type CamerasMessage =
  | { t: "hello"; running: false | CamerasRunning; joints: string[]; parents: number[]; devices: { number: number; name: string }[] }
  | { t: "frame"; people: CameraPose[] }
  | {
      t: "status"; phase: string; words: string[]; cameras: CameraStatus[]; poses: number; per_second: number; skipped: number;
      latency_ms: (number | null)[]; stages_ms: Record<string, number | null>; fitted: boolean;
    }
  | { t: "pictures"; cameras: { name: string; jpeg: string | null }[] }
  | { t: "said"; text: string }
  | { t: "error"; error: string };
export interface Running {
  udp: number;
  ws: number;
  simulated: boolean;
  osc: string | null;
  record: string | null;
}
export type LiveMessage =
  | { t: "hello"; running: false | Running; joints: string[]; parents: number[] }
  | { t: "frame"; n: number; time: number; latency_ms: number; people: Person[] }
  | { t: "status"; sensors: SensorStatus[]; received: number; ignored: number; frames: number; dropped: number }
  | { t: "said"; text: string }
  | { t: "error"; error: string };
