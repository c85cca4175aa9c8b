"""Draw docs/images/subject-fit.png: the template at the right height and the estimated body on a synthetic recording.

python scripts/subject_picture.py
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from PIL import Image as Pillow

from benchmarks.multiview.body_measures import fit_scene
from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.body.body import Body
from hypose.compute.parts import covered
from hypose.geometry import Array
from hypose.synthetic.scenes import Scene
from hypose.synthetic.subjects import load_subjects

OUT = Path(__file__).resolve().parent.parent / "docs/images/subject-fit.png"
BODY, OUTLINE = (60, 190, 250), (255, 60, 200)


def main() -> None:
    """Estimate the heavy subject from 3 s of movement and draw one of the fitted frames in four views."""
    scene = noisy_scene("combo", load_subjects()["heavy"], "humaneva-4", seconds=3.0, seed=1)
    found, _ = fit_scene(scene, None)
    k = int(np.argmin(found.iou_before.mean(1)))
    rows = []
    for body, pose in ((found.template, found.template_poses[k]), (found.body, found.poses[k])):
        rows.append(np.concatenate([tile(scene, c, found.frames[k], body, pose) for c in range(4)], 1))
    sheet = np.concatenate(rows, 0)
    Pillow.fromarray(sheet).quantize(96, dither=Pillow.Dither.NONE).save(OUT, optimize=True)
    print(OUT, OUT.stat().st_size, "before", found.iou_before[k].round(3), "after", found.iou[k].round(3))


def tile(scene: Scene, view: int, index: int, body: Body, pose: Array) -> np.ndarray:
    """One view of one frame: the body tinted, the true outline as a line, cut to the person; (360, 220, 3) RGB."""
    camera = scene.rig.pinhole()[view]
    picture = cv2.GaussianBlur(scene.rgb_frame(view, index)[..., ::-1], (0, 0), 1.5)  # smooth pictures are small
    v = body.skin(pose, body.fine)
    depth = v @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
    own = covered(camera.project_pinhole(v), depth, body.fine.faces, camera.size[::-1]) > 0
    out = picture.astype(np.float64)
    out[own] = 0.5 * out[own] + 0.5 * np.array(BODY)
    true = scene.clean_mask(view, index)
    lines, _ = cv2.findContours(true, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    out = cv2.drawContours(np.ascontiguousarray(out.astype(np.uint8)), lines, -1, OUTLINE, 2)
    y, x = np.nonzero(true)
    middle, half = (int(y.mean()), int(0.5 * (x.min() + x.max()))), int(0.56 * np.ptp(y))
    wide = half * 220 // 360
    padded = cv2.copyMakeBorder(out, half, half, half, half, cv2.BORDER_REPLICATE)
    top, left = middle[0], middle[1] + half - wide
    return cv2.resize(padded[top : top + 2 * half, left : left + 2 * wide], (220, 360), interpolation=cv2.INTER_AREA)


if __name__ == "__main__":
    main()
