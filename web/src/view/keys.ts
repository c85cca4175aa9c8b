import type { Key } from "../ui/keyboard";
import type { ResultView } from "./result";
import type { Layer } from "./space";

/** The keys of the View screen. */
export function viewKeys(view: ResultView): Key[] {
  const second = Math.max(1, Math.round(view.player.rate));
  const layer = (key: string, name: Layer, what: string): Key => ({ keys: [key], shown: key, what, act: () => view.flip(name) });
  return [
    { keys: [" "], shown: "Space", what: "play or pause", act: () => view.player.toggle() },
    { keys: ["ArrowLeft"], shown: "←", what: "one frame back", act: () => view.player.step(-1) },
    { keys: ["ArrowRight"], shown: "→", what: "one frame on", act: () => view.player.step(1) },
    { keys: ["Shift+ArrowLeft", "PageUp"], shown: "Shift ←", what: "one second back", act: () => view.player.step(-second) },
    { keys: ["Shift+ArrowRight", "PageDown"], shown: "Shift →", what: "one second on", act: () => view.player.step(second) },
    { keys: ["["], shown: "[", what: "slower", act: () => view.player.faster(-1) },
    { keys: ["]"], shown: "]", what: "faster", act: () => view.player.faster(1) },
    { keys: ["Home"], shown: "Home", what: "first frame", act: () => view.go(0) },
    { keys: ["End"], shown: "End", what: "last frame", act: () => view.go(view.player.rows - 1) },
    { keys: ["n"], shown: "n", what: "next stretch that is lost, extrapolated or doubtful", act: () => view.nextFlag(1) },
    { keys: ["p"], shown: "p", what: "previous one", act: () => view.nextFlag(-1) },
    { keys: ["f"], shown: "f", what: "see the whole walk", act: () => view.look("fit") },
    { keys: ["k"], shown: "k", what: "keep the person in the middle", act: () => view.flipFollow() },
    ...(view.corrector ? [{ keys: ["e"], shown: "e", what: "correct this frame", act: () => view.corrector?.flip() }] : []),
    layer("b", "body", "body"),
    layer("s", "skeleton", "skeleton"),
    layer("u", "spread", "uncertainty"),
    layer("o", "rivals", "other poses that explain the pictures as well"),
    layer("t", "trails", "trails"),
    layer("c", "cameras", "cameras"),
    layer("g", "truth", "truth, where it is known"),
    ...[1, 2, 3, 4, 5, 6, 7, 8, 9].map((n): Key => ({
      keys: [String(n)],
      shown: n === 1 ? "1 … 9" : "",
      what: "enlarge that camera's picture",
      act: () => view.cameras.enlarge(n - 1),
    })),
    { keys: ["+", "="], shown: "+ −", what: "the enlarged picture larger, smaller (the wheel too; drag to move it)", act: () => void view.cameras.closer(1) },
    { keys: ["-"], shown: "", what: "", act: () => void view.cameras.closer(-1) },
    { keys: ["Escape"], shown: "Esc", what: "all pictures again", act: () => void (view.cameras.shrink() || view.corrector?.leave()) },
  ];
}
