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
}
export type LiveMessage =
  | { t: "hello"; running: false | { udp: number; ws: number }; joints: string[]; parents: number[] }
  | { t: "frame"; n: number; time: number; latency_ms: number; people: Person[] }
  | { t: "status"; sensors: SensorStatus[]; received: number; ignored: number; frames: number; dropped: number }
  | { t: "error"; error: string };
