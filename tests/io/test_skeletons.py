"""Recorded skeletons: every form read, put on one clock, and refused in one sentence when it cannot be used."""

import gzip
import json
import struct
import zlib

import numpy as np
import pytest

from hypose.errors import InputError
from hypose.evidence.frame import SensorReport
from hypose.io.files import bounded_lines
from hypose.io.sensors.depth import read_azure_mkv, read_depth_png, write_depth_png, write_millimetres_png
from hypose.io.sensors.skeleton_files import (
    MAX_SKELETON_LINE,
    FolderWriter,
    build_stream,
    common_times,
    empty_report,
    format_line,
    parse_line,
    read_skeletons,
    resample,
)
from tests import missing

JOINTS = ("head", "neck", "torso")


def stream(times, positions=None, ids=None, joints=JOINTS, name="a", state=None):
    reports = []
    for n, t in enumerate(times):
        p = np.full((len(joints), 3), float(n)) if positions is None else positions[n]
        level = np.full(len(joints), 2) if state is None else state[n]
        reports.append(SensorReport(name, t, 0 if ids is None else ids[n], tuple(joints), p, level))
    return build_stream(reports, "rec")


# ---- streams ----


def test_a_stream_keeps_persons_in_their_columns():
    reports = [
        SensorReport("a", t / 30, i, JOINTS, np.full((3, 3), float(i)), np.full(3, 2))
        for t, ids in enumerate([(5, 9), (9,), (9, 12), (12,)])
        for i in ids
    ]
    made, notes = build_stream(reports, "rec")
    assert made.person_ids.tolist() == [[5, 9], [-1, 9], [12, 9], [12, -1]]
    assert made.positions[2, 0, 0, 0] == 12 and np.isnan(made.positions[1, 0]).all()
    assert not notes


def test_a_clock_that_is_set_back_goes_on_with_its_step():
    times = [*np.arange(10) / 30, *(np.arange(10) / 30 - 5)]
    made, notes = stream(times)
    assert np.diff(made.times) == pytest.approx(1 / 30)
    assert made.positions[:, 0, 0, 0].tolist() == list(range(20))
    assert "set back 1 time" in notes[0]


def test_late_rows_are_sorted_in_and_a_wrong_stamp_is_left_out():
    made, notes = stream([0, 0.1, 0.3, 0.2, 0.4])
    assert made.times.tolist() == [0, 0.1, 0.2, 0.3, 0.4]
    assert made.positions[:, 0, 0, 0].tolist() == [0, 1, 3, 2, 4]
    made, notes = stream([0, 0.1, 99.0, 0.2, 0.3])
    assert made.times.tolist() == [0, 0.1, 0.2, 0.3] and "left out" in notes[0]


@pytest.mark.parametrize("mark", [np.nan, -9999.0, np.inf])
def test_missing_is_missing(mark):
    positions = np.ones((2, 3, 3))
    positions[1, 2] = mark
    made, _ = stream([0, 0.1], positions)
    assert np.isnan(made.positions[1, 0, 2]).all() and made.state[1, 0].tolist() == [2, 2, 0]


def test_millimetres_are_told_from_metres():
    with pytest.raises(InputError, match="joint head .* divide millimetres by 1000"):
        stream([0, 0.1], np.full((2, 3, 3), 1500.0))


# ---- the same instants ----


def test_resampling_is_linear_between_samples():
    made, _ = stream(np.arange(10) / 10)
    synced = resample(made, [0.25, 0.3, 0.9])
    assert synced.positions[:, 0, 0, 0] == pytest.approx([2.5, 3, 9])
    assert (synced.state == 2).all()


def test_nothing_is_blended_over_a_change_of_person():
    made, _ = stream(np.arange(6) / 10, ids=[1, 1, 1, 4, 4, 4])
    synced = resample(made, [0.22, 0.28])
    assert synced.person_ids[:, 0].tolist() == [1, 4]
    assert synced.positions[:, 0, 0, 0].tolist() == [2, 3]


def test_impossible_rates_and_spans_are_refused():
    a, _ = stream([0, 0.1])
    with pytest.raises(InputError, match="0.1 to 1000"):
        common_times([a], 0)
    far, _ = stream([1e9, 1e9 + 0.1])
    with pytest.raises(InputError, match="different clocks"):
        common_times([a, far])


# ---- folders ----


def test_a_folder_keeps_states_and_is_not_written_into_again(tmp_path):
    writer = FolderWriter(tmp_path / "rec")
    writer.add(empty_report("silent", 0.0))
    for n in range(5):
        writer.add(SensorReport("a", n / 30, 3, JOINTS, np.ones((3, 3)), np.array([2, 1, 0])))
    writer.close()
    (only,) = read_skeletons(tmp_path / "rec").streams
    assert only.name == "a" and only.state[0, 0].tolist() == [2, 1, 0]
    with pytest.raises(InputError, match="not empty"):
        FolderWriter(tmp_path / "rec")


def test_depth_maps_give_the_depth_at_every_joint(tmp_path):
    folder = tmp_path / "rec"
    writer = FolderWriter(folder)
    for n in range(3):
        p = np.array([[0, 0, 2.0], [0.5, 0.25, 2.0], [9, 0, 2.0]])
        writer.add(SensorReport("a", n / 30, 0, JOINTS, p, np.full(3, 2)))
    writer.close()
    depth = np.zeros((40, 60), np.float32)
    depth[20, 30], depth[15, 40] = 1.9, 2.1  # y up: 0.25 m above the axis is 5 rows higher
    write_depth_png(folder / "d.png", depth)
    assert read_depth_png(folder / "d.png") == pytest.approx(depth)
    (folder / "frames.csv").write_text("sensor,frame,time,depth\na,0,0,d.png\na,1,0.033,\na,2,0.066,d.png\n")
    session = json.loads((folder / "session.json").read_text())
    session["sensors"][0]["depth"] = {"intrinsics": [40, 40, 30, 20], "y_up": True}
    (folder / "session.json").write_text(json.dumps(session))
    made = read_skeletons(folder).streams[0]
    assert made.joint_depth[0, 0] == pytest.approx([1.9, 2.1, 0])
    assert made.joint_depth[1, 0].tolist() == [0, 0, 0]
    (folder / "frames.csv").write_text((folder / "frames.csv").read_text().replace("d.png", "../../d.png"))
    with pytest.raises(InputError, match="outside the folder"):
        read_skeletons(folder)


def test_a_picture_bomb_is_not_unpacked(tmp_path):
    head = b"IHDR" + struct.pack(">IIBBBBB", 60000, 60000, 16, 0, 0, 0, 0)
    data = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head)) + bytes(20)
    (tmp_path / "d.png").write_bytes(data)
    with pytest.raises(InputError, match="not a grey 16-bit PNG of at most 4096 x 4096"):
        read_depth_png(tmp_path / "d.png")
    (tmp_path / "d.png").write_bytes(b"GIF89a" + bytes(50))
    with pytest.raises(InputError, match="not a grey 16-bit PNG"):
        read_depth_png(tmp_path / "d.png")


# ---- CSV of Kinects ----


def kinect_csv(rows=20, joints=("Head", "Neck"), change=lambda lines: lines):
    names = ",".join(f" {j}_{x}" for j in joints for x in "XYZ")
    lines = [f"\ufeffStudy_Id, Tracker_Time, Person_Id, Skeleton_Time, Kinect_Id,{names}"]
    for n in range(rows):
        for k in "ab":
            values = ", ".join(f"{v:.4f}" for v in np.full(3 * len(joints), n / 100 + (k == "b")))
            lines.append(f"2, {63562191989440 + 33 * n}, 0, {330000 * n + 5}, {k}, {values}")
    return "\r\n".join(change(lines)) + "\r\n"


@pytest.mark.parametrize("name", ["k.csv", "k.csv.gz"])
def test_kinect_csv(tmp_path, name):
    text = kinect_csv(change=lambda ln: [x.replace("0.0300", "-9999") for x in ln]).encode()
    (tmp_path / name).write_bytes(gzip.compress(text) if name.endswith("gz") else text)
    made = read_skeletons(tmp_path / name)
    assert [s.name for s in made.streams] == ["a", "b"] and made.name == "k"
    a, b = made.streams
    assert a.times[:3] == pytest.approx([0, 0.033, 0.066], abs=1e-5)
    assert a.joint_names == ("Head", "Neck")
    assert a.positions[5, 0, 1] == pytest.approx([0.05] * 3) and b.positions[5, 0, 1] == pytest.approx([1.05] * 3)
    assert np.isnan(a.positions[3, 0]).all()


def test_each_kinects_skeletons_are_put_back_before_it(tmp_path):
    """The logger turns them by how the person stood, and puts them where the first sensor saw it."""

    def change(lines):
        first = lines[0].replace("Study_Id,", "Study_Id, Skeleton_Init_Angle, Skeleton_Init_Dist,")
        said = {"a": "0.1, 2.0", "b": "-0.6853982, 3.0"}  # 45 degrees apart
        return [first, *(ln.replace("2, ", f"2, {said[ln.split(',')[4].strip()]}, ", 1) for ln in lines[1:])]

    (tmp_path / "k.csv").write_text(kinect_csv(change=change))
    a, b = (s.positions[5, 0, 0] for s in read_skeletons(tmp_path / "k.csv").streams)
    assert a == pytest.approx([0.05] * 3)
    turn = np.array([[1, 0, 1], [0, np.sqrt(2), 0], [-1, 0, 1]]) / np.sqrt(2)
    assert b == pytest.approx(turn @ [1.05, 1.05, 1.05 - 2] + [0, 0, 3], abs=1e-6)


def test_real_recordings_of_two_kinects(shared_data):
    made = read_skeletons(shared_data("kinect_multitrack") / "Study_2_Kinect_2_Time_12_32_04_PM.csv.gz")
    assert len(made.streams) == 2 and made.common_clock
    for s in made.streams:
        assert len(s.joint_names) == 25 and 25 < s.rate < 32
        assert np.isfinite(s.positions).all(-1).mean() > 0.4


# ---- bounds ----


def test_a_gzip_bomb_stops_at_the_limit(tmp_path):
    bomb = tmp_path / "bomb.csv.gz"
    with gzip.open(bomb, "wb", compresslevel=9) as out:
        for _ in range(64):
            out.write(b"0,\n" * 350_000)
    assert bomb.stat().st_size < 200_000
    with pytest.raises(InputError, match="unpacks to more than 8 MiB"):
        for _ in bounded_lines(bomb, "a test", limit=8 * 2**20):
            pass


# ---- Azure Kinect ----


def test_azure_recording(shared_data, tmp_path):
    missing.module("av", "depth of Azure Kinect recordings", "pip install 'hypose[azure]'")
    calibration, frames = read_azure_mkv(shared_data("azure_kinect_mkv") / "recording.mkv")
    (one,) = frames
    seen = one.depth[one.depth > 0]
    assert one.depth.shape == (576, 640) and seen.size > 1000 and 0.2 < np.median(seen) < 5
    assert "CalibrationInformation" in calibration
    (tmp_path / "a.mkv").write_bytes(b"nothing" * 100)
    with pytest.raises(InputError, match="not a video"):
        read_azure_mkv(tmp_path / "a.mkv")


# ---- test skeleton lines -------------------------------------------------------------------------------------------
# The line protocol for skeletons: what is read, what is refused.


def test_a_line_comes_back_as_it_was(rng):
    positions = rng.normal(size=(3, 3))
    positions[1] = np.nan
    line = SensorReport("left-1", 12.5, 3, JOINTS, positions, np.array([2, 0, 1], np.uint8), 99.25)
    back, token = parse_line(format_line(line).replace('"sensor"', '"token":"secret","sensor"').encode())
    np.testing.assert_allclose(back.positions, positions, atol=1e-5)
    assert back.state.tolist() == [2, 0, 1] and back.joint_names == JOINTS
    assert (back.sensor, back.time, back.person, token, back.arrival) == ("left-1", 12.5, 3, "secret", 99.25)
    empty, _ = parse_line(format_line(SensorReport("a", 1.0, None, (), np.zeros((0, 3)), np.zeros(0, np.uint8))))
    assert empty.person is None and empty.joint_names == ()


def test_units_and_ways_to_say_missing():
    text = '{"sensor":"a","time":1,"unit":"mm","joints":{"a":[1,2,3000],"b":[-9999,0,0],"c":[NaN,0,0],"d":[1,1,1,0]}}'
    line, _ = parse_line(text)
    assert line.positions[0] == pytest.approx([0.001, 0.002, 3])
    assert line.state.tolist() == [2, 0, 0, 0] and np.isnan(line.positions[1:]).all()


GOOD = '{"sensor":"a","time":1.5,"joints":{"head":[0,1,2]}}'


@pytest.mark.parametrize(
    "text",
    [
        "",
        "garbage",
        b"\xff\xfe\x00",
        "[]",
        "3",
        "[" * 10_000,
        GOOD.replace("1.5", "NaN"),
        GOOD.replace("1.5", "1e999"),
        GOOD.replace("1.5", '"now"'),
        GOOD.replace("1.5", "true"),
        GOOD.replace("1.5", "9" * 5000),
        GOOD.replace('"a"', '"' + "a" * 40 + '"'),
        GOOD.replace('"a"', '"a\\n"'),
        GOOD.replace('"sensor"', '"Sensor"'),
        GOOD.replace("[0,1,2]", "[0,1]"),
        GOOD.replace("[0,1,2]", "[0,1,2,3]"),
        GOOD.replace("[0,1,2]", "[0,1,true]"),
        GOOD.replace("[0,1,2]", '[0,1,"2"]'),
        GOOD.replace("[0,1,2]", "[0,1,2000]"),
        GOOD.replace("[0,1,2]", "[0,1,1e999]"),
        GOOD.replace("[0,1,2]", f"[0,1,{10**400}]"),
        GOOD.replace("[0,1,2]", f"[0,1,{10**400},2]"),
        GOOD.replace("[0,1,2]", "[0,1,2000,2]"),
        GOOD.replace("[0,1,2]", "[0,1,2,true]"),
        GOOD.replace("[0,1,2]", "[0,1,2,1.5]"),
        GOOD.replace("[0,1,2]", "{}"),
        GOOD.replace('{"head":[0,1,2]}', "{}"),
        GOOD.replace('{"head":[0,1,2]}', "7"),
        GOOD.replace('"head"', '"\\u0000"'),
        GOOD.replace("}}", '},"person":-1}'),
        GOOD.replace("}}", '},"person":1.5}'),
        GOOD.replace("}}", '},"unit":"inch"}'),
        GOOD.replace("}}", '},"token":7}'),
        GOOD + " " * MAX_SKELETON_LINE,
        json.dumps({"sensor": "a", "time": 1, "joints": {f"j{i}": None for i in range(65)}}),
    ],
)
def test_bad_lines_are_refused_in_a_short_sentence(text):
    assert parse_line(GOOD)[0].state.tolist() == [2]
    with pytest.raises(InputError) as refused:
        parse_line(text)
    assert len(str(refused.value)) < 250 and "\n" not in str(refused.value)


def test_a_file_of_lines(tmp_path, rng):
    lines = []
    for n in range(10):
        for k in "ab":
            names = JOINTS if k == "a" or n % 2 == 0 else JOINTS[::-1]
            p = np.stack([np.full(3, float(len(x))) for x in names])
            lines.append(format_line(SensorReport(k, n / 30, 0, names, p, np.full(3, 2, np.uint8))))
    (tmp_path / "s.jsonl.gz").write_bytes(gzip.compress("\n".join(lines).encode()))
    made = read_skeletons(tmp_path / "s.jsonl.gz")
    assert [s.name for s in made.streams] == ["a", "b"]
    np.testing.assert_array_equal(made.streams[0].positions, made.streams[1].positions)
    (tmp_path / "t.jsonl").write_text("\n".join([*lines[:3], lines[0].replace("head", "tail")]))
    with pytest.raises(InputError, match="line 4: the sensor a reports"):
        read_skeletons(tmp_path / "t.jsonl")


def test_offline_processor_of_azure_kinect(shared_data):
    made = read_skeletons(shared_data("outside_cases") / "offline.json")
    (stream,) = made.streams
    assert len(stream.times) == 60 and stream.rate == pytest.approx(25) and "WRIST_LEFT" in stream.joint_names
    assert 2 < np.nanmedian(stream.positions[..., 2]) < 4  # metres


def test_depth_that_was_not_measured_is_a_hole(tmp_path):
    write_millimetres_png(tmp_path / "a.png", np.array([[0, 65535, 1500]], dtype=np.uint16))
    assert read_depth_png(tmp_path / "a.png").tolist() == [[0.0, 0.0, 1.5]]
