"""ASF/AMC: a skeleton by hand with known answers and the real walk."""

import numpy as np

from benchmarks.synthetic.asf import bone_ends, global_rotations, read_amc, read_asf
from hypose.geometry import so3_exp

ASF = """# made by hand
:version 1.10
:name test
:units
  mass 1.0
  length 0.45
  angle deg
:documentation
  anything may stand here
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name lower
    direction 0 0 5
    length 2
    axis 0 0 0 XYZ
    dof rx
    limits (-10.0 170.0)
  end
  begin
    id 2
    name upper
    direction 0 -1 0
    length 3
    axis 0 0 90 XYZ
    dof rx ry rz
  end
  begin
    id 3
    name stiff
    direction 1 0 0
    length 1
    axis 10 20 30 XYZ
  end
:hierarchy
  begin
    root upper stiff
    upper lower
  end
"""
AMC = """#!comment
:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 0 0 0
upper 0 0 0
lower 0
2
root 1 2 3 0 90 0
upper 30 0 0
lower 40
"""


def test_rotations_are_conjugated_by_the_axis_and_follow_the_parent(tmp_path):
    (tmp_path / "a.asf").write_text(ASF)
    (tmp_path / "a.amc").write_text(AMC)
    asf, frames = read_asf(tmp_path / "a.asf"), read_amc(tmp_path / "a.amc")
    position, r = global_rotations(asf, frames)
    np.testing.assert_allclose(position, [[1, 2, 3], [1, 2, 3]])
    for name in asf.names:
        np.testing.assert_allclose(r[name][0], np.eye(3), atol=1e-12)
    root = so3_exp([0, np.pi / 2, 0])
    np.testing.assert_allclose(r["root"][1], root, atol=1e-12)
    # the bone's own x axis is the file's y axis: its axis entry turns x by 90 degrees about z
    upper = root @ so3_exp([0, np.radians(30), 0])
    np.testing.assert_allclose(r["upper"][1], upper, atol=1e-12)
    np.testing.assert_allclose(r["lower"][1], upper @ so3_exp([np.radians(40), 0, 0]), atol=1e-12)
    np.testing.assert_allclose(r["stiff"][1], root, atol=1e-12)
    ends = bone_ends(asf, frames)
    np.testing.assert_allclose(ends[0], [[1, 2, 3], [1, -1, 3], [2, 2, 3], [1, -1, 5]], atol=1e-12)
