"""Run as a file by the Python of MediaPipe's own environment, which has no hypose: pictures in, landmarks out.

Input: for each picture its height and width as little-endian 32-bit integers, then its bytes, BGR. Output: one line
each, JSON: null, or 33 times [x, y, visibility] in shares of the picture. The first line says that the model is loaded.
"""

from __future__ import annotations

import importlib
import json
import os
import struct
import sys


def main() -> None:
    """Answer until the input ends."""
    # the library writes to stdout what it likes: the answers get a channel of their own
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    numpy, library = importlib.import_module("numpy"), importlib.import_module("mediapipe")
    landmarker = library.solutions.pose.Pose(static_image_mode=True, model_complexity=1)
    print(json.dumps({"version": library.__version__}), file=answers, flush=True)
    while len(head := sys.stdin.buffer.read(8)) == 8:
        height, width = struct.unpack("<ii", head)
        data = sys.stdin.buffer.read(height * width * 3)
        if len(data) < height * width * 3:
            return
        picture = numpy.frombuffer(data, numpy.uint8).reshape(height, width, 3)
        found = landmarker.process(numpy.ascontiguousarray(picture[:, :, ::-1])).pose_landmarks
        person = None if found is None else [[p.x, p.y, p.visibility] for p in found.landmark]
        print(json.dumps(person), file=answers, flush=True)


if __name__ == "__main__":
    main()
