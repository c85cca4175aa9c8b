"""Model files: nothing lost, growth goes on bit for bit, damage refused."""

import numpy as np
import pytest

from benchmarks.depth_gestures.gesture_data import teach
from hypose.errors import InputError
from hypose.gestures.forest import ForestSettings
from hypose.gestures.model import GestureModel, from_arrays, to_arrays
from hypose.gestures.online import Example, Learner
from hypose.pipeline.gesture_files import SessionWriter, load_model, read_recording, save_model

from .toys import LENS, SHAPE, toy


def toy_examples(n, seed):
    rng = np.random.default_rng(seed)
    out = []
    for k in range(n):
        depth, (x, y), (a, b, side) = toy(rng, int(rng.integers(900, 1600)))
        if k % 2:
            yy, xx = np.mgrid[: SHAPE[0], : SHAPE[1]]
            depth[(yy - y) ** 2 + (xx - x) ** 2 < 30**2] = 2600
            out.append(Example(depth, LENS))
        else:
            out.append(Example(depth, LENS, 1, x, y))
    return out


def learner(seed=0):
    return Learner.new(np.random.default_rng(seed), ForestSettings(alpha=60, candidates=30))


def model_of(taught):
    return GestureModel("disc", taught, 12.5, ({"seconds": 3.0},))


@pytest.fixture(scope="module")
def taught():
    one = learner()
    teach(one, toy_examples(60, 1))
    return one


@pytest.mark.slow
def test_growth_goes_on_bit_for_bit_after_loading(tmp_path):
    straight, halves = learner(), learner()
    first, second = toy_examples(40, 1), toy_examples(40, 2)
    teach(straight, first + second)
    teach(halves, first)
    save_model(model_of(halves), tmp_path / "disc.npz")
    resumed = load_model(tmp_path / "disc.npz").learner
    teach(resumed, second)
    for name, a, b in zip(straight.forest.arrays._fields, straight.forest.arrays, resumed.forest.arrays, strict=True):
        np.testing.assert_array_equal(a, b, err_msg=name)
    assert resumed.strength == straight.strength


def test_equal_models_give_equal_bytes(taught, tmp_path):
    for name in ("a.npz", "b.npz"):
        save_model(model_of(taught), tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    back = load_model(tmp_path / "a.npz")
    assert (back.name, back.threshold) == ("disc", 12.5) and dict(back.history[0]) == {"seconds": 3.0}


@pytest.mark.parametrize("name", ["left", "size", "random", "description"])
def test_a_model_that_was_changed_is_refused(taught, name):
    """What follows its trees is compiled code, which would read outside of them."""
    arrays = to_arrays(model_of(taught))
    if name == "description":
        arrays[name] = np.array(str(arrays[name]).replace('"trees": 15', '"trees": 9'))
    else:
        arrays[name] = arrays[name] + 1
    with pytest.raises(ValueError, match="was changed"):
        from_arrays(arrays)


def test_names_that_could_be_paths_are_refused(taught):
    with pytest.raises(InputError, match="not a valid name"):
        GestureModel("../x", taught, None)


def test_sessions_are_recorded_and_read_again(tmp_path):
    writer = SessionWriter(tmp_path / "s", ["disc"], LENS, (SHAPE[1], SHAPE[0]))
    for k, e in enumerate(toy_examples(6, 1)):
        phase = "positive" if e.gesture else "negative"
        writer.add(k / 30, e.depth, phase, 1 + k // 2, e.gesture, (e.x, e.y))
    writer.act(0.1, "undo", "3")
    writer.close()
    back = read_recording(tmp_path / "s")
    shown = list(back.examples("disc"))
    assert len(back.frames) == 6 and len(shown) == 4 and back.undone == {3}
    np.testing.assert_array_equal(shown[0].depth, toy_examples(1, 1)[0].depth)
    assert shown[0].gesture == 1 and shown[1].gesture == 0
    with pytest.raises(InputError, match="not empty"):
        SessionWriter(tmp_path / "s", ["disc"], LENS, (SHAPE[1], SHAPE[0]))
    with pytest.raises(InputError, match="no gesture"):
        list(back.examples("square"))


def test_a_truncated_recording_keeps_what_is_whole(tmp_path):
    writer = SessionWriter(tmp_path / "s", ["disc"], LENS, (SHAPE[1], SHAPE[0]))
    for e in toy_examples(4, 1):
        writer.add(0.0, e.depth)
    writer.close()
    path = tmp_path / "s" / "frames.csv"
    path.write_text(path.read_text()[:-20])
    assert len(read_recording(tmp_path / "s").frames) == 3
    path.write_text(path.read_text().replace("depth/000001.png", "../secret.png"))
    with pytest.raises(InputError, match="line 3"):
        read_recording(tmp_path / "s")
