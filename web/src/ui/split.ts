import { h, memory } from "./dom";

/**
 * A bar between two panes that can be dragged or moved with the arrow keys. It sets the CSS variable `name` on `box`
 * to the share (in %) of the pane after the bar, within `range`, and remembers it.
 */
export function splitter(
  box: HTMLElement,
  name: string,
  direction: "columns" | "rows",
  label: string,
  initial: number,
  range: readonly [number, number] = [15, 75],
): HTMLElement {
  let share = initial;
  const set = (value: number): void => {
    share = Math.min(range[1], Math.max(range[0], value));
    box.style.setProperty(`--${name}`, `${share.toFixed(2)}%`);
    bar.setAttribute("aria-valuenow", share.toFixed(0));
  };
  const bar = h("div", {
    class: `splitter ${direction}`,
    role: "separator",
    tabindex: 0,
    "aria-label": label,
    "aria-orientation": direction === "columns" ? "vertical" : "horizontal",
    "aria-valuemin": range[0],
    "aria-valuemax": range[1],
  });
  bar.addEventListener("pointerdown", (down) => {
    bar.setPointerCapture(down.pointerId);
    const before = share; // from where it was taken: what lies behind the pane is no part of it
    const move = (event: PointerEvent): void => {
      const r = box.getBoundingClientRect();
      const by = direction === "columns" ? (down.clientX - event.clientX) / r.width : (down.clientY - event.clientY) / r.height;
      set(before + 100 * by);
    };
    bar.addEventListener("pointermove", move);
    bar.addEventListener("lostpointercapture", () => {
      bar.removeEventListener("pointermove", move);
      memory.set(`split.${name}`, share.toFixed(2));
    }, { once: true });
  });
  bar.addEventListener("keydown", (event) => {
    const more = direction === "columns" ? "ArrowLeft" : "ArrowUp";
    const less = direction === "columns" ? "ArrowRight" : "ArrowDown";
    if (event.key !== more && event.key !== less) return;
    set(share + (event.key === more ? 2 : -2));
    memory.set(`split.${name}`, share.toFixed(2));
    event.preventDefault();
    event.stopPropagation();
  });
  bar.addEventListener("dblclick", () => set(initial));
  set(Number(memory.get(`split.${name}`)) || initial);
  return bar;
}
