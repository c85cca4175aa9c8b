// The list of results: a picture and the assessment of each; searched, sorted, deleted.
import assert from "node:assert/strict";
import { cpSync, existsSync } from "node:fs";
import { join } from "node:path";
import { staysCutOff, walk } from "./harness.mjs";

await walk(
  async ({ page, folder, picture }) => {
    const results = join(folder, "walk", "results");
    for (const name of ["first", "second"]) cpSync(join(results, "default"), join(results, name), { recursive: true });
    await page.locator(".result").first().waitFor(); // a page that is still on its way cannot be loaded anew
    await page.reload({ waitUntil: "commit" });
    const rows = page.locator(".result");
    const names = () => page.locator(".result b").allInnerTexts();
    await page.waitForFunction(() => document.querySelectorAll(".result").length === 3);
    await page.waitForFunction(() => [...document.querySelectorAll(".result-picture img")].filter((i) => i.naturalWidth === 192).length === 3);
    for (const text of await rows.allInnerTexts()) assert.match(text, /(good|look|not to be trusted)[\s\S]*overlap 0\.\d\d · ± \d+ mm[\s\S]*8 frames/);
    await picture("library");
    await page.getByLabel("Order").selectOption("name");
    assert.deepEqual(await names(), ["walk: default", "walk: first", "walk: second"]);
    await page.getByLabel("Search the results").fill("FIR");
    assert.deepEqual(await names(), ["walk: first"]);
    await page.getByText("1 of 3 in").waitFor();
    await page.getByLabel("Search the results").fill("");

    const more = (name) => page.getByRole("button", { name: `More about walk/results/${name}` });
    await more("first").click();
    const asked = [];
    page.once("dialog", (dialog) => (asked.push(dialog.message()), dialog.dismiss()));
    await page.getByRole("menuitem", { name: /Delete/ }).click();
    assert.match(asked[0], /walk\/results\/first .*for good/);
    assert.ok(existsSync(join(results, "first", "motion.npz")));
    await more("first").click();
    page.once("dialog", (dialog) => dialog.accept());
    await page.getByRole("menuitem", { name: /Delete/ }).click();
    await page.waitForFunction(() => document.querySelectorAll(".result").length === 2);
    assert.ok(!existsSync(join(results, "first")));
    for (const [width, height] of [[1280, 720], [390, 844]]) {
      await page.setViewportSize({ width, height });
      assert.deepEqual(await staysCutOff(page), []);
      await picture(`library-${width}`);
    }
    await page.getByRole("link", { name: /walk: second/ }).click();
    await page.locator(".where").waitFor();
  },
  { at: "#/view" },
);
