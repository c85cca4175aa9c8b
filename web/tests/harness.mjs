// A user's path through the page, in a real browser against a real server. A path is a file of its own:
//
//   import assert from "node:assert/strict";
//   import { walk } from "./harness.mjs";
//   await walk(async ({ page, address, picture }) => {
//     await page.getByRole("link", { name: "Gestures" }).click();
//     ...
//   });
//
// tests/app/studio/test_paths.py runs every *.path.mjs with STUDIO (the server's address), FOLDER (what it serves),
// CHROMIUM and PICTURES (a folder for pictures) in the environment; `// slow` in the first line marks a slow one, and
// `// folder: empty` one that starts with nothing in the served folder.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { join } from "node:path";
import { chromium } from "playwright-core";

const address = process.env.STUDIO ?? "http://127.0.0.1:8765/";
const folder = process.env.FOLDER ?? "";
const pictures = process.env.PICTURES ?? ".";
// The wrapper in /usr/bin of Debian prints warnings. As a browser is on a computer without a graphics card: it composes
// pages itself, and draws WebGL with SwiftShader, which has to be allowed. (SwiftShader passed off as a graphics card,
// --use-gl=angle --ignore-gpu-blocklist, would also have to compose every page, at ten times the cost of a picture.) Every
// host but this one is unknown to the browser.
const program = process.env.CHROMIUM ?? "/usr/lib/chromium/chromium";
const flags = [
  "--no-sandbox",
  "--enable-unsafe-swiftshader",
  "--disable-background-networking",
  "--autoplay-policy=no-user-gesture-required",
  "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
];

/** Opens a page and goes the path; the process fails when the path does, when the page, or one that the path opens with
 * `open`, reports an error, or when it asks for anything that is not the server's. options: of Playwright's page
 * (viewport, colorScheme); `at`: the screen to open, e.g. "#/gesture"; `expected`: a RegExp of console errors that belong
 * to the path. */
export async function walk(path, { at = "", expected, ...options } = {}) {
  const browser = await chromium.launch({ executablePath: program, args: flags, timeout: 240_000 });
  const foreign = [];
  const errors = [];
  const own = new URL(address).host;
  const asked = (url) => /^(data|blob):/.test(url) || new URL(url).host === own || foreign.push(url);
  const open = async (at) => {
    const page = await browser.newPage({ viewport: { width: 1280, height: 800 }, ...options });
    page.setDefaultTimeout(300_000); // of what hangs: a busy computer may take its time
    page.on("request", (request) => asked(request.url()));
    page.on("websocket", (socket) => asked(socket.url()));
    page.on("pageerror", (error) => errors.push(String(error.stack ?? error)));
    page.on("console", (message) => {
      if (message.type() === "error" && !expected?.test(message.text())) errors.push(message.text());
    });
    await page.goto(new URL(address).href + at, { waitUntil: "commit" });
    return page;
  };
  let page;
  const picture = (name) => page?.screenshot({ path: join(pictures, `${name}.png`) });
  let failed;
  try {
    page = await open(at);
    await path({ page, open, browser, address, folder, picture });
    assert.deepEqual(foreign, [], "requests that leave the server");
    assert.deepEqual(errors, [], "errors in the page");
  } catch (error) {
    failed = error;
    console.error(errors.join("\n"));
    await picture("failed")?.catch(() => undefined);
  }
  await browser.close();
  if (failed) throw failed;
}

/** What is cut off: controls and words that reach out of the page or of a box that hides the rest of them, words that do
 * not find room in their button, and controls that lie below another. What can be scrolled to is not cut off. */
const cutOff = (page) =>
  page.evaluate(() => {
    const faults = [];
    const told = (e) => `${e.tagName.toLowerCase()}.${e.className?.baseVal ?? e.className} "${(e.getAttribute("aria-label") || e.textContent || "").trim().slice(0, 40)}"`;
    if (document.scrollingElement.scrollWidth > innerWidth + 1) faults.push(`the page is ${document.scrollingElement.scrollWidth} px wide`);
    // words beside others of their kind, into which they would run
    const NARROW = ".plot-title, .prompt-bar span";
    const wanted = `${NARROW}, button, a, select, input:not(.sr-only), output, h1, h2, h3, legend, .chip, .field-name, summary, [role=slider], [role=tab]`;
    // what lies behind a dialog is behind it
    for (const e of (document.querySelector("dialog:modal") ?? document).querySelectorAll(wanted)) {
      const box = e.getBoundingClientRect();
      const style = getComputedStyle(e);
      if (!box.width || !box.height || style.visibility === "hidden" || e.closest("[hidden], .sr-only, dialog:not([open])")) continue;
      if (e.closest("details:not([open])") && e.tagName !== "SUMMARY") continue;
      if (["BUTTON", "A"].includes(e.tagName) && e.scrollWidth > e.clientWidth + 1 && style.overflow !== "visible") faults.push(`${told(e)}: its words`);
      if (box.left < -1 || box.right > innerWidth + 1) {
        const scrolled = (() => { for (let p = e.parentElement; p; p = p.parentElement) if (/auto|scroll/.test(getComputedStyle(p).overflowX)) return true; return false; })();
        if (!scrolled) faults.push(`${told(e)}: ${Math.round(box.left)} to ${Math.round(box.right)} of ${innerWidth}`);
      }
      const around = e.parentElement.getBoundingClientRect();
      if (e.matches(NARROW) && (box.left < around.left - 1 || box.right > around.right + 1)) faults.push(`${told(e)}: out of its place`);
      let hidden = false;
      for (let p = e.parentElement; p && p !== document.body; p = p.parentElement) {
        const { overflowX, overflowY } = getComputedStyle(p);
        const b = p.getBoundingClientRect();
        const x = /hidden|clip/.test(overflowX) && (box.left < b.left - 1 || box.right > b.right + 1);
        const y = /hidden|clip/.test(overflowY) && (box.top < b.top - 1 || box.bottom > b.bottom + 1);
        // words that end in dots say that there is more
        if ((x && style.textOverflow !== "ellipsis") || y) hidden = told(p);
        if (hidden || (/auto|scroll/.test(overflowX) && /auto|scroll/.test(overflowY))) break;
      }
      if (hidden) faults.push(`${told(e)}: cut by ${hidden}`);
      if (!e.matches("button, a, select, input") || e.disabled || style.pointerEvents === "none" || style.opacity === "0") continue;
      const [x, y] = [(box.left + box.right) / 2, (box.top + box.bottom) / 2];
      if (x < 0 || y < 0 || x >= innerWidth || y >= innerHeight) continue;
      // elementFromPoint looks at whole pixels: what the edge of a scrolled place runs through counts as scrolled away
      const away = (p) => { const b = p.getBoundingClientRect(); return x < b.left + 1 || x > b.right - 1 || y < b.top + 1 || y > b.bottom - 1; };
      let scrolledAway = false;
      for (let p = e.parentElement; p; p = p.parentElement) if (/auto|scroll/.test(getComputedStyle(p).overflow) && away(p)) scrolledAway = true;
      if (scrolledAway) continue;
      const top = document.elementFromPoint(x, y);
      if (top && !e.contains(top) && !top.contains(e) && !top.closest(".toasts, label")) faults.push(`${told(e)}: below ${told(top)}`);
    }
    return [...new Set(faults)];
  });

/** What stays cut off. In another window or with other contents parts of the page get their sizes a frame later, which on a
 * busy machine may be long: looked at at once, what is larger than its new place seems cut off. */
export const staysCutOff = async (page) => {
  for (let tries = 0; ; tries++) {
    const found = await cutOff(page);
    if (!found.length || tries >= 50) return found;
    await page.waitForTimeout(100);
  }
};

/** What axe-core finds that keeps people out who hear the page, use keys only, or see less: findings that it calls serious
 * or critical, as "rule: element". */
export const barriers = async (page) => {
  await page.evaluate(await axe());
  return page.evaluate(async () => {
    const { violations } = await window.axe.run(document, { resultTypes: ["violations"] });
    return violations
      .filter((v) => v.impact === "serious" || v.impact === "critical")
      .flatMap((v) => v.nodes.map((n) => `${v.id}: ${n.target.join(" ")} (${(n.any[0] ?? n.all[0] ?? n.none[0])?.message ?? v.help})`));
  });
};
let source;
const axe = async () => (source ??= await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf-8"));

/** Asserts that nothing is cut off and nothing is a barrier, in light and dark, at these sizes of the window. */
export const fits = async (page, sizes = [[1024, 700], [1280, 720], [1440, 900]]) => {
  for (const colorScheme of ["light", "dark"]) {
    await page.emulateMedia({ colorScheme, reducedMotion: "reduce" }); // no colours on their way
    for (const [width, height] of sizes) {
      await page.setViewportSize({ width, height });
      assert.deepEqual(await staysCutOff(page), []);
    }
    assert.deepEqual(await barriers(page), []);
  }
  await page.emulateMedia({ colorScheme: "light" });
};

/** A screenshot as soon as two in a row are the same. */
export const resting = async (take) => {
  for (let before = await take(), tries = 0; ; tries++) {
    const now = await take();
    if (now.equals(before) || tries > 40) return now;
    before = now;
  }
};

/** Waits until a screenshot is another one. */
export const other = async (take, before, message) => {
  for (let tries = 0; before.equals(await take()); tries++) assert.ok(tries < 60, message);
};

/** Value below which this share of a list lies. */
export const quantile = (list, share) => [...list].sort((a, b) => a - b)[Math.floor(share * (list.length - 1))] ?? NaN;

/** What this machine can do just now, to compare with: a page with nothing but an empty WebGL canvas of this size, which
 * is cleared in every frame, and in another colour after every click. */
export async function emptyScene(browser, width, height, clicks = 40) {
  const page = await browser.newPage({ viewport: { width: 1280, height: 800 } });
  await page.setContent(`<canvas width=${width} height=${height}></canvas>`);
  await page.evaluate(() => {
    const canvas = document.querySelector("canvas");
    const gl = canvas.getContext("webgl2");
    const seen = (window.seen = { frames: [], latency: [] });
    let before = 0;
    const draw = (now) => {
      gl.clearColor(Math.random(), 0, 0, 1);
      gl.clear(gl.COLOR_BUFFER_BIT);
      if (before) seen.frames.push(now - before);
      before = now;
      requestAnimationFrame(draw);
    };
    requestAnimationFrame(draw);
    // as the screens count it: until the frame after the one in which it was drawn
    canvas.addEventListener("pointerdown", (event) =>
      requestAnimationFrame(() => requestAnimationFrame(() => seen.latency.push(performance.now() - event.timeStamp))),
    );
  });
  for (let i = 1; i <= clicks; i++) {
    await page.mouse.click(50 + i, 50);
    await page.waitForFunction((n) => window.seen.latency.length >= n, i);
    await page.waitForTimeout(60);
  }
  const seen = await page.evaluate(() => window.seen);
  await page.close();
  return {
    empty_frame_p50_ms: quantile(seen.frames, 0.5),
    empty_click_p50_ms: quantile(seen.latency, 0.5),
    empty_click_p95_ms: quantile(seen.latency, 0.95),
  };
}
