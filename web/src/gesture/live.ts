import type {
  GestureEvent, GestureJudged, GestureMessage, GestureSession, GestureStep, HistoryRow, Id, Phase,
} from "../protocol";

const KEPT = 4000;
const LOGGED = 200;

export interface LogEntry extends GestureEvent {
  /** Length of what has ended, s. */
  seconds: number | null;
}

/** What the page knows of the session; the server's messages change it. */
export interface Live {
  connected: boolean;
  session: GestureSession | null;
  step: GestureStep | null;
  judged: GestureJudged | null;
  history: HistoryRow[];
  log: LogEntry[];
  saved: { model: Id; path: string } | null;
  ended: string | null;
}

export function emptyLive(): Live {
  return { connected: false, session: null, step: null, judged: null, history: [], log: [], saved: null, ended: null };
}

/** Takes a message into the state; true when another picture of the page is to be shown (start, end). */
export function take(live: Live, message: GestureMessage): boolean {
  switch (message.t) {
    case "hello": {
      const known = live.session !== null && live.ended === null;
      if (message.session === null && known) live.ended = "The server was started anew; what was recorded is kept.";
      if (message.session === null) return known || live.session === null;
      const connected = live.connected;
      Object.assign(live, emptyLive(), { connected, session: message.session });
      live.history = [...message.session.history];
      live.judged = message.session.judged;
      return true;
    }
    case "step":
      takeStep(live, message);
      return false;
    case "judged":
      live.judged = message;
      return false;
    case "saved":
      live.saved = { model: message.model, path: message.path };
      return false;
    case "ended":
      live.ended = message.why;
      return true;
    default:
      return false;
  }
}

function takeStep(live: Live, step: GestureStep): void {
  const last = live.history.at(-1);
  if (!last || step.time > last[0]) {
    live.history.push([step.time, step.score, step.high, step.low, step.threshold, step.phase]);
    if (live.history.length > KEPT) live.history.splice(0, KEPT / 4);
  }
  live.step = step;
  for (const event of step.events) {
    const start = event.event === "end" ? live.log.find((e) => e.event === "start" && e.gesture === event.gesture) : undefined;
    if (start && start.seconds === null) start.seconds = event.time - start.time;
    else if (event.event === "start") live.log.unshift({ ...event, seconds: null });
  }
  live.log.length = Math.min(live.log.length, LOGGED);
}

/** What delivers the pictures, in words. */
export function sourceTitle({ source, title }: GestureSession): string {
  const [kind, person] = source.split(":");
  if (kind === "simulated") return `Simulated person ${Number(person ?? 0) + 1}`;
  return kind === "session" ? `Recorded session ${title}` : "RealSense camera";
}

/** Something a command changes; two that differ show that a command was answered. */
export function signature(step: GestureStep | null): string {
  if (!step) return "";
  return [step.phase, step.paused, step.round, step.counts.segments, step.manual, step.manual ? step.threshold : ""].join();
}

interface PhaseWords {
  phase: Exclude<Phase, "test">;
  /** To be read from two metres. */
  words: string;
  short: string;
  what: string;
}

export const PHASES: readonly PhaseWords[] = [
  { phase: "do_gesture", words: "Do it in the box", short: "Do it", what: "Bring your hand into the box and do the gesture." },
  { phase: "positive", words: "Hold it", short: "Hold", what: "Hold it and vary it a little: nearer, turned, tilted. It is being learned." },
  { phase: "release", words: "Release", short: "Release", what: "Let your arms down." },
  {
    phase: "negative",
    words: "Anything else",
    short: "Anything else",
    what: "Move as you like, but without the gesture. Where it is seen wrongly, that is learned.",
  },
];
