// Sensors that are simulated are fused, recorded, sent on by OSC, and fused again; then two programs send a person who
// walks: the page shows one skeleton, where the sensors stand and how they do.
import assert from "node:assert/strict";
import { createSocket } from "node:dgram";
import { once } from "node:events";
import { existsSync } from "node:fs";
import { join } from "node:path";
import { barriers, staysCutOff, walk } from "./harness.mjs";

// OpenNI's joints of a person who stands upright in the frame of a sensor whose y axis points up, metres.
const STANDING = {
  head: [0, 0.65, 0], neck: [0, 0.45, 0], torso: [0, 0.1, 0],
  left_shoulder: [0.18, 0.42, 0], left_elbow: [0.24, 0.15, 0], left_hand: [0.26, -0.1, 0.05],
  right_shoulder: [-0.18, 0.42, 0], right_elbow: [-0.24, 0.15, 0], right_hand: [-0.26, -0.1, 0.05],
  left_hip: [0.1, -0.1, 0], left_knee: [0.11, -0.5, 0.02], left_foot: [0.11, -0.9, 0],
  right_hip: [-0.1, -0.1, 0], right_knee: [-0.11, -0.5, 0.02], right_foot: [-0.11, -0.9, 0],
};
/** What a sensor turned by `angle` about the vertical sees at a time (s). */
function seen(time, angle) {
  const joints = {};
  const [x, z] = [0.5 * Math.sin(time), 0.3 * Math.cos(0.7 * time)];
  for (const [name, p] of Object.entries(STANDING)) {
    const swing = name.includes("hand") ? 0.12 * Math.sin(3 * time) * (name.startsWith("left") ? 1 : -1) : 0;
    const [a, b] = [p[0] + x, p[2] + z + swing];
    joints[name] = [Math.cos(angle) * a + Math.sin(angle) * b, p[1], Math.cos(angle) * b - Math.sin(angle) * a + 2.5, 2];
  }
  return joints;
}

await walk(
  async ({ page, folder, picture }) => {
    const start = page.getByRole("button", { name: "Start", exact: true });
    const stop = page.getByRole("button", { name: "Stop", exact: true });
    await page.getByText("Not running").waitFor();
    await picture("live-empty");
    await page.getByText("Ports, and where poses are sent").click();
    for (const name of ["UDP port", "WebSocket port"]) await page.getByLabel(name).fill("0");

    // a first try without any sensor, recorded and sent on
    const listener = createSocket("udp4");
    await once(listener.bind(0, "127.0.0.1"), "listening");
    const heard = once(listener, "message");
    await page.getByLabel("Who is seen", { exact: true }).selectOption({ label: "3 simulated sensors" });
    await page.getByLabel("OSC target").fill(`127.0.0.1:${listener.address().port}`);
    await page.getByLabel("all that the sensors send").check();
    await start.click();
    await page.waitForFunction(() => globalThis.__app.people === 1 && globalThis.__app.standing === 3);
    await page.getByText("in place").nth(2).waitFor();
    assert.match((await heard)[0].toString("latin1"), /\/hypose\/frame/);
    const drawn = await page.evaluate(() => globalThis.__app.pictures);
    await page.waitForFunction((before) => globalThis.__app.pictures > before + 30, drawn);
    for (const [width, height, colorScheme] of [[1440, 900, "light"], [1024, 700, "dark"], [390, 844, "light"], [1280, 800, "dark"]]) {
      await page.setViewportSize({ width, height });
      await page.emulateMedia({ colorScheme, reducedMotion: "reduce" }); // no colours on their way
      assert.deepEqual(await staysCutOff(page), []);
      assert.deepEqual(await barriers(page), []);
    }
    await picture("live");
    // a page that comes later sees the same
    await page.reload({ waitUntil: "commit" });
    await page.waitForFunction(() => globalThis.__app?.people === 1 && globalThis.__app.standing === 3);
    await stop.click();
    await page.getByText("Recorded as live/live.").waitFor();
    listener.close();
    assert.ok(existsSync(join(folder, "live", "live", "skeleton.csv")));
    await page.getByRole("button", { name: "Fuse it" }).click();
    const job = page.locator(".job[data-job=fuse]:is([data-state=done], [data-state=failed])");
    await job.waitFor();
    assert.equal(await job.getAttribute("data-state"), "done", await job.innerText());
    await picture("live-recorded");
    await page.locator(".live-recorded").getByRole("link", { name: "Open in View" }).click();
    await page.locator(".where").waitFor();
    await page.goBack();

    // programs that send
    await start.waitFor();
    for (const [name, value] of [["OSC target", ""], ["UDP port", "0"], ["WebSocket port", "0"]]) await page.getByLabel(name).fill(value);
    await start.click();
    const text = await page.getByText(/awaited at UDP/).textContent();
    const port = Number(/UDP 127\.0\.0\.1:(\d+)/.exec(text)[1]);
    const socket = createSocket("udp4");
    const began = performance.now();
    const timer = setInterval(() => {
      const time = (performance.now() - began) / 1000;
      for (const [sensor, angle] of [["left", 0], ["right", 0.9]]) {
        socket.send(JSON.stringify({ sensor, time, person: 0, joints: seen(time, angle) }), port, "127.0.0.1");
      }
    }, 33);
    try {
      await page.waitForFunction(() => globalThis.__app.frames > 60 && globalThis.__app.people === 1);
      await page.getByText("in place").nth(1).waitFor();
      assert.equal(await page.locator("tbody tr").count(), 2);
      assert.equal(await page.getByLabel("UDP port").inputValue(), String(port));
      await stop.click();
      await page.getByText("Not running").waitFor();
    } finally {
      clearInterval(timer);
      socket.close();
    }
  },
  { at: "#/live/sensors", colorScheme: "dark" },
);
