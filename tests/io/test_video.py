"""Videos: exact frames, true counts, whole files or none."""

import cv2
import numpy as np
import pytest

from hypose.errors import InputError
from hypose.io.videos.video import check_numbers, count_frames, frame_size, open_video, read_image, writing_video
from tests.io.recordings import SIZE, frame, frame_number, make_video


@pytest.mark.parametrize("ending", [".avi", ".mkv"])
def test_written_frames_come_back_in_order(tmp_path, ending):
    path = make_video(tmp_path / f"a{ending}", 40, frame_rate=50)
    with open_video(path) as reader:
        assert reader.size == SIZE == frame_size(path)
        assert reader.frame_rate == pytest.approx(50)
        assert reader.n_frames == reader.stated_frames == 40
        assert [frame_number(f) for f in reader] == list(range(40))
        assert list(reader) == []
    assert [p.name for p in tmp_path.iterdir()] == [path.name]  # no temporary file is left


@pytest.mark.parametrize("ending", [".mp4", ".webm"])
def test_lossy_videos(tmp_path, ending):
    with writing_video(tmp_path / f"a{ending}", 30, (65, 49)) as writer:
        for i in range(20):
            writer.write(np.full((49, 65, 3), 10 * i, np.uint8))
    with open_video(tmp_path / f"a{ending}") as reader:
        assert reader.size == (64, 48) and reader.n_frames == 20
        # these codecs give grey levels back about 3 darker (rounding in the conversion to YUV and back)
        assert np.abs([f.mean() - 10 * i for i, f in enumerate(reader)]).max() < 4


@pytest.mark.parametrize("jumps", [False, True])
@pytest.mark.parametrize("ending", [".avi", ".mp4"])
def test_seeking_is_exact(tmp_path, ending, jumps, rng):
    path = make_video(tmp_path / f"a{ending}", 60)
    reader = open_video(path)
    in_order = [f.copy() for f in reader]
    reader.jumps = jumps
    for i in [0, 59, 30, 31, 30, *rng.integers(0, 60, 10)]:
        assert np.array_equal(reader.read(int(i)), in_order[i])
        assert reader.position == i + 1
    reader.seek(57)
    assert len(list(reader)) == 3
    reader.seek(0)
    assert np.array_equal(reader.read(), in_order[0])
    for bad in (-1, 61):
        with pytest.raises(InputError, match=r"has no frame -?\d+"):
            reader.seek(bad)
    with pytest.raises(InputError, match=r"ends with frame 59, frame 60 was asked for"):
        reader.read(60)


def test_a_folder_of_images_behaves_like_a_video(tmp_path):
    for i in range(12):
        cv2.imwrite(str(tmp_path / f"f{i}.png"), frame(i))
    (tmp_path / "notes.txt").write_text("not an image")
    with open_video(tmp_path) as reader:
        assert (reader.size, reader.n_frames, reader.frame_rate) == (SIZE, 12, None)
        assert [frame_number(f) for f in reader] == list(range(12))  # f10 after f9
        assert frame_number(reader.read(3)) == 3
    assert count_frames(tmp_path) == 12
    single = open_video(tmp_path / "f7.png")
    assert single.n_frames == 1 and frame_number(single.read(0)) == 7
    cv2.imwrite(str(tmp_path / "f5.png"), frame(5, (32, 32)))
    reader = open_video(tmp_path)
    with pytest.raises(InputError, match=r"f5\.png is 32 x 32 px, the first image of its folder is 64 x 48 px"):
        list(reader)


@pytest.mark.parametrize(
    ("names", "lacking"),
    [
        (["f0001", "f0002", "f0004", "f0005"], "lacks number 3 "),
        (["10", "20", "30", "60", "70", "80"], "lacks number 40, 50 "),
        (["0", "1", "2", *(str(n) for n in range(10, 30))], "3, 4, 5, 6, 7 and 2 more"),
    ],
)
def test_a_gap_in_an_image_sequence_is_named(tmp_path, names, lacking):
    for name in names:
        (tmp_path / f"{name}.png").touch()
    with pytest.raises(InputError, match=lacking):
        check_numbers(tmp_path)


@pytest.mark.parametrize(
    ("data", "message"),
    [(b"\x89PNG\r\n\x1a\n broken", "is not an image or is damaged"), (b"", "is empty; give the path of an image")],
)
def test_damaged_image(tmp_path, data, message):
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(InputError, match=rf"a\.png {message}"):
        read_image(tmp_path / "a.png")


def test_a_video_whose_end_was_never_written_is_counted_by_decoding(tmp_path, shared_data):
    """A copy program may make room for all and stop half-way; the index lies behind the pictures."""
    data = (shared_data("pose2sim_balancing/videos") / "cam01.mp4").read_bytes()
    begin, end = data.index(b"mdat") + 4, data.index(b"moov") - 4
    half = (begin + end) // 2
    (tmp_path / "whole.mp4").write_bytes(data)
    (tmp_path / "half.mp4").write_bytes(data[:half] + bytes(end - half) + data[end:])
    assert open_video(tmp_path / "whole.mp4").n_frames == 100
    with open_video(tmp_path / "half.mp4") as reader:
        assert reader.stated_frames == 100 and 10 < reader.n_frames < 90
        assert sum(1 for _ in reader) == reader.n_frames


def test_a_container_that_promises_too_much(shared_data):
    """These files state two frames more than they hold."""
    with open_video(shared_data("uu4cam/cam1") / "background.avi") as reader:
        assert reader.stated_frames == 134 and reader.n_frames == 132
        assert sum(1 for _ in reader) == 132


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("empty.mp4", b"", r"empty\.mp4 is empty \(0 bytes\); record or copy it again"),
        ("none.mp4", ..., r"none\.mp4 does not exist"),
        ("", ..., "holds no images"),
        ("text.mp4", b"hello " * 100, r"text\.mp4 cannot be opened as a video"),
        ("cut.mp4", None, r"cut\.mp4 cannot be opened as a video \(not a video, cut off"),
    ],
)
def test_not_a_video(tmp_path, name, data, message):
    if data is None:  # the index of an .mp4 stands at its end
        data = make_video(tmp_path / "whole.mp4", 30).read_bytes()[:-800]
    if data is not ...:
        (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=message):
        open_video(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "rate", "message"),
    [
        ("a.avi", 25, r"frame 0 is .*, needed are 64 x 48 px"),
        ("a.gif", 25, r"name the video \.mp4"),
        ("a.avi", 0, "give a positive frame rate"),
        ("file/a.avi", 25, "cannot be written"),
    ],
)
def test_writer_refuses(tmp_path, name, rate, message):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=message), writing_video(tmp_path / name, rate, SIZE) as writer:
        writer.write(frame(0, (32, 32)))
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_video_without_frames_is_not_written(tmp_path):
    with pytest.raises(InputError, match="no frame was given"), writing_video(tmp_path / "a.avi", 25, SIZE):
        pass
    assert not list(tmp_path.iterdir())
