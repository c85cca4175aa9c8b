"""What speaks against a clip as a whole: views that contradict each other, masks that show more than the body.

No frame of such a clip stands out from the others, and no single joint: a wrong calibration, a camera that lags, a
chair in the masks are there from the first frame to the last.
"""

from __future__ import annotations

from numpy.typing import ArrayLike

from hypose.pipeline.settings import SETTINGS
from hypose.tracking.audit import more_than_body
from hypose.tracking.fitted_spread import beyond_usual


def against_the_clip(audit: ArrayLike, n_views: ArrayLike, evidence: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Sentences on why the clip is not to be trusted, and on why it is worth a look; audit (T, J, A), n_views (T,).
    Nothing with key points, which say where limbs are, and which view is wrong, whatever masks show."""
    wrong, look = list[str](), list[str]()
    if evidence != "silhouettes":
        return (), ()
    beyond = beyond_usual(audit, evidence)
    if beyond > SETTINGS.contradiction_look_apart_m:
        said = (
            f"the views contradict each other by {1e3 * beyond:.0f} mm from beginning to end, so the calibration, the "
            "synchronisation or the body is wrong: run hypose check"
        )
        (wrong if beyond > SETTINGS.contradiction_wrong_apart_m else look).append(said)
    if more_than_body(audit, n_views) > SETTINGS.contradiction_look_more_m2:
        look.append(
            "the masks show more than the body from beginning to end (a chair, wide clothes, a bag, somebody else?), "
            "and limbs may have been put there: compare the overlay with the images"
        )
    if len(look) > 1:  # things in the masks do not set views apart; late or wrong cameras do both (seeds 600 to 617)
        wrong, look = look, []
    return tuple(wrong), tuple(look)
