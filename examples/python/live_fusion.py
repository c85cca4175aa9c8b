"""Depth sensors fused live; here a recording plays, report by report in the order of time: live_fusion.py RECORDING"""

import sys

import hypose

fuser, sensors = hypose.LiveFuser(), hypose.read_skeletons(sys.argv[1]).streams
for now, s, t in sorted((float(now), s, t) for s, one in enumerate(sensors) for t, now in enumerate(one.times)):
    one = sensors[s]
    fuser.push(one.name, now, int(one.person_ids[t, 0]), one.joint_names, one.positions[t, 0], one.state[t, 0], now)
    for frame in fuser.poll(now):
        print(f"{frame.time:.2f} s:", *(f"head at {p.joints[0].round(2)} m by {len(p.sensors)}" for p in frame.people))
