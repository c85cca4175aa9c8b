"""The pictures of README.md, from the synthetic recording of `hypose demo`.

hypose demo --out demo && python docs/images/make.py demo
"""

import sys
from pathlib import Path

import cv2
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from hypose.app.reports.overlay import PictureRows, write_overlay
from hypose.body.joint_angles import joint_angles
from hypose.io.motions.results import load_body, load_motion
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import load_recording

HERE = Path(__file__).parent


def main(folder: Path) -> None:
    """result.png: four views of one frame with the body on them, and joint angles below."""
    results = folder / "results" / "default"
    recording, motion, body = (
        load_recording(folder),
        load_motion(results / "motion.npz"),
        load_body(results / "body.npz"),
    )
    row = int(np.nanargmin(motion.cost))
    with FrameStream(recording) as source:
        shown = write_overlay("", recording, source, motion, body, PictureRows(False, stills=[row]))
    views = cv2.resize(shown.stills[row], (960, 240), interpolation=cv2.INTER_AREA)
    names, values = joint_angles(motion.skeleton, motion.poses)
    figure, panels = plt.subplots(1, 3, figsize=(9.6, 2.1), dpi=100, layout="constrained", sharex=True)
    for axes, key, title in zip(
        panels, ("hip_flexion", "knee_angle", "elbow_flex"), ("hip", "knee", "elbow"), strict=True
    ):
        for side, colour, word in (("l", "#d9731a", "left"), ("r", "#2679c0", "right")):
            axes.plot(motion.times, np.degrees(values[:, names.index(f"{key}_{side}")]), color=colour, label=word)
        axes.set_title(f"{title} flexion (°)", fontsize=9)
        axes.set_xlabel("time (s)", fontsize=8)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.25)
    panels[0].legend(fontsize=8, frameon=False)
    figure.canvas.draw()
    plot = np.asarray(figure.canvas.buffer_rgba())[..., 2::-1]
    picture = np.concatenate([views, plot[:, :960]])
    # 5 bits per channel compress to half and look the same
    picture = np.where(picture > 250, 255, picture & 0xF8).astype(np.uint8)
    cv2.imwrite(str(HERE / "result.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "demo"))
