"""Any calibration to any other:  python convert_calibration.py calibration.toml easymocap/intri.yml"""

import sys

import hypose

rig, notes = hypose.read_calibration(sys.argv[1])
hypose.write_calibration(rig, sys.argv[2])
print(f"{len(rig)} cameras: {', '.join(rig.names)}", *notes, sep="\n")
