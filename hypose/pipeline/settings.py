"""Constants of hypose.pipeline that were chosen, not derived."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PipelineSettings:
    """All constants of hypose.pipeline; the first word of a name says which module uses it.

    again_least_won: Least sum over frames of the IoU won by the backward track to replace the start. Where nothing was
        wrong it won up to .21 (seeds 432, 440 and 441), where legs were exchanged .80 (432).
    compare_levels: Probabilities of the regions whose coverage is compared.
    compare_most_lag: Largest time offset that is searched, s.
    compare_longest_gap: Longest gap over which the other motion is interpolated, s.
    compare_least_joints, compare_least_frames: Least joints and frames to judge whether it is the same movement.
    compare_alike, compare_apart_m: Share of the relative motion of joints that the other motion must explain, and the
        difference (m) that is accepted in any case. Other movements explain 0.06 at most and leave 0.1 m or more; the
        same one with 40 mm of noise per axis explains 0.76 or more, or, where the person hardly moves, leaves 0.05 m
        (walking, boxing, waving, sitting down, serving; simulated, seed 5).
    compare_wrong_units: Factors by which a wrong unit makes lengths too long.
    compare_alike_lengths: Largest logarithm of a ratio of lengths (1.3) that people and definitions of joints explain.
    compare_sentinel_frames, compare_sentinel_share: A position that repeats in more than so many frames, and in this
        share of them, marks a missing joint.
    contradiction_apart_m: Unusual contradictions between the views from which a clip is to be reviewed, and not to be
        trusted, m. On scenes (seeds 600 to 607) it was less than 5.5 mm with right
        cameras, also with objects in the masks; 9 to 16 mm with a calibration 1 % off, which costs 20 mm; 17 to 23 with
        one 3 % off; 12 to 14 with cameras a frame or two late.
    contradiction_look_more_m2: Bare mask area about a joint in a view, mean over the joints, median over the clip, from
        which the masks show more than the body, m^2. Bodies alone had 0.0005 to 0.0019, and 0.0026 in bad masks of
        three views; with a chair, a skirt, a bag or a backpack 0.0034 to 0.009, in a coat 0.0024 to 0.008 (the same
        scenes).
    anomaly_jump, anomaly_least_jump, anomaly_sudden: A mask jumps where it changes by more than anomaly_jump times the
        usual within a second, by at least anomaly_least_jump more than the usual, and by anomaly_sudden times the
        change in the frame before.
    anomaly_worse, anomaly_spread: A view disagrees where its overlap, over half a second, is below its usual one by
        anomaly_worse and by anomaly_spread times the usual spread, and that of the other views is not half as far below
        theirs. Chosen on clean walks (seeds 0 and 3).
    anomaly_stranger: Mask part apart from the body, as a share of the body's area, that counts as another person where
        it is in two views and in half of all. Chosen, like anomaly_less, on walks with and without another person
        (seeds 10 to 13).
    anomaly_less: Decrease of the mean overlap, compared with before a disturbance, from which tracking counts as not
        recovered.
    anomaly_still: Usual change of a mask (share of its area) below which unchanged masks are no repeats: the person
        stands still.
    anomaly_still_points, anomaly_few_points: The same for key points, as a share of the person's size, above the
        rounding of detectors; views with fewer points do not count.
    anomaly_shown: Share of a person that others must leave visible in a view for its overlap to be compared with that
        of other views. Chosen on people in the same masks (seed 430).
    anomaly_after_s: Marked frames nearer to each other than this are joined, s.
    examine_around: Margin around the key points, as a share of the person's size, in which a mask belongs to the person
        where others are there.
    examine_used: Frames that a refinement uses; the rest judges it.
    first_as_many, first_as_well: Share of the most points of a frame from which a start is as good, and tolerated
        decrease of the share of detections that agree: one limb of one view is 3 of 100.
    look_frames: Frames that are checked first, spread over the clip.
    look_scatter: Median disagreement of the views' key points, as a share of the person's size, that is accepted.
        Detectors reach 0.01 to 0.02; with another camera's calibration it is 0.1 and more.
    look_late_s: Time by which views may differ before the result is not to be trusted, s. A person who walks is 10 cm
        further by then.
    look_outvote: Views without a time difference from which the result is trusted although another view is late.
    look_in_step: Frames in the middle of the clip used to check the views' times: .2 s of work.
    look_most_parallel: Share of the key points that may have parallel rays only.
    gait_correlation: Time over which errors of a smoothed motion are correlated, s.
    gait_heel_sd: Additional standard deviation of a heel relative to its ankle, per axis, m: size and rotation of the
        foot. Chosen so that nine in ten step lengths lie in their 90 % intervals, on a captured walk on the bodies of
        the seeds 10 to 19.
    gait_least_swing: Least swing of a foot along the facing direction in a step, m.
    gait_least_seen: Least part of a swing that must be seen where the clip begins or ends in it, m.
    gait_between_frames: Error of the parabola between frames, in frames.
    gait_least_step: Least time between two strikes of a foot, s.
    gait_facing: Time over which the facing direction is averaged, s.
    gait_stride_s: Limits of the duration of a stride, s.
    gesture_waiting: Most pictures of a session that wait to be written.
    gesture_telling: Number of first pictures that identify a session.
    path_surprise: Deviation of a person from the predicted motion, m/s.
    path_slack: Additional jump of the axis of a hull, m.
    path_others_widened: Widening of another person's hull or rough body, as a share of its longer side.
    path_core_m: Radius about the axis within which another person's hull hides a person, m. The rest may be the
        person's own.
    path_gone_s: Time without a hull after which a path ends, s.
    path_part: Share of the other hulls' volume below which a hull is only a part of a person.
    placing_looked_at: Frames from which sensors are registered; the person should have walked and turned by then.
    placing_calm: First maps whose median is used to find the floor.
    placing_height_m: Plausible range of the height of a depth camera above the floor, m; other heights mean
        another unit.
    placing_near: Time by which a map may be off its instant, as a share of a frame.
    placing_least_share: Share of a picture below which nothing is a person.
    placing_frames: Different poses that are solved together.
    background_largest_lag_s: Largest delay of one camera relative to another, s.
    background_sure, background_gain: Largest standard deviation (frames) of an offset that is used, and least gain of
        half a log-likelihood compared with no offsets.
    engine_most_people: Most people that can be tracked at once: no computer keeps pace with more.
    engine_history: Mask areas that define the usual area, one every fifth instant.
    engine_latencies: Instants whose latencies are kept.
    engine_misses: Shares of lost pictures of a camera that are reported, in steps.
    capture_empty_s, capture_empty_pictures: Time (s) and pictures from which the empty room is learned.
    capture_other_shape: Relative difference of a picture's aspect ratio from the calibration's that is accepted.
    capture_quality: JPEG quality of the pictures that are passed on.
    capture_look_s: Time after which a thread that waits for the other process checks whether to continue, s.
    capture_closing_s: Time in which the other process may close its cameras, s.
    feeds_kept: Pictures of each camera that are kept, in addition to those that other cameras have not reached yet.
    feeds_pace, feeds_known: Pictures from which the rate is estimated, and least number of them.
    feeds_recent: Pictures from which the share of lost ones is computed.
    feeds_nonsense: Excess of pictures with impossible times after which a camera's own times are ignored.
    feeds_again_s, feeds_longest_s: Time after which a lost camera is opened again, at first and at most, s.
    feeds_slack_s: Delay of a picture relative to the rate of its camera for which others wait, s.
    feeds_gone_s, feeds_gone_periods: Time (s), and frame periods, without a picture after which a camera is absent.
    feeds_new: Least time from one instant to the next, as a share of a period.
    feeds_candidates: Newest complete instants that are examined.
    feeds_same: Largest time between a picture and the instant that it shows, as a share of a period.
    live_fitted_s: Motion that a body is fitted to, s.
    live_sync_s: Motion from which the cameras' offsets are estimated, s.
    live_pace, live_other: Weight of a step in the running mean of the step time; ratio to the tracker's rate from which
        the tracker is changed.
    live_duel, live_won, live_give_up, live_shared: Duel with exchanged sides: most instants; sum over them of IoU that
        must be won; that may be lost again, alone and in shared masks.
    live_challenge_s: Time from the first duel in shared masks, where starts are turned more often, to the next, s;
        doubled each time.
    live_ease_s: Time constant of the transition from one body to another, s.
    live_window_s, live_every_s, live_audit_hz: Time (s) that a frame is judged with; time (s) between two judgements;
        rate of audited frames. `hypose track` also uses later frames; live tracking cannot.
    live_rig_usual_rate: Rate of cameras that do not report one, Hz.
    search_gap_s: Time without pictures after which the motion before is not continued, s.
    search_decide, search_longest: Instants that decide on a start; most instants that are kept during a search.
    search_least_area: Least share of a picture that a person takes.
    search_seldom_s: Longest time after which another person is searched again, s.
    processes_switch_s: Longest wait of a thread that takes or sends pictures for one that computes, s. Python's own 5
        ms are a large share of a frame's time.
    recorder_waiting: Most instants that wait to be written; more are left out and counted.
    recorder_describe_s: Time after which the recording's description is updated, s.
    scene_light_s, scene_thing_s: Time constants of learning, s: where the picture resembles the room, and where it is
        neither the room nor the person.
    scene_sparse: Distance of the pixels from which the change of brightness is estimated, px.
    scene_margin: Margin about the person in which nothing is learned, as a share of the person's height in the picture.
    scene_moved_m, scene_moved_grey, scene_moved_share: Change (m, grey levels) and share of pixels with it that mean
        that a person did not leave.
    sides_give_up: Sum over frames of 1 - IoU above its best at which tracking again stops. Frame counts of sides_* hold
        at up to 25 frames/s; at more they grow with the frame rate.
    sides_least: Least sum over frames of IoU to be won: a turned body costs 0.05 to 0.1 in each.
    sides_undecided: Frames after the best at which tracking again stops too.
    sides_found_by, sides_least_back: Frame from which the first ones are tracked backwards, and least sum over frames
        of IoU to be won.
    sides_met_m, sides_met_frames: Both tracks are one where their joints are nearer than this (m) for so many frames.
    sides_elsewhere_m: Mean distance of joints from which the old body counts as lost, m.
    sides_block: Frames read at once to go backwards: videos are read forwards.
    mesh_statures: Plausible heights of a person, arms raised included, m.
    mesh_fine_vertices: A mesh with more vertices is reduced for display, to half as many.
    mesh_samples: Points of the surface to which the template is fitted.
    mesh_coarse: Vertices of the mesh for scoring.
    mesh_most_far: Share of samples farther than 5 % of the stature from the template above which the mesh is no person
        in a known pose: 0.000 for 30 scans of ten people in three poses, 0.07 and more for people squeezed to half
        their width and less.
    masks_apart: How many times as large as usual a camera's share of missed area must be for its masks to be left out.
        A network's masks from the ceiling (cross_arms,
        seeds 7504 to 7534) had 1.7 to 3.2 times, other cameras up to 1.4 times.
    moved_off_degrees, moved_off_m: Rotation (degrees) and displacement at the person (m) from which a sensor counts as
        moved. The rotation about a person who does not turn is hardly visible (2.4 degrees with right cameras, in 1 s),
        and matters as little.
    moved_frames, moved_least_s: Poses from which places are solved; least time of an interval with constant places, s.
    moved_rough: Poses and steps of a rough check before all is solved. With the right places, which are usual, this
        costs a fifth.
    newcomer_left_share: Share of a tracked person's box that must be unexplained in the necessary views before the hull
        is searched.
    newcomer_higher_m: Limits of the height by which the hull of a person who returns may be lower (bent) or higher
        (arms up) than the body, m.
    newcomer_one_place_m: Two bodies whose roots are nearer are one person, m.
    newcomer_nothing: Mean IoU below which a body explains nothing: a double had .01 (seed 450), people .78 and more
        (431, 441 to 444).
    newcomer_walking: Speed with which a person who returns may have moved since leaving, m/s.
    newcomer_drawn_s: Time within which a new person is found by the next looks, s.
    picture_target_px: Size of the person in the pictures that are used, px: larger ones cost time, smaller ones limbs.
    picture_smallest_side: Smallest longer side of these pictures, px.
    picture_smallest_mask: A mask of fewer pixels shows no person.
    picture_ahead_bytes: Memory for pictures that are read forwards and kept, so that no video is decoded backwards.
    picture_click_share: Standard deviation of a click, as a share of the person's size in the picture.
    picture_length_frames: Additional frames with key points from which the lengths of an unknown body are estimated.
    picture_far, picture_outside: Distance, as a share of the person's size, from which a key point counts as off the
        body, and a joint as outside the mask. Detectors put necks and hips up to 0.07 from the body's.
    picture_deviation, picture_deviation_frame: Share of key points or joints that are off from which a motion is not to
        be trusted, and a frame is doubtful. Motions that lay on the person had 0.00 to 0.04, and 0.18 at most in a
        frame (four real cameras, four simulated); those with limbs elsewhere, or key points half a second late, 0.30 to
        0.65 (simulated).
    several_large: Share of the largest part's area from which a mask part of at least half of its height counts as a
        person: one who is nearly twice as far away.
    several_now_and_then: Share of the frames in which a view must show several people where other evidence shows them
        too.
    several_looks: Frames that are checked for several people.
    points_least_share: Least share of the frames in which a person's key points must be tracked for a result.
    people_near_m: Distance up to which key points, a hull or a body may belong to a person, m.
    people_start_s: Time at the beginning in which the first people are searched; longest time before the first frame at
        which a place still identifies a person, s.
    people_look_s: Time between two looks for a new person, who must be seen in two, s.
    people_fit_s, people_fit_hz: Time (s) and rate (Hz) of the frames from which a body is fitted, and live a start
        is searched.
    people_fewest: Least frames in which a new person must be found to be fitted.
    people_gone_s: Time without evidence after which a person has left, s.
    people_together_s: Two bodies that stay in one place for so long are one person, s.
    rough_hidden: Visible share of a body above which a view shows the person.
    rough_frames: Least frames from which a body is fitted, if there are so many, and most that decide on the rough
        start.
    rough_lost: 1 - IoU from which a rough body counts as not found.
    sensor_apart_m: Median distances between the joints of two sensors from which a result is to be reviewed, and not to
        be trusted, m: 14 to 67 mm on 39 recordings of two real sensors; with one of them 15 % too
        large 113, a second late 122, with left and right exchanged in every frame 240.
    sensor_late_s, sensor_like: Difference of a sensor's clock (s), and correlation of both movements, from which it is
        reported: 0.12 s at most on the recordings above.
    sensor_nearer: Largest share of the distance between two sensors' joints that may remain when a clock is corrected.
        Why: a person who walks moves alike half a step later, with arms or sides exchanged.
    sensor_legs_m: Plausible length of thigh and shank together, m, of people 0.9 to 2.3 m tall: sensors report 0.64 to
        0.86 of adults.
    sensor_of_height: Thigh and shank as sensors see them, as a share of the height.
    choice_plain, choice_sure: Mean IoU and weight from which a start needs no other frame.
    choice_clearly: Mean IoU by which another frame's start must be better, where no other person hides anything.
    choice_later: Frames after a start that decide between its rivals; near enough that a person who walks is not lost.
    choice_likely: Least weight of a start that is tracked through the other frames.
    choice_enough, choice_hopeless: After so many frames, additional mean cost at which a trial is stopped.
    choice_particles, choice_never_s: Particles of a short trial; time between two comparisons with rivals: never.
    stranger_looked_at: Longer side of the reduced masks in which parts are found, px; a limb stays two or three pixels
        wide.
    stranger_along: Positions along a bone that mark the body, as shares of its length.
    check_extent_m: Plausible range of the extent of people's silhouettes, m; arms raised and lying down included.
    check_least_overlap: Least mean IoU of the best start; in the right pose the template has 0.6 (heavy people) to
        0.85.
    check_worse_pose: Decrease of IoU that a named pose may have compared with another; arms are corrected from up to 45
        degrees away.
    again_poses: Poses to which a body is fitted again. With 8 and 20 the lengths of arms and legs were as far off
        (seeds 440 and 441), but with 8 people who cross were lost (golden clip: 41 mm, with 12 13 mm).
    subject_poses, subject_looked_at: Poses to which outlines are fitted, and frames among which they are chosen.
    subject_particles: Particles with which these frames are tracked.
    subject_the_person: Mean IoU of the template's girths up to which masks do not belong to the person of the key
        points.
    subject_bones, subject_sure_bones: Relative standard deviation of bones around those of the key points, per squared
        error of the key points (1/m^2), their median distance from the fitted body and their constant error, since both
        make lengths uncertain in this proportion; and its limits. Chosen on bodies from plain, detector-like and
        thinned out key points (combo, seeds 1248 to 1253).
    subject_height_off: Relative differences between the height that masks or depth show and the given one from which a
        motion is to be reviewed, and not to be trusted.
    subject_sure, subject_no_worse: Largest standard deviation of the height's logarithm with which it is used, and
        largest share of the mismatch that may remain. Four people (seeds 50 to 53) with the right height given came out
        within 0.5 %; with one 13 % too small, 5 to 9 % below their own height at worst (poses were fitted to the wrong
        body), 8 to 15 % above the given one.
    tracked_placed_m: Largest distance of a wanted person from the given place, m.
    verdict_wrong_share: Mean error probability over joints and frames from which the motion is not to be trusted.
    verdict_limb_p: Least mean error probability, in its doubtful frames, of a joint that is doubtful in more than half
        of all frames, from which the motion is not to be trusted: a user cannot judge the rest. Joints are doubtful
        long before they are likely wrong. On scenes (seeds 600 to 617) joints doubtful in half of the frames had .14 to
        .31 where the clip was never wrong, .19 to .40 where it was for some frames, and .28 to .91 where a limb was
        wrong all along. Where something else makes the whole clip doubtful, half of the frames are enough: that is so
        in no usual clip of these seeds, and in three others, whose joints are off by 34 to 70 mm.
    trace_least_m: Smaller displacements of joints by a pass are not recorded, m.
    verdict_lost_share: Share of the frames without the person from which the motion is not to be trusted.
    verdict_few_s: Doubtful frames shorter than this are named but need no review, s.
    wardrobe_near_m: Distance between two people within which they may be confused, and their clothes are not learned,
        m.
    wardrobe_looks: Looks at a person apart from others before the identity is decided.
    wardrobe_unlike, wardrobe_clearly: Likeness of clothes below which it is another person; increase of likeness from
        which two were exchanged. On walks past each other (seeds 20 to 23) the same person had 0.98 and more, two
        people 0.5 and less.
    """

    again_least_won: float = 0.3
    compare_levels: tuple[float, float, float] = (0.5, 0.9, 0.95)
    compare_most_lag: float = 5.0
    compare_longest_gap: float = 0.1
    compare_least_joints: int = 4
    compare_least_frames: int = 8
    compare_alike: float = 0.2
    compare_apart_m: float = 0.08
    compare_wrong_units: tuple[float, ...] = (1000.0, 100.0, 39.37, 25.4, 10.0, 1.0, 0.01, 0.001)
    compare_alike_lengths: float = 0.26
    compare_sentinel_frames: int = 5
    compare_sentinel_share: float = 0.05
    contradiction_apart_m: tuple[float, float] = (0.006, 0.015)
    contradiction_look_more_m2: float = 0.003
    anomaly_jump: float = 1.8
    anomaly_least_jump: float = 0.12
    anomaly_sudden: float = 1.3
    anomaly_worse: float = 0.15
    anomaly_spread: float = 4.0
    anomaly_stranger: float = 0.15
    anomaly_less: float = 0.06
    anomaly_still: float = 0.02
    anomaly_still_points: float = 0.0005
    anomaly_few_points: int = 6
    anomaly_shown: float = 0.75
    anomaly_after_s: float = 0.4
    examine_around: float = 0.3
    examine_used: int = 17
    first_as_many: float = 0.8
    first_as_well: float = 0.03
    look_frames: int = 12
    look_scatter: float = 0.035
    look_late_s: float = 0.08
    look_outvote: int = 3
    look_in_step: int = 240
    look_most_parallel: float = 1 / 3
    gait_correlation: float = 0.15
    gait_heel_sd: float = 0.006
    gait_least_swing: float = 0.12
    gait_least_seen: float = 0.03
    gait_between_frames: float = 0.05
    gait_least_step: float = 0.25
    gait_facing: float = 0.4
    gait_stride_s: tuple[float, float] = (0.6, 2.5)
    gesture_waiting: int = 4
    gesture_telling: int = 10
    path_surprise: float = 1.0
    path_slack: float = 0.25
    path_others_widened: float = 0.02
    path_core_m: float = 0.3
    path_gone_s: float = 0.8
    path_part: float = 0.4
    placing_looked_at: int = 400
    placing_calm: int = 9
    placing_height_m: tuple[float, float] = (0.05, 4.0)
    placing_near: float = 0.6
    placing_least_share: float = 0.003
    placing_frames: int = 24
    background_largest_lag_s: float = 0.4
    background_sure: float = 0.2
    background_gain: float = 6.0
    engine_most_people: int = 8
    engine_history: int = 11
    engine_latencies: int = 1800
    engine_misses: tuple[float, float, float, float] = (0.05, 0.1, 0.2, 0.5)
    capture_empty_s: float = 2.0
    capture_empty_pictures: int = 12
    capture_other_shape: float = 0.01
    capture_quality: int = 85
    capture_look_s: float = 0.2
    capture_closing_s: float = 5.0
    feeds_kept: int = 12
    feeds_pace: int = 31
    feeds_known: int = 4
    feeds_recent: int = 300
    feeds_nonsense: int = 45
    feeds_again_s: float = 0.2
    feeds_longest_s: float = 2.0
    feeds_slack_s: float = 0.015
    feeds_gone_s: float = 0.5
    feeds_gone_periods: float = 6.0
    feeds_new: float = 0.6
    feeds_candidates: int = 8
    feeds_same: float = 0.55
    live_fitted_s: float = 3.6
    live_sync_s: float = 8.0
    live_pace: float = 0.1
    live_other: float = 1.3
    live_duel: int = 25
    live_won: float = 0.1
    live_give_up: float = 0.15
    live_shared: float = 0.4
    live_challenge_s: float = 2.5
    live_ease_s: float = 0.3
    live_window_s: float = 1.5
    live_every_s: float = 0.2
    live_audit_hz: float = 10.0
    live_rig_usual_rate: float = 30.0
    search_gap_s: float = 1.0
    search_decide: int = 6
    search_longest: int = 250
    search_least_area: float = 0.002
    search_seldom_s: float = 60.0
    processes_switch_s: float = 0.0005
    recorder_waiting: int = 90
    recorder_describe_s: float = 5.0
    scene_light_s: float = 10.0
    scene_thing_s: float = 30.0
    scene_sparse: int = 3
    scene_margin: float = 0.15
    scene_moved_m: float = 0.05
    scene_moved_grey: float = 12.0
    scene_moved_share: float = 0.01
    sides_give_up: float = 0.3
    sides_least: float = 0.15
    sides_undecided: int = 50
    sides_found_by: int = 25
    sides_least_back: float = 0.05
    sides_met_m: float = 0.02
    sides_met_frames: int = 8
    sides_elsewhere_m: float = 0.15
    sides_block: int = 25
    mesh_statures: tuple[float, float] = (0.6, 2.4)
    mesh_fine_vertices: int = 8000
    mesh_samples: int = 2500
    mesh_coarse: int = 550
    mesh_most_far: float = 0.04
    masks_apart: float = 2.0
    moved_off_degrees: float = 4.0
    moved_off_m: float = 0.025
    moved_frames: int = 12
    moved_least_s: float = 0.6
    moved_rough: tuple[int, int] = (6, 3)
    newcomer_left_share: float = 0.1
    newcomer_higher_m: tuple[float, float] = (-0.35, 0.5)
    newcomer_one_place_m: float = 0.2
    newcomer_nothing: float = 0.2
    newcomer_walking: float = 3.0
    newcomer_drawn_s: float = 0.4
    picture_target_px: float = 250.0
    picture_smallest_side: int = 320
    picture_smallest_mask: int = 50
    picture_ahead_bytes: int = 250_000_000
    picture_click_share: float = 0.010
    picture_length_frames: int = 10
    picture_far: float = 0.12
    picture_outside: float = 0.04
    picture_deviation: float = 0.15
    picture_deviation_frame: float = 0.2
    several_large: float = 0.3
    several_now_and_then: float = 0.25
    several_looks: int = 7
    points_least_share: float = 0.1
    people_near_m: float = 0.6
    people_start_s: float = 0.5
    people_look_s: float = 0.12
    people_fit_s: float = 3.0
    people_fit_hz: float = 12.5
    people_fewest: int = 6
    people_gone_s: float = 0.4
    people_together_s: float = 0.3
    rough_hidden: float = 0.5
    rough_frames: int = 16
    rough_lost: float = 0.6
    sensor_apart_m: tuple[float, float] = (0.085, 0.15)
    sensor_late_s: float = 0.2
    sensor_like: float = 0.85
    sensor_nearer: float = 0.8
    sensor_legs_m: tuple[float, float] = 0.39, 0.99
    sensor_of_height: float = 0.43
    choice_plain: float = 0.6
    choice_sure: float = 0.9
    choice_clearly: float = 0.02
    choice_later: tuple[int, ...] = (1, 2, 3, 4, 5)
    choice_likely: float = 0.05
    choice_enough: int = 6
    choice_hopeless: float = 0.04
    choice_particles: int = 32
    choice_never_s: float = 1e6
    stranger_looked_at: int = 160
    stranger_along: tuple[float, float, float] = (0.25, 0.5, 0.75)
    check_extent_m: tuple[float, float] = (0.4, 3.2)
    check_least_overlap: float = 0.4
    check_worse_pose: float = 0.05
    again_poses: int = 12
    subject_poses: int = 8
    subject_particles: int = 48
    subject_looked_at: int = 24
    subject_the_person: float = 0.3
    subject_bones: float = 50.0
    subject_sure_bones: tuple[float, float] = (0.005, 0.05)
    subject_height_off: tuple[float, float] = (0.07, 0.12)
    subject_sure: float = 0.03
    subject_no_worse: float = 1.02
    tracked_placed_m: float = 1.0
    verdict_wrong_share: float = 0.12
    verdict_limb_p: float = 0.35
    trace_least_m: float = 0.02
    verdict_lost_share: float = 0.3
    verdict_few_s: float = 0.12
    wardrobe_near_m: float = 0.7
    wardrobe_looks: int = 3
    wardrobe_unlike: float = 0.7
    wardrobe_clearly: float = 0.2


SETTINGS = PipelineSettings()
