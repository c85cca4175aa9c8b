"""What the doctor is told of a view's file, what counts as a fault, and a fault."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Clip:
    """What one view's file says: size (w, h) px of the stored images, frames/s, number of frames; None = unknown.
    accepted: the user has said that the images were only stretched (accept_scaled)."""

    size: tuple[int, int] | None = None
    frame_rate: float | None = None
    frames: int | None = None
    accepted: bool = False


@dataclass(frozen=True)
class Limits:
    """What counts as a fault. Shares are of the person's size in the image (its longer side).

    gross: disagreement of a view with the others above which gross faults are tried, gross_lens: the same for lens
    conventions, gross_cured: what must be left of it at most. largest_lag: frames; late: frames, late_sd: in sd,
    late_gain: half log likelihood. keypoint_lag_sd, own_lag_sd: of all and of one view's key points against the masks,
    in sd. shift: share, shift_sd: in sd, shift_spread: in the spread of the other views' shifts,
    shift_px: least, px of the masks. extrinsics: share of the residual that may be left after refinement, scatter:
    share of the person's size of which no more is left when cameras were only off and are refined (detectors reach 0.01
    to 0.02), moved: share by which a camera's image of the person moves, gain:
    least fall of the residual. lens_z: sd of a radial term, lens_gain: share of the residual that may be left after
    freeing it, lens_px: its effect on the person. heights: of a person, m, usual_heights: of nearly all;
    height_share: against the known height, height_doubt: worth a look;
    tangency: disagreement of the silhouettes' tangent planes."""

    gross: float = 0.03
    gross_lens: float = 0.012
    gross_cured: float = 0.45
    largest_lag: float = 12.0
    late: float = 0.4
    late_sd: float = 4.0
    late_gain: float = 12.0
    keypoint_lag_sd: float = 4.0
    own_lag_sd: float = 8.0
    shift: float = 0.006
    shift_sd: float = 3.3
    shift_spread: float = 2.3
    shift_px: float = 1.25
    extrinsics: float = 0.85
    scatter: float = 0.035
    moved: float = 0.012
    gain: float = 0.001
    lens_z: float = 4.8
    lens_gain: float = 0.97
    lens_px: float = 0.006
    heights: tuple[float, float] = (1.0, 2.3)
    usual_heights: tuple[float, float] = (1.4, 2.0)
    height_share: float = 0.12
    height_doubt: float = 0.07
    tangency: float = 0.02


@dataclass(frozen=True)
class Finding:
    """One fault. kind: one word; views: the cameras' names, () = all; text: what and the evidence; cure: the next step;
    size: how large it is in its own unit; fault: False for what only has to be known."""

    kind: str
    views: tuple[str, ...]
    text: str
    cure: str
    size: float
    fault: bool = True

    @property
    def sentence(self) -> str:
        """What is wrong and what to do."""
        return f"{self.text}. Next: {self.cure}."
