// How fast the gesture screen is, alone and while a result is played in 3D with its plots beside it: pictures per second
// and the time from a click to its effect, with what an empty canvas takes in the same run. It wants a studio whose folder
// has a gesture model, a recorded session and a result; tests/app/studio/test_speed_browser.py makes them. Prints JSON.
import { emptyScene, quantile, walk } from "./harness.mjs";

const SECONDS = 6;

await walk(
  async ({ page, browser, address, picture }) => {
    page.setDefaultTimeout(300_000);
    await page.getByRole("radio", { name: /Recorded session/ }).click();
    await page.getByText("Timing").click();
    await page.getByText("as fast as the computer can").click();
    await page.getByRole("button", { name: "Watch", exact: true }).first().click();
    await page.waitForFunction(() => window.__app.pictures > 10);
    await page.keyboard.press("m");
    const counted = () => page.evaluate(() => [window.__app.pictures, performance.now(), window.__app.live.step.ms]);
    const rate = async () => {
      const [before, began] = await counted();
      await page.waitForTimeout(1000 * SECONDS);
      const [after, now, ms] = await counted();
      return { pictures_per_s: (1000 * (after - before)) / (now - began), server_ms: ms };
    };
    const clicks = async () => {
      await page.evaluate(() => (window.__app.latency.length = 0));
      for (let k = 0; k < 40; k++) {
        await page.getByRole("button", { name: k % 2 ? "Go on" : "Pause", exact: true }).click();
        await page.waitForFunction((n) => window.__app.latency.length > n, k);
        await page.waitForTimeout(60);
      }
      const latency = await page.evaluate(() => window.__app.latency);
      return { click_p50_ms: quantile(latency, 0.5), click_p95_ms: quantile(latency, 0.95) };
    };
    const alone = { ...(await rate()), ...(await clicks()) };
    await picture("gesture-speed");

    const body = await browser.newPage({ viewport: { width: 1280, height: 800 } });
    body.setDefaultTimeout(300_000);
    const { results } = await (await fetch(new URL("api/state", address))).json();
    const long = [...results].sort((a, b) => b.frames - a.frames)[0];
    await body.goto(`${address}#/view/${long.id}`, { waitUntil: "commit" });
    await body.waitForFunction(() => window.hypose && document.querySelector(".where")?.textContent);
    await body.keyboard.press("Space");
    await body.waitForTimeout(1500);
    await body.evaluate(() => (window.hypose.frames.length = 0));
    const live = await rate();
    const frames = await body.evaluate(() => [...window.hypose.frames]);
    const together = { ...live, body_frames_per_s: 1000 / quantile(frames, 0.5), ...(await clicks()) };
    await body.close();
    await page.getByRole("button", { name: "Stop" }).click();
    console.log(JSON.stringify({ alone, with_body_and_plots: together, ...(await emptyScene(browser, 711, 414)) }));
  },
  { at: "#/gesture" },
);
