"""Draw the picture of docs/gestures.md: what the simulated sensor delivers.

python docs/plot_gestures.py
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.depth_gestures.gesture_pictures import CLUTTERED, TRAINING, picture
from hypose.synthetic.gesture_people import GESTURES

IMAGES = Path(__file__).parent / "images"


def sensor():
    rng = np.random.default_rng(7)
    figure, axes = plt.subplots(2, 3, figsize=(9, 4.8))
    for k, (axis, name) in enumerate(zip(axes.flat, GESTURES, strict=True)):
        frame = picture((2, 3, 13)[k % 3], name, TRAINING if k < 3 else CLUTTERED, rng, (14, 15))
        depth = np.where(frame.depth > 0, frame.depth / 1000, np.nan)
        shown = plt.get_cmap("viridis_r").copy()
        shown.set_bad("black")
        axis.imshow(depth, cmap=shown, vmin=0.8, vmax=4.5)
        axis.plot(frame.x, frame.y, "o", mfc="none", mec="red", ms=9, mew=1.5)
        axis.set_title(name.replace("_", " "), fontsize=9)
        axis.axis("off")
    figure.tight_layout(pad=0.8)
    figure.savefig(IMAGES / "gestures-sensor.png", dpi=75)


if __name__ == "__main__":
    sensor()
