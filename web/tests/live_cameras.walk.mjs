// Live cameras: the person in front of a recording's cameras is found and followed, what is wrong is said in words, and the
// page tells when it is over. (The server's folder holds one recording.)
import assert from "node:assert/strict";
import { barriers, staysCutOff, walk } from "./harness.mjs";

await walk(
  async ({ page, picture }) => {
    await page.getByText("Not running").waitFor();
    await page.getByRole("link", { name: "Cameras", exact: true }).click();
    await page.getByRole("heading", { name: "Live cameras" }).waitFor();
    await page.getByLabel("Recording", { exact: true }).selectOption({ label: "walk" });
    await page.getByLabel("Where cam4 is").waitFor();
    await picture("live-cameras-empty");

    // a page opens devices and streams, no files
    await page.getByLabel("Where cam1 is").fill("/etc/passwd");
    await page.getByRole("button", { name: "Start", exact: true }).click();
    await page.getByText("give the number of a camera of this computer").waitFor();
    // with some cameras only these are used, and that is said
    assert.equal(await page.getByLabel("Where cam2 is").getAttribute("placeholder"), "not used");
    await page.getByLabel("Where cam1 is").fill("");
    assert.equal(await page.getByLabel("Where cam2 is").getAttribute("placeholder"), "its video, played");

    await page.getByRole("button", { name: "Start", exact: true }).click();
    await page.getByText("The recording's videos are played").or(page.getByText("A person is there")).first().waitFor();
    await page.waitForFunction(() => globalThis.__app.phase === "following" && globalThis.__app.poses > 0);
    await page.waitForFunction(() => globalThis.__app.pictures > 2);
    assert.equal(await page.locator(".live-pictures img").count(), 4);
    assert.equal(await page.locator("tbody tr").count(), 4);
    assert.deepEqual(await staysCutOff(page), []);
    assert.deepEqual(await barriers(page), []);
    await page.getByText(/Poses: ws:\/\/127\.0\.0\.1:\d+\/out/).waitFor(); // while it runs, not for a moment
    await picture("live-cameras");
    for (const [width, height, colorScheme] of [[1440, 900, "light"], [1280, 720, "dark"], [1024, 700, "light"], [390, 844, "dark"]]) {
      await page.setViewportSize({ width, height });
      await page.emulateMedia({ colorScheme, reducedMotion: "reduce" }); // no colours on their way
      assert.deepEqual(await staysCutOff(page), []);
      assert.deepEqual(await barriers(page), []);
      await picture(`live-cameras-${width}`);
    }
    await page.getByRole("button", { name: "Learn the empty room" }).click();
    await page.getByText(/Leave the cameras' view/).waitFor();
    await page.reload({ waitUntil: "commit" }); // a page that comes later sees the same
    await page.getByRole("button", { name: "Stop", exact: true }).waitFor();
    await page.getByRole("button", { name: "Stop", exact: true }).click();
    await page.getByText("Not running").waitFor();
  },
  { at: "#/live/sensors", colorScheme: "dark" },
);
