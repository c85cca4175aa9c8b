"""Knee angle over time from a results folder:  python read_results.py session/results/default"""

import sys
from pathlib import Path

import numpy as np

import hypose

folder = Path(sys.argv[1])
motion = hypose.load_motion(folder / "motion.npz")
names, angles = hypose.joint_angles(motion.skeleton, motion.poses)
good = ~(motion.lost | motion.extrapolated)
knee = np.degrees(angles[good, names.index("knee_angle_r")])
print(f"{good.sum()} of {len(motion)} frames; right knee {knee.min():.0f} to {knee.max():.0f} degrees")
