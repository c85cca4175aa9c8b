// Four videos and nothing else: the height is typed, and by at most five clicks there are files for OpenSim. FOLDER/phones
// holds the videos; HEIGHT_CM: of the person in them.
import assert from "node:assert/strict";
import { existsSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { fits, walk } from "./harness.mjs";

await walk(
  async ({ page, folder, picture }) => {
    let clicks = 0;
    const click = async (what) => {
      await what.click();
      clicks++;
    };
    const button = (name) => page.getByRole("button", { name, exact: true });
    // nothing is missing: the recording is made and kept
    await page.getByRole("heading", { name: "Set up a recording" }).waitFor();
    await click(button("phones"));
    await page.getByText("No calibration and no clips of a board are here, which need not be").waitFor();
    assert.equal(await page.locator(".bad:visible").count(), 0, "nothing is red");
    await picture("phones-folder");
    await click(button("Make the recording"));
    await button("Find the cameras and track").waitFor();
    await picture("phones-made");
    await fits(page);

    // a board to print, for later
    const board = page.getByRole("link", { name: "A board to print, A4" });
    const sheet = await page.request.get(await board.getAttribute("href"));
    assert.match((await sheet.body()).toString("latin1"), /^%PDF-1\.4[^]*How to film the board[^]*%%EOF\n$/);
    await button("Look for clips of the board").click(); // no click of the way: there are none
    await page.getByText("No clip of the board of phone1, phone2, phone3, phone4: put it into the folder phones").waitFor();

    // by one button the cameras are found from the person, the person in the videos, and all is synchronised and tracked
    await page.getByLabel("Height of the person in cm").fill(process.env.HEIGHT_CM);
    await click(button("Find the cameras and track"));
    await page.getByRole("heading", { name: "On the way to the motion" }).waitFor();
    await picture("phones-under-way");
    const ready = page.getByRole("link", { name: "OpenSim files" });
    const right = button("Put all right and go on");
    await ready.or(right).first().waitFor({ timeout: 900_000 });
    if (await right.isVisible()) {
      await picture("phones-found");
      await click(right);
    }
    await ready.waitFor({ timeout: 900_000 });
    await page.waitForFunction(() => [...document.querySelectorAll(".way-result img")].some((i) => i.naturalWidth > 0));
    await picture("phones-result");
    const loaded = page.waitForEvent("download");
    await click(ready);
    const packed = readFileSync(await (await loaded).path()).toString("latin1");
    for (const name of ["motion.osim", "motion.mot", "motion_markers.trc", "motion_ik.xml"]) assert.ok(packed.includes(name), name);
    console.log(JSON.stringify({ clicks }));
    assert.ok(existsSync(join(folder, "phones", "calibration.toml")), "the cameras are kept with the videos");
    await fits(page);

    // the videos are there to look at, on the common clock
    await page.getByRole("link", { name: "Open in View" }).first().click();
    await page.waitForFunction(() => location.hash.startsWith("#/view/") && window.hypose?.pictureRow() === 0);
    await picture("phones-view");
  },
  { at: "#/setup", viewport: { width: 1440, height: 900 } },
);
