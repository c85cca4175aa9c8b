"""What speaks against a clip as a whole: views that contradict each other, masks that show more than the body.

No frame of such a clip stands out from the others, and no single joint: a wrong calibration, a camera that lags, a
chair in the masks are there from the first frame to the last.
"""

from __future__ import annotations

from numpy.typing import ArrayLike

from hypose.tracking.audit import more_than_body
from hypose.tracking.fitted_spread import beyond_usual

LOOK_APART_M, WRONG_APART_M = 0.006, 0.015
"""m by which views contradict each other beyond the usual, from which on a clip is worth a look, and not to be trusted.
On scenes (seeds 600 to 607) it was less than 5.5 mm through the right cameras, with things in the masks as well, 9 to
16 mm with a calibration that is 1 % off, which costs 20 mm, 17 to 23 with one that is 3 % off, 12 to 14 with cameras
that are a frame or two late."""
LOOK_MORE_M2 = 0.003
"""m^2 of bare mask about a joint in a view, mean over the joints, median over the clip, from which on the masks show
more than the body. Bodies alone had 0.0005 to 0.0019, and 0.0026 in bad masks of three views; with a chair, a skirt, a
bag or a backpack there were 0.0034 to 0.009, in a coat 0.0024 to 0.008 (the same scenes)."""


def against_the_clip(audit: ArrayLike, n_views: ArrayLike, evidence: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Sentences on why the clip is not to be trusted, and on why it is worth a look; audit (T, J, A), n_views (T,).
    Nothing with key points, which say where limbs are, and which view is wrong, whatever masks show."""
    wrong, look = list[str](), list[str]()
    if evidence != "silhouettes":
        return (), ()
    beyond = beyond_usual(audit, evidence)
    if beyond > LOOK_APART_M:
        said = (
            f"the views contradict each other by {1e3 * beyond:.0f} mm from beginning to end, so the calibration, the "
            "synchronisation or the body is wrong: run hypose check"
        )
        (wrong if beyond > WRONG_APART_M else look).append(said)
    if more_than_body(audit, n_views) > LOOK_MORE_M2:
        look.append(
            "the masks show more than the body from beginning to end (a chair, wide clothes, a bag, somebody else?), "
            "and limbs may have been put there: compare the overlay with the images"
        )
    if len(look) > 1:  # things in the masks do not set views apart; late or wrong cameras do both (seeds 600 to 617)
        wrong, look = look, []
    return tuple(wrong), tuple(look)
