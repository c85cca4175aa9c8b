// Every screen opens by its address, in the dark and in the light.
import assert from "node:assert/strict";
import { walk } from "./harness.mjs";

await walk(async ({ page, picture }) => {
  for (const colorScheme of ["dark", "light"]) {
    await page.emulateMedia({ colorScheme });
    await page.reload({ waitUntil: "commit" });
    for (const screen of ["view", "gesture", "click", "setup", "live"]) {
      await page.evaluate((name) => (location.hash = `#/${name}`), screen);
      await page.locator(`main[data-screen=${screen}]`).waitFor();
      assert.equal(await page.locator("nav [aria-current=page]").count(), 1);
      assert.equal(await page.evaluate(() => document.documentElement.dataset.theme), colorScheme);
      await picture(`shell-${screen}-${colorScheme}`);
    }
  }
  assert.match(await page.title(), /hypose/);
});
