"""The line protocol for skeletons: what is read, what is refused."""

import gzip
import json

import numpy as np
import pytest

from hypose.errors import InputError
from hypose.evidence.frame import SensorReport
from hypose.io.sensors.skeleton_files import read_skeletons
from hypose.io.sensors.skeleton_lines import MAX_SKELETON_LINE, format_line, parse_line, read_lines

JOINTS = ("head", "neck", "torso")


def test_a_line_comes_back_as_it_was(rng):
    positions = rng.normal(size=(3, 3))
    positions[1] = np.nan
    line = SensorReport("left-1", 12.5, 3, JOINTS, positions, np.array([2, 0, 1], np.uint8), 99.25)
    back, token = parse_line(format_line(line, "secret").encode())
    np.testing.assert_allclose(back.positions, positions, atol=1e-5)
    assert back.state.tolist() == [2, 0, 1] and back.joint_names == JOINTS
    assert (back.sensor, back.time, back.person, token, back.arrival) == ("left-1", 12.5, 3, "secret", 99.25)
    nobody, _ = parse_line(format_line(SensorReport("a", 1.0, None, (), np.zeros((0, 3)), np.zeros(0, np.uint8))))
    assert nobody.person is None and nobody.joint_names == ()


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
    (tmp_path / "t.jsonl").write_text("\n".join([*lines[:3], "oops"]))
    with pytest.raises(InputError, match="line 4: the line is no JSON"):
        read_lines(tmp_path / "t.jsonl")
    (tmp_path / "t.jsonl").write_text("\n".join([*lines[:3], lines[0].replace("head", "tail")]))
    with pytest.raises(InputError, match="line 4: the sensor a reports"):
        read_lines(tmp_path / "t.jsonl")
