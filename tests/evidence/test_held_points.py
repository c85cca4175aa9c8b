"""Key points that were held over gaps are no detections; those of somebody who hardly moves are."""

import numpy as np

from hypose.evidence.one_person import without_held


def moving(rng, frames=20, people=1, points=12):
    start = rng.uniform(0, 300, (people, points, 2))
    steps = rng.normal(2.0, 0.5, (frames, people, points, 2)).cumsum(0)
    return [np.concatenate([start + s, np.full((people, points, 1), 0.8), start + s], -1) for s in steps]


def test_a_place_that_is_kept_is_left_out_from_its_second_frame_on(rng):
    column = moving(rng)
    for t in range(8, 13):
        column[t][0, 4, [0, 1, 3, 4]] = column[7][0, 4, [0, 1, 3, 4]]
    out, count = without_held(column)
    assert count == 5
    confidence = np.stack([p[0, :, 2] for p in out])
    assert not confidence[8:13, 4].any()
    assert (np.delete(confidence, 4, 1) == 0.8).all() and confidence[[7, 13], 4].all()
    assert all((p[..., 2] == 0.8).all() for p in column)  # what was given is left as it is


def test_two_frames_alike_and_a_view_that_stands_still_tell_nothing(rng):
    column = moving(rng)
    column[8][0, 4, 3:] = column[7][0, 4, 3:]
    assert without_held(column)[1] == 0
    still = [column[0].copy() for _ in range(20)]
    assert without_held(still)[1] == 0
