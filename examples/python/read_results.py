"""Knee angle over time from a results folder:  python read_results.py session/results/default"""

import sys
from pathlib import Path

import hypose

folder = Path(sys.argv[1])
result = hypose.load_result(folder)
good = ~(result.motion.lost | result.motion.extrapolated)
knee = result.angles["knee_angle_r"][good]
print(f"{good.sum()} of {len(good)} frames; right knee {knee.min():.0f} to {knee.max():.0f} degrees")
print(result.assessment.sentence)
