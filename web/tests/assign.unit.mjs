// Which file of a folder belongs to which camera: never by their order.
import assert from "node:assert/strict";
import { load } from "./unit.mjs";

const { assign, camerasOf, chosenCalibration, obstacle, words } = await load("src/setup/assign.ts");

/** Orders of a list, all different, reproducible. */
function* orders(list, count, seed = 1) {
  for (let k = 0; k < count; k++) {
    const left = [...list];
    const out = [];
    while (left.length) {
      seed = (seed * 1103515245 + 12345) % 2147483648;
      out.push(...left.splice(seed % left.length, 1));
    }
    yield out;
  }
}
const video = (path) => ({ path, kind: "video" });
const image = (path) => ({ path, kind: "image" });
const found = (files, cameras) => Object.fromEntries(assign(files, cameras).map((a, k) => [files[k].path, `${a.role} ${a.camera}`.trim()]));

assert.deepEqual(words("Cam_01"), ["cam", "1"]);
assert.deepEqual(words("Camera 1"), words("cam01"));

// the same camera under four spellings, and cameras whose names are parts of others
const spellings = [
  [["cam01", "cam02", "cam03", "cam04"], ["cam_01.mp4", "cam_02.mp4", "cam_03.mp4", "cam_04.mp4"]],
  [["cam_1", "cam_2", "cam_3", "cam_4"], ["Cam 1.MOV", "Camera2.mp4", "walk-cam03.avi", "CAM-04_take2.mp4"]],
  [["cam1", "cam10", "cam11", "cam2"], ["cam01.mp4", "cam10.mp4", "cam_11.mp4", "cam2.mp4"]],
  [["int_cam01_img", "int_cam02_img"], ["cam1.mp4", "cam2.mp4"]],
  [["cam1", "cam2", "cam3"], ["cam1/video.mp4", "cam2/video.mp4", "cam3/video.mp4"]],
  [["camA", "camB"], ["A.mp4", "B.mp4"]],
  [["1", "2"], ["take3_cam01.mp4", "take3_cam02.mp4"]],
  [["cam1", "cam2", "cam3"], ["walk/view-1.mp4", "walk/view-2.mp4", "walk/view-3.mp4"]],
];
for (const [cameras, names] of spellings) {
  const expected = Object.fromEntries(names.map((n, k) => [n, `video ${cameras[k]}`]));
  for (const order of orders(names, 20)) assert.deepEqual(found(order.map(video), cameras), expected);
}

// what the names do not say stays open: takes of one camera, two of the same, a name that says two cameras
for (const names of [["take1.mp4", "take2.mp4"], ["GX010042.mp4", "GX010043.mp4"], ["left.mp4", "right.mp4"], ["cam1_cam2.mp4"]]) {
  for (const order of orders(names, 20)) assert.ok(assign(order.map(video), ["cam1", "cam2"]).every((a) => a.camera === ""), names);
}
assert.ok(assign([video("take1.mp4"), video("take2.mp4")], ["1", "2"]).every((a) => a.camera === ""));
assert.match(obstacle([{ name: "c.toml", role: "calibration", camera: "" }, { name: "a.mp4", role: "video", camera: "" }]), /Which camera is a\.mp4 of/);

// pictures: an empty room says so; one of a board or a scene never becomes one
const files = [
  image("calibration/extrinsics/cam1/cam1.png"), image("ext_cam1.jpg"), image("cam1.png"), image("background/cam1.png"),
  image("empty_cam2.jpg"), video("calibration/intrinsics/cam1.mp4"), video("videos/cam1.mp4"), video("bg/cam2.mp4"),
];
for (const order of orders(files, 20)) {
  assert.deepEqual(found(order, ["cam1", "cam2"]), {
    "calibration/extrinsics/cam1/cam1.png": "none", "ext_cam1.jpg": "none", "cam1.png": "none", "background/cam1.png": "background cam1",
    "empty_cam2.jpg": "background cam2", "calibration/intrinsics/cam1.mp4": "none", "videos/cam1.mp4": "video cam1", "bg/cam2.mp4": "background cam2",
  });
}

// what stands in the way is said, and nothing is made of it
const one = (name, role, camera = "") => ({ name, role, camera });
const ready = [one("c.toml", "calibration"), one("a.mp4", "video", "cam1"), one("b.mp4", "video", "cam2")];
assert.equal(obstacle(ready), "");
assert.equal(obstacle(ready.slice(1)), ""); // the cameras are found from the person, or by a board that comes later
assert.match(obstacle([...ready, one("d.toml", "calibration")]), /2 calibrations/);
assert.match(obstacle([...ready, one("c.mp4", "video", "cam2")]), /Two videos are of the camera cam2/);
assert.match(obstacle([...ready, one("r.png", "background")]), /Of which camera is r\.png/);
assert.match(obstacle([...ready, one("r.png", "background", "cam3")]), /which has no video/);
assert.match(obstacle([...ready, one("r.png", "background", "cam1"), one("s.png", "background", "cam1")]), /two empty rooms/);

// without a calibration the cameras are called as what tells their videos apart, by which the other files are found
const raw = (paths) => assign(paths.map((path) => ({ path, kind: /\.mp4$/.test(path) ? "video" : /json$/.test(path) ? "keypoints" : "images" })), []);
const layouts = [
  [["s/board/cam1.mp4", "s/board/cam2.mp4", "s/empty/cam1.mp4", "s/empty/cam2.mp4", "s/walk/cam1.mp4", "s/walk/cam2.mp4"], ["cam1", "cam2"]],
  [["walk_cam1.mp4", "walk_cam2.mp4", "board_cam1.mp4", "board_cam2.mp4", "empty_cam1.mp4", "empty_cam2.mp4"], ["cam1", "cam2"]],
  [["Anna/IMG_1.mp4", "Ben/IMG_1.mp4", "Anna/board.mp4", "Ben/board.mp4", "Anna/empty.mp4", "Ben/empty.mp4"], ["Anna", "Ben"]],
  [["Anna/IMG_41.mp4", "Ben/IMG_77.mp4", "Anna/board_40.mp4", "Ben/board_75.mp4"], ["Anna", "Ben"]],
  [["videos/cam01.mp4", "videos/cam02.mp4", "calibration/int_cam01_img", "calibration/int_cam02_img", "pose/cam01_json", "pose/cam02_json", "masks/cam01", "masks/cam02"], ["cam01", "cam02"]],
];
for (const [paths, cameras] of layouts) {
  for (const order of orders(paths, 20)) {
    const all = raw(order);
    assert.deepEqual([...new Set(all.map((a) => a.camera))].sort(), cameras, order.join());
    assert.equal(obstacle(all.map((a, k) => ({ ...a, name: order[k] }))), "");
    order.forEach((path, k) => assert.equal(all[k].role, /board|int_/.test(path) ? "board" : /empty/.test(path) ? "background" : /json/.test(path) ? "keypoints" : /mask/.test(path) ? "masks" : "video", path));
  }
}
assert.deepEqual(camerasOf([{ path: "a.mp4", role: "video" }, { path: "b.mp4", role: "video" }]), ["a", "b"]);
assert.match(obstacle([one("a.mp4", "video", "a"), one("b.mp4", "video", "b"), one("x.mp4", "board", "a")]), /no clip of the board of b: add it/);
// with a calibration clips of a board are not needed, and of several in one folder one is taken
assert.deepEqual(found([video("board/cam1.mp4"), video("walk/cam1.mp4")], ["cam1", "cam2"]), { "board/cam1.mp4": "none", "walk/cam1.mp4": "video cam1" });
const two = [{ path: "c/Calib.qca.txt", kind: "calibration" }, { path: "c/Calib.toml", kind: "calibration" }];
for (const order of [two, [...two].reverse()]) assert.deepEqual(found(order, ["cam1"]), { "c/Calib.qca.txt": "none", "c/Calib.toml": "calibration" });

// files of one camera each do not stand beside the one of all of them, wherever they lie
const each = [1, 2].map((k) => ({ path: `u/cam${k}/config.xml`, kind: "calibration", cameras: [`serial ${k}`] }));
const whole = { path: "u/refined.json", kind: "calibration", cameras: ["1", "2"] };
for (const order of orders([...each, whole], 6)) assert.equal(order[chosenCalibration(order)], whole);
assert.deepEqual(found([...each, whole], ["1", "2"]), { "u/cam1/config.xml": "none", "u/cam2/config.xml": "none", "u/refined.json": "calibration" });
const rival = { path: "old/refined.json", kind: "calibration", cameras: ["1", "2"] };
assert.equal(chosenCalibration([whole, rival]), undefined);
assert.equal(chosenCalibration([whole, { ...rival, role: "none" }]), 0);
assert.equal(chosenCalibration([{ ...whole, role: "none" }, each[0]]), 1);
for (const order of orders(each, 2)) {
  const filmed = [video("cam1.mp4"), video("cam2.mp4"), video("board_cam1.mp4"), video("board_cam2.mp4")];
  assert.deepEqual(assign([...order, ...filmed], []).map((a) => `${a.role} ${a.camera}`.trim()), ["none", "none", "video cam1", "video cam2", "board cam1", "board cam2"]);
}
