// What no page may do: read outside the served folder, talk from another site, send more than there is to say.
import assert from "node:assert/strict";
import { createServer } from "node:http";
import { walk } from "./harness.mjs";

const SECRET = /\[build-system\]|root:x:0/;

await walk(
  async ({ page, browser, address, folder }) => {
    await page.locator("main[data-screen=view]").waitFor();

    // paths out of the served folder, by every way a path can be written
    const { results, recordings } = await page.evaluate(() => fetch("api/state").then((r) => r.json()));
    const up = "..%2f".repeat(12);
    for (const path of [
      `static/${up}etc/passwd`, `static/%2e%2e/%2e%2e/%2e%2e/%2e%2e/pyproject.toml`, `static/..%5c..%5c..%5cpyproject.toml`,
      `${up}etc/passwd`, `api/results/${up}etc%2fpasswd/view`, `api/results/${results[0].id}/files/${up}etc%2fpasswd`,
      `api/results/${results[0].id}/files/..%2f..%2frecording.toml`, `api/recordings/${recordings[0].id}/file/..%2frecording.toml`,
      `api/recordings/${recordings[0].id}/starts/..%2f..%2fx`, "api/results/000000000000/view",
    ]) {
      const [status, text] = await page.evaluate((p) => fetch(p).then(async (r) => [r.status, await r.text()]), path);
      assert.ok([400, 404].includes(status), `${path}: ${status}`);
      assert.ok(!SECRET.test(text) && !text.includes(folder), `${path} gives away ${text.slice(0, 80)}`);
    }

    // a message that is too long ends the connection; the close frame with the reason (1009) may be lost while the browser
    // is still sending, which it then reports as 1006
    const closed = await page.evaluate(
      () =>
        new Promise((done) => {
          const socket = new WebSocket(`${location.origin.replace("http", "ws")}/ws/gesture`);
          socket.onopen = () => socket.send("x".repeat(70_000));
          socket.onclose = (event) => done(event.code);
        }),
    );
    assert.ok([1006, 1009].includes(closed), `closed with ${closed}`);

    // a page of another site on the same computer gets neither a connection nor an answer, and starts nothing
    const site = createServer((_, answer) => answer.end("<!doctype html><title>elsewhere</title>")).listen(0, "127.0.0.1");
    await new Promise((ready) => site.once("listening", ready));
    const foreign = await browser.newPage();
    await foreign.goto(`http://127.0.0.1:${site.address().port}/`);
    const got = await foreign.evaluate(async (studio) => {
      const socket = (path) =>
        new Promise((done) => {
          const one = new WebSocket(studio.replace("http", "ws") + path);
          one.onopen = () => done("open");
          one.onclose = () => done("refused");
        });
      const read = await fetch(`${studio}api/state`).then(() => "read", () => "refused");
      const body = JSON.stringify({ kind: "demo", options: {} });
      await fetch(`${studio}api/jobs`, { method: "POST", mode: "no-cors", body });
      return [await socket("ws/gesture"), await socket("ws/jobs"), await socket("ws/fuse"), read];
    }, new URL(address).href);
    assert.deepEqual(got, ["refused", "refused", "refused", "refused"]);
    assert.deepEqual(await page.evaluate(() => fetch("api/jobs").then((r) => r.json())), []);
    await foreign.close();
    site.close();
  },
  { at: "#/view", expected: /WebSocket|Failed to load resource/ },
);
