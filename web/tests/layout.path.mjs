// Nothing is cut off on any screen, from a large window to a telephone.
import assert from "node:assert/strict";
import { staysCutOff, walk } from "./harness.mjs";

const SIZES = [[1440, 900], [1280, 720], [1024, 700], [390, 844]];

await walk(
  async ({ page, picture }) => {
    const { results, recordings } = await (await fetch(new URL("api/state", process.env.STUDIO))).json();
    const [result, recording] = [results[0].id, recordings[0].id];
    const step = (name) => async () => {
      await page.locator(`[data-step=${name}]`).click();
      await page.locator(".step h2").waitFor();
    };
    const screens = [
      ["view-list", "#/view", () => page.getByRole("heading", { name: "Results" }).waitFor()],
      ["view", `#/view/${result}`, () => page.waitForFunction(() => window.hypose?.pictureRow() === 0)],
      ["view-quality", `#/view/${result}`, async () => {
        await page.waitForFunction(() => window.hypose?.pictureRow() === 0);
        await page.getByRole("tab", { name: "Quality" }).click();
        await page.getByRole("tab", { name: "Details" }).click();
      }],
      ["setup", "#/setup", () => page.getByRole("heading", { name: "Set up a recording" }).waitFor()],
      ...["sync", "check", "masks", "person", "track"].map((name) => [`setup-${name}`, `#/setup/${recording}`, step(name)]),
      ["click-list", "#/click", () => page.getByRole("heading", { name: "Click to start" }).waitFor()],
      ["click", `#/click/${recording}/0`, () => page.waitForFunction(() => window.__app?.pictures > 0)],
      ["gesture", "#/gesture", () => page.getByRole("button", { name: "Start", exact: true }).waitFor()],
      ["gesture-session", "#/gesture", async () => {
        await page.getByRole("button", { name: "Start", exact: true }).or(page.getByRole("button", { name: /^(Pause|Go on)$/ })).first().waitFor();
        if (await page.getByRole("button", { name: "Start", exact: true }).isVisible()) await page.getByRole("button", { name: "Start", exact: true }).click();
        await page.locator(".gesture-tools").waitFor();
      }],
      ["live", "#/live/sensors", () => page.getByRole("button").first().waitFor()],
      ["live-cameras", "#/live", () => page.getByRole("button", { name: "Start", exact: true }).waitFor()],
    ];
    const only = process.env.ONLY?.split(",");
    const faults = {};
    for (const [name, at, ready] of screens) {
      if (only && !only.includes(name)) continue;
      await page.evaluate(() => (location.hash = "#/none"));
      await page.evaluate((hash) => (location.hash = hash), at);
      await ready();
      for (const [width, height] of SIZES) {
        await page.setViewportSize({ width, height });
        const found = await staysCutOff(page);
        await picture(`${name}-${width}`);
        if (found.length) faults[`${name} ${width}x${height}`] = found;
      }
    }
    assert.deepEqual(faults, {});
  },
  { at: "#/view", colorScheme: "dark" },
);
