"""Draws docs/images/presets.png: the published filters on table-2.3 and table-2.4 beside the published figures.

python docs/plot_presets.py TABLE_2_3.json TABLE_2_4.json   (written by `./run bench table-2.3 --json ...` and so on)
"""

import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

# Alcoverro 2014, means over the sequences of Table 2.3 (mm, HumanEva) and Table 2.4 (cm there, IXMAS)
PUBLISHED = {
    "table-2.3": {"apf": 111.2, "hpf": 103.0, "hpf-apo": 91.7},
    "table-2.4": {"apf": 199.6, "hpf": 136.5, "dd-hpf": 118.8, "dd-hpf+": 106.0, "dd-hpf+5": 113.9},
}


def main() -> None:
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.2))
    metrics = (("table-2.3", "mean_error_mm", "/all"), ("table-2.4", "extremity_error_mm", ""))
    for axis, path, (name, metric, suffix) in zip(axes, sys.argv[1:3], metrics, strict=True):
        results = json.loads(Path(path).read_text())["results"]
        rows = {r["case"].removesuffix(suffix): r for r in results if r["metric"] == metric}
        rows = {k: r for k, r in rows.items() if "/" not in k}
        at = np.arange(len(rows))
        spread = [r["sd"] or 0.0 for r in rows.values()]
        axis.bar(at - 0.2, [r["value"] for r in rows.values()], 0.4, yerr=spread, label="here", color="#1f77b4")
        published = PUBLISHED[name]
        known = [(x, published[k]) for x, k in zip(at, rows, strict=True) if k in published]
        axis.bar(*(np.array(known) + [0.2, 0.0]).T, 0.4, label="published, real data", color="#bbbbbb")
        axis.set_xticks(at, rows)
        axis.set_xlim(-0.6, len(rows) - 0.4)
        axis.set_ylabel("mm")
        axis.set_title(f"{name}: median over seeds, bar = sd", fontsize=9)
        axis.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(Path(__file__).parent / "images" / "presets.png", dpi=80)


if __name__ == "__main__":
    main()
