import { address } from "../api";
import type { GestureRequest, ModelEntry, PhaseSeconds, SourceEntry, State } from "../protocol";
import { button, select, type Choice } from "../ui/buttons";
import { h, memory } from "../ui/dom";
import { icon, type IconName } from "../ui/icons";
import { PHASES } from "./live";

const USUAL: PhaseSeconds = { do_gesture: 3, positive: 5, release: 2, negative: 8 };
const NEW = "";
/** What the simulated person does. */
const MEANT: Readonly<Record<string, string>> = {
  tee: "a flat hand on the finger tips of the other",
  cross: "both forearms crossed before the chest",
  pause: "an open palm held up",
  silence: "the index finger before the lips",
  ok: "thumb and index finger form a ring",
  volume_up: "a thumb up",
};

interface Wish {
  source: string;
  gesture: string;
  resume: string;
  rounds: number;
  seconds: PhaseSeconds;
  fast: boolean;
}

interface Kind {
  name: string;
  title: string;
  text: string;
  icon: IconName;
  sources: SourceEntry[];
}

/** What to teach, from where; and what has been taught, to go on with it or to watch for it. */
export function startPage(state: State, begin: (request: GestureRequest) => void): HTMLElement {
  const kinds = kindsOf(state);
  const wish: Wish = {
    source: usable(state.sources, memory.get("gesture.source")) ?? kinds[0]?.sources[0]?.value ?? "",
    gesture: memory.get("gesture.name") ?? "tee",
    resume: NEW,
    rounds: 10,
    seconds: { ...USUAL },
    fast: false,
  };
  const form = h("form", { class: "card teach", "aria-label": "Teach a gesture" });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    memory.set("gesture.source", wish.source);
    memory.set("gesture.name", wish.gesture);
    const { source, gesture, rounds, seconds, fast } = wish;
    begin({ t: "start", mode: "train", source, gesture, rounds, seconds, fast, resume: wish.resume || null });
  });
  const draw = (): void => form.replaceChildren(...teachFields(state, kinds, wish, draw));
  draw();
  const goOn = (model: ModelEntry): void => {
    wish.gesture = model.gesture;
    wish.resume = model.id;
    draw();
    form.querySelector<HTMLElement>("button[type=submit]")?.focus();
  };
  return h(
    "div",
    { class: "gesture-home" },
    h(
      "div",
      { class: "gesture-intro" },
      h("h1", {}, "Teach a gesture"),
      h("p", { class: "dim" }, "Stand two metres away and follow the words on the screen. After about three minutes it knows your gesture; nothing has to be clicked meanwhile."),
    ),
    h("div", { class: "gesture-columns" }, form, taught(state, wish, begin, goOn)),
  );
}

/** The form. Choosing a source draws it anew; typing does not, because the click that ends it must find its button. */
function teachFields(state: State, kinds: Kind[], wish: Wish, draw: () => void): HTMLElement[] {
  const chosen = kinds.find((k) => k.sources.some((s) => s.value === wish.source)) ?? kinds[0];
  const source = chosen?.sources.find((s) => s.value === wish.source);
  const gestures = source?.gestures ?? [];
  if (gestures.length && !gestures.includes(wish.gesture)) wish.gesture = gestures[0]!;
  const total = h("span", { class: "dim number" });
  const showTotal = (): void => {
    const seconds = wish.rounds * Object.values(wish.seconds).reduce((a, b) => a + b, 0);
    total.textContent = `${minutes(seconds)} in all`;
  };
  const learn = h("div", { class: "row" });
  const showLearn = (): void => learn.replaceChildren(learnSelect(state, wish));
  showTotal();
  showLearn();
  const start = button("Start", () => undefined, { kind: "primary", icon: "play" });
  start.type = "submit";
  start.classList.add("big");
  return [
    h("h2", {}, "Who is seen"),
    h("div", { class: "kinds", role: "radiogroup", "aria-label": "Source" }, ...kinds.map((k) => kindCard(k, k === chosen, wish, draw))),
    ...(chosen && chosen.sources.length > 1 ? [field(chosen.name === "simulated" ? "Person" : "Which one", sourceSelect(chosen, wish, draw))] : []),
    field("Gesture", gestures.length ? gestureSelect(gestures, wish, draw) : gestureName(wish, showLearn), ...(gestures.length ? [h("span", { class: "dim" }, MEANT[wish.gesture] ?? "")] : [])),
    field("Learn", learn),
    field("Rounds", number("Rounds", wish.rounds, 1, 100, 1, (n) => {
      wish.rounds = n;
      showTotal();
    }), total),
    timing(wish, showTotal),
    h("div", { class: "row" }, start, h("span", { class: "dim" }, "Enter")),
  ];
}

/** From the beginning, or on with a model of the same gesture. */
function learnSelect(state: State, wish: Wish): HTMLElement {
  const again = state.models.filter((m) => m.gesture === wish.gesture);
  if (!again.some((m) => m.id === wish.resume)) wish.resume = NEW;
  const choices = [{ value: NEW, label: "from the beginning" }, ...again.map((m) => ({ value: m.id, label: `on with ${m.path}` }))];
  return select<string>("Learn", choices, wish.resume, (value) => (wish.resume = value));
}

function kindsOf(state: State): Kind[] {
  const of = (test: (value: string) => boolean): SourceEntry[] => state.sources.filter((s) => test(s.value));
  return [
    { name: "simulated", title: "Simulated person", text: "no camera needed; does what the screen says", icon: "body", sources: of((v) => v.startsWith("simulated")) },
    { name: "camera", title: "Depth camera", text: "you, in front of the computer", icon: "camera", sources: of((v) => !v.startsWith("simulated") && !v.startsWith("session")) },
    { name: "session", title: "Recorded session", text: "what was recorded here before", icon: "list", sources: of((v) => v.startsWith("session")) },
  ];
}

function usable(sources: readonly SourceEntry[], value: string | null): string | null {
  return sources.find((s) => s.value === value && !s.missing)?.value ?? null;
}

function kindCard(kind: Kind, chosen: boolean, wish: Wish, draw: () => void): HTMLElement {
  const first = kind.sources.find((s) => !s.missing);
  const why = kind.sources[0]?.missing ?? (kind.name === "session" ? "none yet; every session you teach is recorded" : "none is connected");
  return h(
    "button",
    {
      type: "button",
      class: "kind",
      role: "radio",
      "aria-checked": String(chosen),
      "data-kind": kind.name,
      disabled: !first,
      title: first ? null : why,
      onclick: () => {
        if (!chosen && first) wish.source = first.value;
        draw();
      },
    },
    icon(kind.icon),
    h("b", {}, kind.title),
    h("small", {}, first ? kind.text : why),
  );
}

function sourceSelect(kind: Kind, wish: Wish, draw: () => void): HTMLElement {
  const choices: Choice<string>[] = kind.sources.filter((s) => !s.missing).map((s) => ({ value: s.value, label: s.title }));
  return select("Which one", choices, wish.source, (value) => {
    wish.source = value;
    draw();
  });
}

function gestureSelect(gestures: readonly string[], wish: Wish, changed: () => void): HTMLElement {
  return select("Gesture", gestures.map((g) => ({ value: g, label: g.replaceAll("_", " ") })), wish.gesture, (value) => {
    wish.gesture = value;
    changed();
  });
}

function gestureName(wish: Wish, changed: () => void): HTMLElement {
  const input = h("input", {
    type: "text", value: wish.gesture, required: true, maxlength: 64, pattern: "[A-Za-z0-9_\\-]+", "aria-label": "Gesture",
    title: "Letters, digits, - and _",
  });
  input.addEventListener("input", () => {
    wish.gesture = input.value.trim();
    changed();
  });
  return input;
}

function timing(wish: Wish, changed: () => void): HTMLElement {
  const details = h("details", { class: "timing", open: memory.get("gesture.timing") === "open" }, h("summary", {}, "Timing"));
  details.addEventListener("toggle", () => memory.set("gesture.timing", details.open ? "open" : "shut"));
  for (const { phase, short } of PHASES) {
    details.append(field(short, number(short, wish.seconds[phase], 0, 600, "any", (n) => {
      wish.seconds[phase] = n;
      changed();
    }), h("span", { class: "dim" }, "s")));
  }
  const fast = h("input", { type: "checkbox", checked: wish.fast });
  fast.addEventListener("change", () => (wish.fast = fast.checked));
  details.append(field("Fast", h("label", {}, fast, "as fast as the computer can (not with a camera)")));
  return details;
}

function taught(state: State, wish: Wish, begin: (request: GestureRequest) => void, goOn: (model: ModelEntry) => void): HTMLElement {
  const list = h("section", { class: "card taught", "aria-label": "Your gestures" }, h("h2", {}, "Your gestures"));
  if (!state.models.length) {
    list.append(h("p", { class: "dim" }, "None yet. Teach one: with the simulated person you see in a minute how it goes."));
    return list;
  }
  const watch = (models: ModelEntry[]): void =>
    begin({ t: "start", mode: "run", models: models.map((m) => m.id), source: wish.source, fast: wish.fast });
  for (const model of state.models) {
    const t = model.threshold;
    list.append(
      h(
        "div",
        { class: "model" },
        gesturePicture(model.id),
        h("div", { class: "grow" }, h("b", {}, model.gesture), h("div", { class: "dim" }, model.path, t ? ` · threshold ${t.toFixed(1)} cm²` : " · no threshold yet")),
        button("Go on", () => goOn(model), { icon: "plus", title: "Teach it more" }),
        t ? button("Watch", () => watch([model]), { icon: "play", title: "Watch for this gesture" }) : null,
      ),
    );
  }
  const each = [...new Map(state.models.filter((m) => m.threshold).map((m) => [m.gesture, m])).values()];
  if (each.length > 1) list.append(h("div", { class: "row" }, button(`Watch for all ${each.length}`, () => watch(each.slice(0, 16)), { icon: "play" })));
  list.append(h("p", { class: "dim" }, "Watching uses the source chosen at the left."));
  return list;
}

/** What the depth camera saw of a gesture when it was taught; a sign where no session is left that shows it. */
export function gesturePicture(model: string): HTMLElement {
  const box = h("span", { class: "thumbnail gesture-picture", "aria-hidden": "true" }, icon("hand"));
  const image = h("img", { alt: "", src: address(`/api/models/${model}/thumbnail.jpg`), onload: () => box.replaceChildren(image) });
  return box;
}

function field(name: string, ...inputs: HTMLElement[]): HTMLElement {
  return h("div", { class: "field" }, h("span", { class: "field-name" }, name), h("div", { class: "row" }, ...inputs));
}

function number(
  label: string, value: number, low: number, high: number, step: number | "any", changed: (value: number) => void,
): HTMLElement {
  const input = h("input", { type: "number", value, min: low, max: high, step, required: true, "aria-label": label });
  input.addEventListener("input", () => {
    if (input.validity.valid) changed(Number(input.value));
  });
  return input;
}

function minutes(seconds: number): string {
  return seconds < 90 ? `${Math.round(seconds)} s` : `${(seconds / 60).toFixed(1).replace(/\.0$/, "")} min`;
}
