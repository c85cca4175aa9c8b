"""Any calibration to TOML:  python convert_calibration.py Calib.qca.txt calibration.toml"""

import sys

import hypose

rig, notes = hypose.read_calibration(sys.argv[1])
hypose.write_calibration(rig, sys.argv[2])
print(f"{len(rig)} cameras: {', '.join(rig.names)}", *notes, sep="\n")
