type Child = Node | string | number | null | undefined | false;
type Props = Record<string, unknown>;

/**
 * A new element: h("button", { class: "quiet", onclick: go, "aria-label": "Go" }, "Go").
 * Functions become listeners (their name without "on"), true and false set or leave out the attribute.
 */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  props: Props = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(props)) {
    if (typeof value === "function") element.addEventListener(key.slice(2), value as EventListener);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(key, String(value));
  }
  put(element, ...children);
  return element;
}

/** Appends children; null, undefined and false are left out. */
export function put(parent: Element, ...children: Child[]): void {
  for (const child of children) {
    if (child === null || child === undefined || child === false) continue;
    parent.append(typeof child === "number" ? String(child) : child);
  }
}

/** Changes a text only where it is another one: even the same text laid out again costs a frame. */
export function setText(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** Calls `changed` with the size of an element in CSS pixels now and whenever it changes; returns how to stop. */
export function onResize(element: Element, changed: (width: number, height: number) => void): () => void {
  const observer = new ResizeObserver(([entry]) => {
    if (entry) changed(entry.contentRect.width, entry.contentRect.height);
  });
  observer.observe(element);
  return () => observer.disconnect();
}

/** A canvas whose pixels are those of the screen; draw is called with its size in CSS pixels after every change. */
export function sharpCanvas(
  label: string,
  draw: (context: CanvasRenderingContext2D, width: number, height: number) => void,
): { canvas: HTMLCanvasElement; redraw: () => void; stop: () => void } {
  const canvas = h("canvas", label ? { role: "img", "aria-label": label } : { "aria-hidden": "true" });
  let size: [number, number] = [0, 0];
  const redraw = (): void => {
    const [width, height] = size;
    if (!width || !height) return;
    const ratio = window.devicePixelRatio || 1;
    const pixels = [Math.round(width * ratio), Math.round(height * ratio)] as const;
    if (canvas.width !== pixels[0] || canvas.height !== pixels[1]) [canvas.width, canvas.height] = pixels;
    const context = canvas.getContext("2d");
    if (!context) return;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    draw(context, width, height);
  };
  const stop = onResize(canvas, (width, height) => {
    size = [width, height];
    redraw();
  });
  return { canvas, redraw, stop };
}

/** Small settings that outlive the page; where a browser keeps nothing (file://), they last as long as the page. */
const kept = new Map<string, string>();
export const memory = {
  get(key: string): string | null {
    try {
      return localStorage.getItem(`hypose.${key}`);
    } catch {
      return kept.get(key) ?? null;
    }
  },
  set(key: string, value: string): void {
    kept.set(key, value);
    try {
      localStorage.setItem(`hypose.${key}`, value);
    } catch {
      // kept in the page only
    }
  },
};

/** A sentence of the server without the parts that name an option or a command to be typed: the page has buttons. */
export function plain(text: string): string {
  const all = text.split(/(?<=[;,.:])\s+/);
  const parts = all.filter((part) => !/(^|\s)--[a-z]|\bhypose [a-z]+/.test(part));
  const said = parts.join(" ").replace(/; or /g, "; ");
  if (!parts.length) return text;
  return parts.length < all.length ? said.replace(/[;,:](?= [A-Z]|$)/g, ".") : said;
}
