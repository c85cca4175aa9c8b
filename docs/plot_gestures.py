"""Draws the pictures of docs/gestures.md: what the simulated sensor delivers, and curves of recall over 1 - precision.

python docs/plot_gestures.py FILE.json [FILE.json ...]     (of `hypose bench gesture-table-3.1` or `-3.2`)
"""

import argparse
import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from hypose.evaluation.gesture_poses import GESTURES
from hypose.evaluation.gesture_scenes import CLUTTERED, TRAINING, picture

IMAGES = Path(__file__).parent / "images"
STYLE = {
    "online_hard": ("online, hard negatives", "#1f77b4"),
    "online_random": ("online, random negatives", "#9ecae1"),
    "offline_boosted": ("offline boosted", "#d9822b"),
    "clipped_15": ("clipped at 15 cm", "#1f77b4"),
    "clipped_30": ("30 cm", "#6baed6"),
    "clipped_50": ("50 cm", "#bdd7e7"),
    "unclipped": ("not clipped", "#d9822b"),
    "subforest": ("boosted sub-forests, not clipped", "#777777"),
}


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


def curves(file):
    document = json.loads(Path(file).read_text())
    data = document["settings"]["curves"]
    names = [g for g in GESTURES if any(k.endswith(f"/{g}") for k in data)]
    figure, axes = plt.subplots(2, 3, figsize=(9, 5.4), sharex=True, sharey=True)
    for axis, name in zip(axes.flat, names, strict=False):
        for method, (label, colour) in STYLE.items():
            points = np.array(data.get(f"{method}/{name}", []))
            if len(points):
                axis.step(points[:, 0], points[:, 1], where="post", label=label, color=colour, lw=1.4)
        axis.set_title(name.replace("_", " "), fontsize=9)
        axis.grid(alpha=0.3)
        axis.set_xlim(0, 1)
        axis.set_ylim(0, 1.02)
    for axis in axes[-1]:
        axis.set_xlabel("1 - precision", fontsize=8)
    for axis in axes[:, 0]:
        axis.set_ylabel("recall", fontsize=8)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=3, fontsize=8, frameon=False)
    figure.tight_layout(rect=(0, 0.08, 1, 1))
    which = "3.1" if any(k.startswith("clipped") for k in data) else "3.2"
    figure.savefig(IMAGES / f"gestures-table-{which}.png", dpi=100)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("files", nargs="*")
    IMAGES.mkdir(exist_ok=True)
    sensor()
    for file in parser.parse_args().files:
        curves(file)


if __name__ == "__main__":
    main()
