"""The moving picture of the front page and of README.md, from the synthetic recording of `hypose demo`.

hypose demo --out demo && python docs/images/make.py demo
"""

import sys
from pathlib import Path

import cv2
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from hypose.app.reports.result_pictures import PictureRows, Shown, write_overlay
from hypose.body.joint_angles import joint_angles
from hypose.io.motions.results import load_body, load_motion
from hypose.io.recordings.frames import FrameStream
from hypose.io.recordings.recording import load_recording

HERE = Path(__file__).parent
SIDES = (("l", "#d9731a", "left"), ("r", "#2679c0", "right"))
WIDTH = 960
REACH = 1.64  # standard deviations of an angle that hold 90 %


def main(folder: Path) -> None:
    """moving.webp: every second frame, and the knee angles so far."""
    results = folder / "results" / "default"
    recording, motion, body = (
        load_recording(folder),
        load_motion(results / "motion.npz"),
        load_body(results / "body.npz"),
    )
    rows = range(0, len(motion), 2)
    with FrameStream(recording) as source:
        shown = write_overlay("", recording, source, [Shown("", motion, body)], PictureRows(False, stills=rows))
    views = {row: cv2.resize(still, (WIDTH, 240), interpolation=cv2.INTER_AREA) for row, still in shown.stills.items()}
    names, values = joint_angles(motion.skeleton, motion.poses)
    degrees = np.degrees(values)

    reach = REACH * np.degrees(motion.angle_sd)
    figure, axes = plt.subplots(figsize=(9.6, 1.7), dpi=100, layout="constrained")
    frames = []
    for row in rows:
        axes.clear()
        for side, colour, word in SIDES:
            k, t = names.index(f"knee_angle_{side}"), motion.times[: row + 1]
            axes.plot(t, degrees[: row + 1, k], color=colour, label=f"{word} knee")
            axes.fill_between(
                t, *(degrees[: row + 1, k] + s * reach[: row + 1, k] for s in (-1, 1)), color=colour, alpha=0.25, lw=0
            )
        axes.set(xlim=(0, motion.times[-1]), ylim=(-15, 85), xlabel="time (s)", ylabel="flexion (°)")
        axes.legend(fontsize=8, frameon=False, loc="upper right", ncols=2)
        axes.grid(alpha=0.25)
        frames.append(Image.fromarray(np.concatenate([views[row], drawn(figure)])[..., ::-1].copy()))
    duration = round(1000 * (rows[1] - rows[0]) / motion.frame_rate)
    frames[0].save(
        HERE / "moving.webp", save_all=True, append_images=frames[1:], duration=duration, loop=0, quality=60, method=6
    )


def drawn(figure: plt.Figure) -> np.ndarray:
    """The figure as a BGR image."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., 2::-1][:, :WIDTH]


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "demo"))
