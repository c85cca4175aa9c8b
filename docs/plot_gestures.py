"""Draws the pictures of docs/gestures.md: what the simulated sensor delivers; curves of
recall over 1 - precision (mean over seeds); alpha, beta and the trees' balance; sessions.

python docs/plot_gestures.py [FILE.json ...]     (of `./run bench gesture-table-3.1`, `-3.2`, `-3.3`, `gesture-sweeps`;
                                                  without files: the sensor)
"""

import argparse
import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.depth_gestures.gesture_pictures import CLUTTERED, TRAINING, picture
from hypose.synthetic.gesture_poses import GESTURES

IMAGES = Path(__file__).parent / "images"
STYLE = {
    "online_hard": ("online, hard negatives", "#1f77b4"),
    "online_random": ("online, random negatives", "#9ecae1"),
    "offline_boosted_around": ("offline boosted, negatives around the place", "#d9822b"),
    "offline_boosted": ("offline boosted, as published", "#f2c48d"),
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


def mean_curve(several):
    """The best recall at each 1 - precision, mean over the seeds' curves [(1 - precision, recall)]."""
    grid, out = np.linspace(0, 1, 201), []
    for points in several:
        x, y = np.array(points).reshape(-1, 2).T if len(points) else np.zeros((2, 0))
        order = np.argsort(x, kind="stable")
        best = np.concatenate([[0.0], np.maximum.accumulate(y[order])])
        out.append(best[np.searchsorted(x[order], grid, side="right")])
    return grid, np.mean(out, axis=0)


def curves(document):
    data = document["settings"]["curves"]
    names = [g for g in GESTURES if any(k.endswith(f"/{g}") for k in data)]
    figure, axes = plt.subplots(2, 3, figsize=(9, 5.4), sharex=True, sharey=True)
    for axis, name in zip(axes.flat, names, strict=False):
        for method, (label, colour) in STYLE.items():
            several = data.get(f"{method}/{name}")
            if several:
                axis.step(*mean_curve(several), where="post", label=label, color=colour, lw=1.4)
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
    figure.savefig(IMAGES / f"{document['name'].replace('gesture-', 'gestures-')}.png", dpi=100)


def sweeps(document):
    data, balance = document["settings"]["curves"], document["settings"]["balance"]
    ap = {r["case"]: r["value"] for r in document["results"] if r["metric"] == "ap"}
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6))
    for axis, name, fixed in ((axes[0], "alpha", None), (axes[1], "beta", "alpha_300")):
        keys = sorted((k for k in data if k.startswith(name)), key=lambda k: float(k.partition("_")[2]))
        chosen = {k: data[k] for k in keys}
        chosen = {fixed: data[fixed], **chosen} if fixed else chosen
        for shade, (key, several) in zip(np.linspace(0.25, 1, len(chosen)), chosen.items(), strict=True):
            value = "0" if key == fixed else key.partition("_")[2]
            label = f"{name} {value} (AP {ap[key]:.2f})"
            axis.step(*mean_curve(several), where="post", color=plt.get_cmap("Blues")(shade), lw=1.4, label=label)
        axis.set(xlim=(0, 1), ylim=(0, 1.02), title=f"pause, {name}")
        axis.set_xlabel("1 - precision")
        axis.set_ylabel("recall")
        axis.legend(fontsize=7, loc="lower right")
    widest = len(balance["offline"]) // 2
    colours = {"offline": "#d9822b", "alpha_50": "#9ecae1", "alpha_300": "#1f77b4"}
    for k, (name, colour) in enumerate(colours.items()):
        place = np.arange(-widest, widest + 1) + 0.27 * (k - 1)
        label = name if name == "offline" else f"online, {name.replace('_', ' ')}"
        axes[2].bar(place, balance[name], 0.27, color=colour, label=label)
    axes[2].set(
        xlabel="height of the left minus the right branch", ylabel="share of nodes", title="balance of the trees"
    )
    axes[2].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(IMAGES / "gestures-sweeps.png", dpi=90)


def sessions(document):
    rows = {(r["metric"], r["case"]): (r["value"], r["sd"] or 0.0) for r in document["results"]}
    bars = {"ap_10px": (0.75, 0.82, 0.85), "ap_5cm": (0.85, 0.92, 0.95)}
    published = {  # minutes and AP
        "interactive": ((3, 6, 9), (0.54, 0.78, 0.82)),
        "offline": ((4.85, 10.27, 16.98), (0.34, 0.64, 0.87)),
    }
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.4), sharey=True)
    for axis, (metric, goal) in zip(axes, bars.items(), strict=True):
        for method, colour in (("interactive", "#1f77b4"), ("offline", "#d9822b")):
            cases = [f"{method}/{m}min" for m in (3, 6, 9)]
            minutes = [rows["minutes", c][0] for c in cases]
            values, spread = zip(*(rows[metric, c] for c in cases), strict=True)  # over seeds: mean and sd
            axis.errorbar(minutes, values, spread, color=colour, marker="o", ms=4, capsize=3, label=method)
            if metric == "ap_10px":
                axis.plot(*published[method], color=colour, ls=":", label=f"{method}, published")
        axis.plot((3, 6, 9), goal, "_", color="black", ms=12, label="bar")
        axis.set(title=metric.replace("ap_10px", "AP at 10 px").replace("ap_5cm", "AP at 5 cm"), ylim=(0.3, 1.02))
        axis.set_xlabel("minutes, waiting included")
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=7, loc="lower right")
    figure.tight_layout()
    figure.savefig(IMAGES / "gestures-table-3.3.png", dpi=90)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("files", nargs="*")
    files = parser.parse_args().files
    IMAGES.mkdir(exist_ok=True)
    if not files:
        sensor()
    draw = {"gesture-sweeps": sweeps, "gesture-table-3.3": sessions}
    for file in files:
        document = json.loads(Path(file).read_text())
        draw.get(document["name"], curves)(document)


if __name__ == "__main__":
    main()
