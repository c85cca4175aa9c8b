// slow: from a folder of videos to a motion that opens in View.
import assert from "node:assert/strict";
import { cpSync, existsSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { barriers, walk } from "./harness.mjs";

await walk(
  async ({ page, folder, picture }) => {
    const done = (kind) => page.locator(`.job[data-job=${kind}][data-state=done]`).first().waitFor();
    const filmed = join(folder, "days", "monday");
    const give = (from, to) => cpSync(join(folder, "walk", from), join(filmed, to), { recursive: true });
    const make = page.getByRole("button", { name: "Make the recording" });
    const cameras = () => page.evaluate(() => Object.fromEntries([...document.querySelectorAll("[data-file]")].flatMap((row) => {
      const camera = row.querySelector("[aria-label=Camera]");
      return camera ? [[row.dataset.file, camera.value]] : [];
    })));

    // what is missing is said; what lies in a folder is found again each time it is looked into
    give("videos", "walk");
    await page.getByRole("heading", { name: "Set up a recording" }).waitFor();
    await page.reload({ waitUntil: "commit" });
    await page.getByRole("button", { name: "days", exact: true }).click();
    await page.getByRole("button", { name: "monday", exact: true }).click();
    await page.getByText("No calibration and no clips of a board are here, which need not be").waitFor();
    assert.ok(await make.isEnabled());
    give("calibration.toml", "calibration.toml");
    give("background", "background");
    give("videos/cam2.mp4", "take 2/Cam 2.mp4");
    give("videos/cam1.mp4", "somewhere.mp4");
    const look = async (path) => {
      await page.getByLabel("Folder").fill(path);
      await page.getByRole("button", { name: "Look" }).click();
    };
    await look("/etc");
    await page.getByText("lies outside of root").waitFor();
    await look("days/monday");
    await page.getByText("calibration of cam1").waitFor();
    await page.getByText("Which camera is somewhere.mp4 of?").waitFor();
    await page.locator("[data-file='somewhere.mp4'] [aria-label='What it is']").selectOption("none");
    await page.getByText("Two videos are of the camera cam2").waitFor();
    assert.ok(await make.isDisabled());
    await picture("setup-conflict");
    await page.locator("[data-file='take 2/Cam 2.mp4'] [aria-label='What it is']").selectOption("none");
    await make.and(page.locator(":enabled")).waitFor();
    const each = (kind) => [1, 2, 3, 4].map((k) => [`${kind}/cam${k}.mp4`, `cam${k}`]);
    assert.deepEqual(await cameras(), Object.fromEntries([...each("background"), ...each("walk")]));
    await page.waitForFunction(() => [...document.querySelectorAll(".file-picture img")].filter((i) => i.naturalWidth > 0).length >= 4);
    await page.getByLabel("Name of the recording").fill("mine");
    await picture("setup-folder");
    assert.deepEqual(await barriers(page), []);
    await make.click();
    await page.getByRole("heading", { name: "mine" }).waitFor();
    const made = readFileSync(join(filmed, "recording.toml"), "utf-8");
    for (const k of [1, 2, 3, 4]) assert.match(made, new RegExp(`camera = .cam${k}.\\nvideo = .walk/cam${k}\\.mp4.\\nbackground = .background/cam${k}`));

    // checked, with the findings in words
    await page.getByRole("button", { name: "Check the recording" }).click();
    await done("check");
    await page.locator(".assessment").waitFor();
    await picture("setup-checked");

    // masks follow the sliders, and are kept
    await page.getByRole("button", { name: "Next: Masks" }).click();
    await page.locator(".mask-pictures [data-state=coming]").first().waitFor(); // something turns while the first ones are made
    const loaded = () => page.waitForFunction(() => [...document.querySelectorAll(".mask-pictures img")].every((i) => i.complete && i.naturalWidth > 0));
    await loaded();
    const pictures = () => page.evaluate(() => window.__app.pictures);
    const before = await pictures();
    await page.getByRole("slider", { name: "Difference" }).press("ArrowRight");
    await page.waitForFunction((n) => window.__app.pictures >= n + 4, before);
    assert.match(decodeURIComponent(await page.locator(".mask-pictures img").first().getAttribute("src")), /"threshold":4\.5/);
    await picture("setup-masks");
    await page.getByRole("button", { name: "Use these settings" }).click();
    await page.getByText("made with these settings").waitFor();

    // the person is measured
    await page.getByRole("button", { name: "Next: Person" }).click();
    await page.getByRole("button", { name: "Measure the person" }).click();
    await done("subject");
    await page.getByRole("rowheader", { name: "stature" }).waitFor();
    await picture("setup-person");

    // tracked while one watches, and opened
    await page.locator("[data-step=track]").click();
    await page.getByRole("button", { name: "Track", exact: true }).click();
    const card = page.locator(".job[data-job=track]").first();
    await card.waitFor();
    await card.locator(".live-figure").waitFor();
    await picture("setup-tracking");
    await done("track");
    await card.getByText(/^frame [1-8]$/).waitFor();
    await picture("setup-tracked");
    await card.getByRole("link", { name: "Open in View" }).click();
    await page.waitForFunction(() => location.hash.startsWith("#/view/"));
    await page.locator(".where").waitFor();

    // tracked again it is a result of its own
    const first = readFileSync(join(filmed, "results", "default", "motion.npz"));
    await page.goBack();
    await page.locator("[data-step=track]").click();
    await page.getByRole("button", { name: "Track", exact: true }).click();
    await page.getByRole("heading", { name: "Track monday as default-2" }).waitFor();
    await page.waitForFunction(() => document.querySelectorAll(".job[data-job=track][data-state=done]").length === 2);
    assert.ok(existsSync(join(filmed, "results", "default-2", "motion.npz")));
    assert.ok(first.equals(readFileSync(join(filmed, "results", "default", "motion.npz"))));

    // a server that is gone is said, and nothing is said to run any more
    const sockets = [];
    let open = true;
    await page.routeWebSocket(/ws\/jobs/, (socket) => {
      if (open) socket.connectToServer();
      else void socket.close();
      sockets.push(socket);
    });
    await page.reload({ waitUntil: "commit" });
    await page.locator("[data-step=person]").click();
    await page.getByRole("button", { name: /^Measure/ }).click();
    await page.locator(".job[data-job=subject][data-state=running]").waitFor();
    open = false;
    for (const socket of sockets) await socket.close();
    await page.getByText("The server does not answer").waitFor();
    await page.getByText("not known", { exact: true }).waitFor();
    await picture("setup-gone");
    assert.equal(await page.locator(".chip", { hasText: /^runs$/ }).count(), 0);
    assert.equal(await page.locator(".steps small", { hasText: /^runs$/ }).count(), 0);
  },
  { at: "#/setup", expected: /400/ },
);
