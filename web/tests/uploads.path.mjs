// Videos whose uploads end in any order go to the cameras they are of; what cannot be told is asked, and holds the rest up.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { walk } from "./harness.mjs";

const ORDERS = 20;

await walk(
  async ({ page, folder, picture }) => {
    const file = (path, name) => ({ name, mimeType: "application/octet-stream", buffer: readFileSync(join(folder, "walk", path)) });
    const calibration = file("calibration.toml", "calibration.toml");
    const videos = [1, 2, 3, 4].map((k) => file(`videos/cam${k}.mp4`, `cam_0${k}.mp4`));
    const files = page.getByLabel("Videos and calibration");
    const make = page.getByRole("button", { name: "Make the recording" });
    const rows = () => page.locator(".dropped-file").count();
    const cameras = () =>
      page.evaluate(() => Object.fromEntries([...document.querySelectorAll("[data-file]")].flatMap((row) => {
        const camera = row.querySelector("[aria-label=Camera]");
        return camera ? [[row.dataset.file, camera.value]] : [];
      })));
    // a video that is removed while its picture is on its way leaves an error in the console
    const pictures = () =>
      page.waitForFunction(() => [...document.querySelectorAll(".dropped-picture img")].filter((i) => i.naturalWidth > 0).length === 4);
    const remove = async () => {
      await page.evaluate(() => {
        for (;;) {
          const one = document.querySelector(".dropped-file button[aria-label^=Remove]");
          if (!one) return;
          one.click(); // the list is drawn anew at once
        }
      });
      assert.equal(await rows(), 0);
    };
    let seed = 7;
    const chance = () => (seed = (seed * 1103515245 + 12345) % 2147483648) / 2147483648;
    let answered = [];
    await page.route("**/api/uploads/*", async (route) => {
      if (route.request().method() !== "PUT") return route.continue();
      const response = await route.fetch();
      await new Promise((done) => setTimeout(done, 40 * chance()));
      answered.push(route.request().url().split("/").pop());
      await route.fulfill({ response });
    });

    const setUp = page.getByRole("heading", { name: "Set up a recording" });
    await setUp.waitFor(); // a page that is still on its way cannot be loaded anew
    await page.reload(); // a page that was open before now and then sends past what is to hold its uploads up
    await setUp.waitFor();
    const seen = new Set();
    for (let round = 0; round < ORDERS; round++) {
      answered = [];
      const order = [calibration, ...videos].map((f) => [chance(), f]).sort((a, b) => a[0] - b[0]).map(([, f]) => f);
      await files.setInputFiles(order);
      await make.and(page.locator(":enabled")).waitFor();
      seen.add(answered.join());
      assert.deepEqual(await cameras(), { "cam_01.mp4": "cam1", "cam_02.mp4": "cam2", "cam_03.mp4": "cam3", "cam_04.mp4": "cam4" }, answered.join());
      await pictures();
      if (round < ORDERS - 1) await remove();
    }
    assert.ok(seen.size > 10, `the uploads ended in ${seen.size} orders only: ${[...seen].join("|")}`);

    // the same files again, a photo of the board, and a video of a camera that has one already
    const photo = { name: "ext_cam1.png", mimeType: "image/png", buffer: await page.screenshot() };
    await files.setInputFiles([photo, file("videos/cam2.mp4", "Cam 2 take 2.mp4")]);
    await page.getByText("Two videos are of the camera cam2").waitFor();
    assert.ok(await make.isDisabled());
    assert.equal(await page.locator("[data-file='ext_cam1.png'] [aria-label='What it is']").inputValue(), "none");
    await picture("uploads-conflict");
    await page.locator("[data-file='Cam 2 take 2.mp4'] [aria-label='What it is']").selectOption("none");
    await make.and(page.locator(":enabled")).waitFor();
    await files.setInputFiles([file("videos/cam1.mp4", "somewhere.mp4")]);
    await page.getByText("Which camera is somewhere.mp4 of?").waitFor();
    assert.ok(await make.isDisabled());
    await page.getByRole("button", { name: "Remove somewhere.mp4" }).click();
    await make.and(page.locator(":enabled")).waitFor();

    // a folder that is dropped anywhere on the page comes with its paths; dropped twice it is there once
    const drop = (names) =>
      page.evaluate((list) => {
        const transfer = new DataTransfer();
        for (const name of list) transfer.items.add(new File(["bytes of " + name], name, { lastModified: 5 }));
        document.querySelector(".bar").dispatchEvent(new DragEvent("drop", { dataTransfer: transfer, bubbles: true, cancelable: true }));
      }, names);
    await drop(["notes.txt", "thesis.pdf"]);
    await page.getByText("1 file left out").waitFor();
    const before = await rows();
    await drop(["notes.txt"]);
    await page.getByText("1 file already here").waitFor();
    assert.equal(await rows(), before);
    await page.getByLabel("Name of the recording").fill("mine");
    await picture("uploads-ready");
    await make.click();
    await page.getByRole("heading", { name: "mine" }).waitFor();
    const made = readFileSync(join(folder, "mine", "recording.toml"), "utf-8");
    for (const k of [1, 2, 3, 4]) assert.match(made, new RegExp(`camera = .cam${k}.\\nvideo = .videos/\\d+_cam_0${k}\\.mp4`));
  },
  { at: "#/setup" },
);
