// Every screen opens by its address, in the dark and in the light, and keeps nobody out.
import assert from "node:assert/strict";
import { barriers, walk } from "./harness.mjs";

await walk(async ({ page, picture }) => {
  const { results, recordings } = await (await fetch(new URL("api/state", process.env.STUDIO))).json();
  const [result, recording] = [results[0].id, recordings[0].id];
  const shown = () => page.waitForFunction(() => window.hypose?.pictureRow() === 0);
  const step = (name) => async () => {
    await page.locator(`[data-step=${name}]`).click();
    await page.locator(`[data-step=${name}][aria-current=step]`).waitFor();
  };
  const screens = [
    ["view", "", () => page.getByRole("heading", { name: "Results" }).waitFor()],
    ["view", `/${result}`, shown],
    ["view", `/${result}`, async () => {
      await shown();
      await page.getByRole("tab", { name: "Quality" }).click();
      await page.getByRole("tab", { name: "Details" }).click();
      await page.getByRole("button", { name: "Choose what is plotted" }).click();
    }],
    ["setup", "", () => page.getByRole("heading", { name: "Set up a recording" }).waitFor()],
    ...["sync", "check", "masks", "person", "track"].map((name) => ["setup", `/${recording}`, step(name)]),
    ["click", "", () => page.getByRole("heading", { name: "Click to start" }).waitFor()],
    ["click", `/${recording}/0`, () => page.waitForFunction(() => window.__app?.pictures > 0)],
    ["gesture", "", () => page.getByRole("button", { name: "Start", exact: true }).waitFor()],
    ["live", "", () => page.locator("main h1, main h2, main button").first().waitFor()],
    ["live", "/cameras", () => page.getByLabel("Where cam4 is").waitFor()],
  ];
  const found = {};
  for (const colorScheme of ["dark", "light"]) {
    await page.emulateMedia({ colorScheme, reducedMotion: "reduce" });
    await page.waitForFunction((name) => document.documentElement.dataset.theme === name, colorScheme); // as the computer is set
    for (const [k, [screen, rest, ready]] of screens.entries()) {
      await page.evaluate(() => {
        document.querySelector("dialog[open]")?.close();
        location.hash = "#/none";
      });
      await page.evaluate((hash) => (location.hash = hash), `#/${screen}${rest}`);
      await page.locator(`main[data-screen=${screen}]`).waitFor();
      await ready();
      assert.equal(await page.locator(".bar nav [aria-current=page]").count(), 1);
      assert.equal(await page.evaluate(() => document.documentElement.dataset.theme), colorScheme);
      await picture(`shell-${k}-${screen}-${colorScheme}`);
      const faults = await barriers(page);
      if (faults.length) found[`${screen}${rest} ${k} ${colorScheme}`] = faults;
    }
  }
  assert.match(await page.title(), /hypose/);
  assert.deepEqual(found, {});
});
