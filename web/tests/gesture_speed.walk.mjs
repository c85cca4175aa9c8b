// How fast the gesture screen is: prints pictures per second and the time from a click to its effect. Not a test: run it
// by hand on an idle machine, against a studio whose folder has a model and a session (gesture_taught.walk.mjs).
import { walk } from "./harness.mjs";

await walk(
  async ({ page }) => {
    await page.getByRole("radio", { name: /Recorded session/ }).click();
    await page.getByText("Timing").click();
    await page.getByText("as fast as the computer can").click();
    await page.getByRole("button", { name: "Watch", exact: true }).first().click();
    await page.waitForFunction(() => window.__app.pictures > 10);
    await page.keyboard.press("m");
    const counted = () => page.evaluate(() => [window.__app.pictures, performance.now()]);
    const [pictures, began] = await counted();
    await page.waitForTimeout(10_000);
    const [more, now] = await counted();
    for (let k = 0; k < 40; k++) {
      await page.getByRole("button", { name: k % 2 ? "Go on" : "Pause" }).click();
      await page.waitForFunction((n) => window.__app.latency.length > n, k);
    }
    const latency = await page.evaluate(() => [...window.__app.latency].sort((a, b) => a - b));
    const share = (s) => Math.round(latency[Math.floor(s * (latency.length - 1))]);
    await page.getByRole("button", { name: "Stop" }).click();
    console.log(JSON.stringify({
      pictures_per_s: Math.round((10_000 * (more - pictures)) / (now - began)) / 10,
      click_ms: { median: share(0.5), p95: share(0.95) },
    }));
  },
  { at: "#/gesture" },
);
