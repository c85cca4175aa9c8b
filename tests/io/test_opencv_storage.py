"""OpenCV's own writer is the oracle: what it writes is read back, in both of its forms."""

import cv2
import numpy as np
import pytest

from hypose.io.calibrations.calibration_text import parse_storage


@pytest.mark.parametrize("ending", ["yml", "xml"])
def test_what_opencv_writes_is_read(tmp_path, rng, ending):
    matrix, vector = rng.normal(size=(3, 4)) * 1e-7, np.array([[1.0], [np.inf], [-0.5]])
    path = tmp_path / f"a.{ending}"
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("K_01", matrix)
    file.write("T", vector)
    file.write("width", 1920)
    file.write("rms", 0.25)
    file.write("title", "left camera: 1")
    file.startWriteStruct("names", cv2.FILE_NODE_SEQ)
    for name in ("cam 1", "07", "x"):
        file.write("", name)
    file.endWriteStruct()
    file.startWriteStruct("nested", cv2.FILE_NODE_MAP)
    file.write("a", 1)
    file.endWriteStruct()
    file.release()
    found = parse_storage(path.read_text())
    np.testing.assert_array_equal(found["K_01"], matrix.ravel())
    np.testing.assert_array_equal(found["T"], vector.ravel())
    assert (found["width"], found["rms"], found["title"]) == (1920, 0.25, "left camera: 1")
    assert found["names"] == ["cam 1", "07", "x"]
    assert "nested" not in found and "a" not in found


@pytest.mark.parametrize(
    "text",
    ["", "a: [ 1, 2", "- 1", '{"a": 1}', "<opencv_storage>", "<other/>", "<!DOCTYPE a><opencv_storage/>"],
)
def test_other_texts_are_refused(text):
    with pytest.raises(ValueError, match="it |a list"):
        parse_storage(text)


def test_a_matrix_of_another_size_than_it_says_is_empty():
    text = "%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 2\n   cols: 2\n   dt: d\n   data: [ 1., 2., 3. ]\n"
    assert np.size(parse_storage(text)["K"]) == 0
