"""Draws docs/images/fusion_shares.png: which sensors a swarm's candidates come from, as Fig. 8 of Asteriadis 2013.

python docs/plot_fusion.py [--data FOLDER]
"""

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.depth_sensors.fusion_scenes import FRESH_SEED
from benchmarks.depth_sensors.sensor_choice import choose, heading, noise_of, register_per_frame
from benchmarks.synthetic.sensors import HIDDEN_BELOW
from benchmarks.synthetic.treadmill import treadmill_recording
from hypose.fusion import joints as jt
from hypose.fusion.register import register, upward
from hypose.fusion.swarm import IMPROVED, PUBLISHED

FRAMES = slice(250, 550)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", type=Path, default=None)
    data = parser.parse_args().data
    recording = treadmill_recording("A", np.random.default_rng([FRESH_SEED, ord("A")]), data)
    figure, axes = plt.subplots(2, 2, figsize=(9, 5), sharex=True, sharey=True)
    names, colours = ("front", "left", "right"), ("#777777", "#1f77b4", "#d9822b")
    for column, (title, settings, per_frame) in enumerate(
        (("published", PUBLISHED, True), ("improved", IMPROVED, False))
    ):
        if per_frame:
            world = register_per_frame(recording.positions)
        else:
            world = register(recording.positions, recording.state).apply(recording.positions)
        choice = choose(world, noise_of(recording, settings), heading(world, upward(world)), settings, 0)
        for line, (hand, joint) in enumerate((("left hand", jt.LEFT_HAND), ("right hand", jt.RIGHT_HAND))):
            axis = axes[line, column]
            frames = np.arange(len(recording))[FRAMES]
            axis.stackplot(frames, choice.shares[FRAMES, line].T, colors=colours, labels=names)
            for k in range(3):
                seen = recording.visible[FRAMES, k, joint] >= HIDDEN_BELOW
                axis.scatter(frames[seen], np.full(seen.sum(), 1.04 + 0.05 * k), s=2, color=colours[k], clip_on=False)
            axis.set_xlim(frames[0], frames[-1])
            axis.set_ylim(0, 1)
            axis.set_title(f"{title}, {hand}", fontsize=9, pad=22)
    for axis in axes[1]:
        axis.set_xlabel("frame")
    for axis in axes[:, 0]:
        axis.set_ylabel("share of candidates")
    axes[1, 1].legend(loc="lower right", fontsize=8, title="sensor", title_fontsize=8)
    figure.tight_layout()
    out = Path(__file__).parent / "images" / "fusion_shares.png"
    out.parent.mkdir(exist_ok=True)
    figure.savefig(out, dpi=80)


if __name__ == "__main__":
    main()
