"""The pictures of the studio in docs/images, from those that the tests take on their way through the page:

HYPOSE_PICTURES=FOLDER pytest tests/app/studio -m "slow or long or not slow" && python scripts/studio_pictures.py FOLDER

A picture that FOLDER lacks, because its test was left out, stays as it was.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2

OUT = Path(__file__).resolve().parent.parent / "docs/images"
_WIDTH, _QUALITY = 1280, 70
"""px, and of JPEG: about 80 KB each, in which letters can be read."""
PICTURES = {
    "list": "library",
    "view": "correct-seen",
    "cycle": "plots-cycle",
    "compare": "compare-difference",
    "correct": "correct-dragged",
    "report": "report",
    "teach": "gesture-several",
    "gesture": "gesture-test",
    "watch": "gesture-watched",
    "drop": "raw-dropped",
    "calibrate": "raw-calibrated",
    "in-step": "raw-moved",
    "check": "mend-findings",
    "masks": "raw-masks",
    "person": "setup-person",
    "track": "setup-tracked",
    "live": "live",
}
"""What docs/images/studio-NAME.jpg is called by the walks."""


def main(folder: Path) -> None:
    """Write those that there are."""
    for name, taken in PICTURES.items():
        image = cv2.imread(str(folder / f"{taken}.png"))
        if image is None:
            print(f"studio-{name}.jpg stays: there is no {taken}.png in {folder}")
            continue
        scale = min(1.0, _WIDTH / image.shape[1])
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(OUT / f"studio-{name}.jpg"), small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("Give the folder with the pictures of the tests.")
    main(Path(sys.argv[1]))
