// From what cameras give (clips of a board, of the empty room, of the person) to a motion in View, by the page only, in
// at most 15 clicks and without typing but a name. FOLDER/session: as `hypose synth --raw` writes it.
import assert from "node:assert/strict";
import { existsSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { fits, staysCutOff, walk } from "./harness.mjs";

await walk(
  async ({ page, folder, picture }) => {
    let clicks = 0;
    const click = async (what) => {
      await what.click();
      clicks++;
    };
    const button = (name) => page.getByRole("button", { name, exact: true });
    const done = (kind) => page.locator(`.job[data-job=${kind}][data-state=done]`).first().waitFor();
    const shown = (selector) => page.waitForFunction((s) => {
      const all = [...document.querySelectorAll(s)];
      return all.length > 0 && all.every((i) => i.complete && i.naturalWidth > 0);
    }, selector);

    // a folder with all that was filmed; every file finds its use and its camera
    await page.getByRole("heading", { name: "Set up a recording" }).waitFor();
    await click(button("session"));
    await button("Make the recording").and(page.locator(":enabled")).waitFor();
    const found = await page.evaluate(() => Object.fromEntries([...document.querySelectorAll("[data-file]")].map((row) => [
      row.dataset.file, [...row.querySelectorAll("select")].map((s) => s.value).join(" ")])));
    for (const k of [1, 2, 3, 4]) {
      for (const [kind, role] of [["walk", "video"], ["empty", "background"], ["board", "board"]]) {
        assert.equal(found[`${kind}/cam${k}.mp4`], `${role} cam${k}`);
      }
    }
    await shown(".file-picture img");
    await picture("raw-folder");
    await fits(page, []); // its form stays in sight, above the rest of the list
    await page.getByLabel("Name of the recording").fill("mine");
    await click(button("Make the recording"));

    // calibrated by the board, whose corners are counted; the sheet shows what was seen
    await page.getByRole("heading", { name: "Calibrate", exact: true }).waitFor();
    assert.ok(await button("Calibrate").isDisabled());
    assert.deepEqual(await staysCutOff(page), []);
    await picture("raw-uncalibrated");
    await page.getByLabel("Side of a square").selectOption("80");
    clicks += 2;
    await click(button("Calibrate"));
    await done("calibrate");
    await page.getByText(/The cameras are calibrated: the corners are 0\.\d+ px off, which is good/).waitFor();
    await shown(".contact-sheet img");
    await page.getByText("4 cameras · 30 frames").waitFor();
    await picture("raw-calibrated");
    await fits(page, [[390, 844], [1024, 700], [1280, 720], [1440, 900]]);

    // in step: side by side, moved by hand and back
    await click(button("Next: Synchronise"));
    await shown(".sync-pictures img");
    await click(button("Find out"));
    await done("sync");
    await page.getByText(/The cameras are synchronised: they differ by 0\.\d+ frames at most/).waitFor();
    const source = () => page.locator(".sync-pictures img").nth(1).getAttribute("src");
    const before = await source();
    const slider = page.getByRole("slider", { name: "Frames that cam2 is late" });
    for (let k = 0; k < 8; k++) await slider.press("ArrowRight");
    await page.getByText(/The cameras differ by [12]\.\d frames/).waitFor();
    await page.waitForFunction((old) => document.querySelectorAll(".sync-pictures img")[1].getAttribute("src") !== old, before);
    await shown(".sync-pictures img");
    await picture("raw-moved");
    await button("As found").click(); // what a test moves it puts back; it is no click of the way
    await page.getByText(/The cameras are synchronised/).waitFor();
    await shown(".sync-pictures img");
    await picture("raw-in-step");
    assert.deepEqual(await staysCutOff(page), []);

    await click(button("Next: Check"));
    await click(button("Check the recording"));
    await done("check");
    await page.getByText("Nothing speaks against this calibration.").waitFor();
    await click(button("Next: Masks"));
    await shown(".mask-pictures img");
    await picture("raw-masks");
    await click(button("Next: Person"));
    await click(button("Next: Track"));
    await click(button("Track"));
    await done("track");
    await click(page.locator(".job[data-job=track]").getByRole("link", { name: "Open in View" }));
    await page.waitForFunction(() => location.hash.startsWith("#/view/") && window.hypose?.pictureRow() === 0);
    await picture("raw-result");
    console.log(JSON.stringify({ clicks }));
    assert.ok(clicks <= 15, `${clicks} clicks`);
    const made = join(folder, "session");
    assert.ok(existsSync(join(made, "results", "default", "motion.npz")));
    assert.match(readFileSync(join(made, "recording.toml"), "utf-8"), /calibration = .calibration\.toml/);

    // known offsets give a recording that is in step
    await page.goBack();
    await page.locator("[data-step=sync]").click();
    for (let k = 0; k < 8; k++) await slider.press("ArrowRight");
    await button("Synchronise the cameras").click();
    await done("in_step");
    await page.getByRole("link", { name: "Go on with what is synchronised" }).click();
    await page.getByRole("heading", { name: "mine in step" }).waitFor();
    await page.getByText("4 cameras · 30 frames").waitFor();
  },
  { at: "#/setup", viewport: { width: 1440, height: 900 } },
);
