// A report opened from disk: the same view, with nothing loaded. STUDIO is the file's address.
import assert from "node:assert/strict";
import { walk } from "./harness.mjs";

await walk(async ({ page, address, picture }) => {
  assert.match(address, /^file:/);
  await page.getByRole("slider", { name: "Time" }).waitFor();
  assert.equal(await page.locator(".tile:visible").count(), 4);
  await page.waitForFunction(() => window.hypose.pictureRow() === 0);
  await page.locator(".view-head h1").click();
  await page.keyboard.press("End");
  await page.waitForFunction(() => document.querySelector(".where")?.textContent.endsWith("frame 7"));
  await page.waitForFunction(() => window.hypose.pictureRow() === 7);
  await page.getByRole("tab", { name: "Trunk" }).click();
  await page.getByText("Neck (°)").waitFor();
  await page.getByRole("button", { name: "Uncertainty" }).click();
  await page.waitForTimeout(800);
  await picture("report");
  const longest = await page.evaluate(() => {
    const m = window.hypose.view.space.spread.mesh.instanceMatrix.array;
    return [0, 1, 2].map((k) => Math.hypot(m[4 * k], m[4 * k + 1], m[4 * k + 2]));
  });
  assert.ok(Math.max(...longest) > 1.05 * Math.min(...longest), "a ball, where the result knows an ellipsoid");
  // the text below can be read and printed without the viewer
  for (const title of ["Pictures", "Subject", "Files", "How this was made"]) {
    await page.locator(".report").getByRole("heading", { name: title }).first().waitFor();
  }
  // below the viewer the space key scrolls as on any page
  await page.mouse.move(600, 2);
  await page.evaluate(() => document.activeElement?.blur());
  await page.mouse.wheel(0, 1400);
  await page.waitForFunction(() => scrollY > 800);
  await page.keyboard.press("Space");
  assert.equal(await page.evaluate(() => window.hypose.playing()), false);
});
