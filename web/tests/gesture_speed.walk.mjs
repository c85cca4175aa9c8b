// How fast the gesture screen is while a recorded session of 30 pictures a second is watched: the bare canvas of the same
// pictures (what browser and server can do at all), the screen alone, and the screen while a result is played in 3D with
// its plots beside it: pictures per second, and the time from a click to its effect. It wants a studio whose folder has a
// gesture model, a recorded session and a result; tests/app/studio/test_speed_browser.py makes them. Prints JSON.
import { emptyScene, quantile, walk } from "./harness.mjs";

const SECONDS = 8;
const CLICKS = 40;

/** Waits for what a page says of itself; fails with a sentence, so that nobody waits for ever. */
async function until(page, what, test, argument) {
  await page.waitForFunction(test, argument, { timeout: 60_000 }).catch(async () => {
    const ended = await page.evaluate(() => window.__app?.live?.ended ?? null);
    throw new Error(`${what}: not within 60 s${ended === null ? "" : `; the session has ended: ${ended}`}`);
  });
}

/** A page of the same server with nothing but a canvas that shows the pictures, and a click on it that pauses or goes on. */
async function bareCanvas(open) {
  const page = await open("#/view");
  await page.getByRole("heading", { name: "Results" }).waitFor();
  await page.evaluate(() => {
    document.body.innerHTML = "<canvas width=640 height=480></canvas>";
    const canvas = document.querySelector("canvas");
    const g = canvas.getContext("2d", { alpha: false, willReadFrequently: true });
    const app = (window.__app = { pictures: 0, latency: [] });
    const socket = new WebSocket(`${location.origin.replace("http", "ws")}/ws/gesture`);
    socket.binaryType = "arraybuffer";
    let asked = 0;
    socket.onmessage = async ({ data }) => {
      if (typeof data === "string") {
        const step = JSON.parse(data);
        if (step.t !== "step") return;
        if (asked && step.paused !== app.paused) {
          const since = asked;
          asked = 0;
          requestAnimationFrame(() => requestAnimationFrame(() => app.latency.push(performance.now() - since)));
        }
        app.paused = step.paused;
        return;
      }
      const bitmap = await createImageBitmap(new Blob([data.slice(16)], { type: "image/jpeg" }));
      requestAnimationFrame(() => {
        g.drawImage(bitmap, 0, 0);
        bitmap.close();
        app.pictures++;
        socket.send(JSON.stringify({ t: "ack", seq: new DataView(data).getUint32(4, true) }));
      });
    };
    canvas.addEventListener("pointerup", (event) => {
      asked = event.timeStamp;
      socket.send(JSON.stringify({ t: "command", command: app.paused ? "continue" : "pause" }));
    });
  });
  await until(page, "The bare canvas shows pictures", () => window.__app.pictures > 30);
  return page;
}

/** Pictures per second that are on the screen. */
async function rate(page) {
  const counted = () => page.evaluate(() => [window.__app.pictures, performance.now()]);
  const [before, began] = await counted();
  await page.waitForTimeout(1000 * SECONDS);
  const [after, now] = await counted();
  return { pictures_per_s: (1000 * (after - before)) / (now - began) };
}

/** From a click on Pause or Go on to the frame after the one that shows its effect. */
async function clicks(page, click) {
  await page.evaluate(() => (window.__app.latency.length = 0));
  for (let k = 0; k < CLICKS; k++) {
    await click(k % 2 === 0);
    await until(page, `Click ${k + 1} is answered`, (n) => window.__app.latency.length > n, k);
    await page.waitForTimeout(60);
  }
  const latency = await page.evaluate(() => window.__app.latency);
  return { click_p50_ms: quantile(latency, 0.5), click_p95_ms: quantile(latency, 0.95) };
}

await walk(
  async ({ page, open, browser, address, picture }) => {
    await page.getByRole("radio", { name: /Recorded session/ }).click();
    await page.getByRole("button", { name: "Watch", exact: true }).first().click();
    await until(page, "The screen shows pictures", () => window.__app.pictures > 30);

    const canvas = await bareCanvas(open);
    await page.evaluate(() => (location.hash = "#/view"));
    const bare = { ...(await rate(canvas)), ...(await clicks(canvas, () => canvas.mouse.click(200, 200))) };
    await page.evaluate(() => (location.hash = "#/gesture"));
    await until(page, "The screen goes on with the session", () => window.__app?.pictures > 30);
    await canvas.close();

    await page.keyboard.press("m");
    await page.waitForTimeout(1000);
    const press = (pause) => page.getByRole("button", { name: pause ? "Pause" : "Go on", exact: true }).click();
    const alone = { ...(await rate(page)), ...(await clicks(page, press)) };
    await picture("gesture-speed");

    const { results } = await (await fetch(new URL("api/state", address))).json();
    const long = [...results].sort((a, b) => b.frames - a.frames)[0];
    const body = await open(`#/view/${long.id}`);
    await until(body, "The result is shown", () => window.hypose && document.querySelector(".where")?.textContent);
    await body.keyboard.press("Space");
    await body.waitForTimeout(1500);
    await body.evaluate(() => (window.hypose.frames.length = 0));
    const live = await rate(page);
    const frames = await body.evaluate(() => [...window.hypose.frames]);
    const with_body_and_plots = { ...live, body_frames_per_s: 1000 / quantile(frames, 0.5), ...(await clicks(page, press)) };
    await body.screenshot({ path: `${process.env.PICTURES}/view-speed.png` });
    await body.close();
    await page.getByRole("button", { name: "Stop" }).click();
    console.log(JSON.stringify({ bare, alone, with_body_and_plots, ...(await emptyScene(browser, 711, 414)) }));
  },
  { at: "#/gesture" },
);
