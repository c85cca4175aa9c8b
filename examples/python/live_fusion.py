"""Depth sensors fused live; here a recording plays, report by report in the order of time: live_fusion.py RECORDING"""

import sys

import hypose

reports = hypose.read_skeletons(sys.argv[1]).reports()
for frame in hypose.LiveFuser().frames(reports):
    print(f"{frame.time:.2f} s:", *(f"head at {p.joints[0].round(2)} m by {len(p.sensors)}" for p in frame.people))
