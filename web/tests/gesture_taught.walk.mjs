// The simulated person is taught a gesture, hands off: what the screen asks for, what it says of it, undo, a closed tab,
// and teaching the same gesture more. ROUNDS and the seconds of a round come from the test.
import assert from "node:assert/strict";
import { copyFileSync } from "node:fs";
import { join } from "node:path";
import { walk } from "./harness.mjs";

const rounds = process.env.ROUNDS ?? "6";

await walk(
  async ({ page, open, folder, picture }) => {
    // as long as the session's own clock goes on, a slow machine is given its time
    const PATIENCE = { timeout: 300_000 };
    const prompt = (state, on = page) => on.locator(`.prompt[data-state=${state}]`).waitFor(PATIENCE);
    const fact = (name, on = page) => on.locator(`dt:text-is("${name}") + dd`).innerText();
    const step = (on = page) => on.evaluate(() => window.__app.live.step);

    page.setDefaultTimeout(PATIENCE.timeout);
    await page.getByRole("radio", { name: /Simulated person/ }).waitFor();
    assert.equal(await page.getByRole("radio", { name: /Simulated person/ }).getAttribute("aria-checked"), "true");
    assert.match(await page.getByRole("region", { name: "Your gestures" }).innerText(), /None yet/);
    await picture("gesture-start");
    await page.getByLabel("Rounds", { exact: true }).fill(rounds);
    await page.getByText("Timing").click();
    await page.getByText("as fast as the computer can").click();
    await page.getByRole("button", { name: "Start" }).click();

    // it goes on by itself through all that is asked for
    await prompt("do_gesture");
    await prompt("positive");
    assert.equal(await page.locator(".prompt-words").innerText(), "Hold it");
    await page.waitForFunction(() => Number(document.querySelector(".prompt-count").textContent) > 0);
    await page.waitForFunction(() => window.__app.pictures > 5);
    await picture("gesture-hold");
    await prompt("release");
    await prompt("negative");
    await page.keyboard.press("m");
    await page.waitForFunction(() => document.querySelectorAll(".facts dd")[1]?.textContent > "0");
    await picture("gesture-else");

    // a segment that went wrong is taken back, and its frames with it
    const learned = Number(await fact("Frames of other movement"));
    assert.ok(learned > 0);
    await page.getByRole("button", { name: "Undo" }).click();
    await prompt("release");
    await page.waitForFunction(() => window.__app.live.step.counts.negative === 0);

    // a closed tab loses nothing: the session waits until somebody comes back
    await page.waitForFunction(() => window.__app.live.step.counts.negative > 20, undefined, PATIENCE);
    const before = await step();
    await page.close();
    await new Promise((done) => setTimeout(done, 6500));
    const again = await open("#/gesture");
    again.setDefaultTimeout(PATIENCE.timeout);
    await prompt("paused", again);
    await again.waitForFunction(() => window.__app.pictures > 0);
    const found = await step(again);
    assert.ok(found.time >= before.time && found.counts.gesture >= before.counts.gesture);
    assert.ok((await again.evaluate(() => window.__app.live.history.length)) > 50, "the history is lost");
    await again.getByRole("button", { name: "Go on" }).click();

    // how good it is, from the second round on; then teaching is ended. So weak a forest may reach its own threshold never,
    // a lower one soon
    await again.locator('dt:text-is("Average precision") + dd').getByText(/^[01]\.\d\d$/).waitFor(PATIENCE);
    await again.getByRole("button", { name: "Test" }).click();
    await again.locator(".prompt[data-state=test], .prompt[data-state=sees]").first().waitFor(PATIENCE);
    assert.match(await fact("Average precision", again), /^[01]\.\d\d$/);
    assert.match(await fact("Measured on", again), /frames/);
    const limit = (await step(again)).threshold;
    const lower = async () => {
      await again.getByRole("slider", { name: "Threshold" }).press("Home");
      await again.waitForFunction(() => window.__app.live.step.manual);
      await again.locator(".events b").first().waitFor(PATIENCE);
    };
    await lower();
    await again.getByRole("button", { name: "Automatic" }).click();
    await again.waitForFunction(() => !window.__app.live.step.manual);
    assert.equal((await step(again)).threshold, limit);
    await again.screenshot({ path: join(process.env.PICTURES, "gesture-test.png") });
    await again.getByRole("button", { name: "Stop" }).click();
    await again.getByText("The gesture is saved as gestures/tee.npz").waitFor();
    copyFileSync(join(folder, "gestures", "tee.npz"), join(folder, "first.npz"));

    // the same forest goes on growing
    await again.getByRole("button", { name: "Teach it more" }).click();
    await prompt("positive", again);
    await again.waitForFunction(() => window.__app.live.step.counts.gesture > 10, undefined, PATIENCE);
    await again.getByRole("button", { name: "Stop" }).click();
    await again.getByText("The gesture is saved as gestures/tee.npz").waitFor();

    // and is watched for, with its log
    await again.getByRole("button", { name: "Watch for it" }).click();
    await again.locator("input[aria-label=Threshold]:enabled").waitFor();
    await lower();
    assert.equal(await again.locator(".events b").first().innerText(), "tee");
    await again.getByRole("button", { name: "Stop" }).click();
    await again.getByRole("button", { name: "Another gesture" }).click();
    await again.getByRole("button", { name: "Watch", exact: true }).first().waitFor();
  },
  { at: "#/gesture" },
);
