/** Short tones for people who stand away from the screen; made here, nothing is loaded. */

let context: AudioContext | undefined;
let muted = false;

export function setMuted(value: boolean): void {
  muted = value;
}

function tone(frequency: number, at: number, seconds: number, loudness: number): void {
  if (!context) return;
  const oscillator = context.createOscillator();
  const gain = context.createGain();
  oscillator.frequency.value = frequency;
  const start = context.currentTime + at;
  gain.gain.setValueAtTime(0, start);
  gain.gain.linearRampToValueAtTime(loudness, start + 0.01);
  gain.gain.exponentialRampToValueAtTime(0.0005, start + seconds);
  oscillator.connect(gain).connect(context.destination);
  oscillator.start(start);
  oscillator.stop(start + seconds + 0.02);
}

const TUNES = {
  tick: [[660, 0, 0.08, 0.12]],
  go: [[880, 0, 0.3, 0.2]],
  release: [[587, 0, 0.12, 0.16], [440, 0.12, 0.25, 0.16]],
  done: [[523, 0, 0.15, 0.16], [659, 0.14, 0.15, 0.16], [784, 0.28, 0.35, 0.18]],
  detected: [[1047, 0, 0.16, 0.16]],
  wrong: [[196, 0, 0.3, 0.16]],
} as const;

/** Plays a tone; silent when muted or before the page was touched (browsers allow no sound until then). */
export function play(name: keyof typeof TUNES): void {
  if (muted || typeof AudioContext === "undefined") return;
  context ??= new AudioContext();
  if (context.state === "suspended") void context.resume();
  for (const [frequency, at, seconds, loudness] of TUNES[name]) tone(frequency, at, seconds, loudness);
}
