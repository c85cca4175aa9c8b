"""Numbers of hypose.pipeline that were chosen, not derived."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PipelineSettings:
    """All of them; the first word of a name says which module uses it.

    again_poses: Poses to which a body is fitted: with 8 and 20 arms and legs were as far off (seeds 440 and 441).
    again_least_won: Sum over frames of IoU that the way back must win for what it says of the start to be taken: where
        nothing was wrong it won up to .21 (seeds 432, 440 and 441), where legs were exchanged .80 (432).
    worth_frames: looked at, spread over the motion
    worth_prior: m: how well a body places a joint that the cameras leave open
    worth_noise: of a picture's longer side
    worth_places: around the person, where one more camera is tried
    compare_levels: of the regions whose coverage is compared
    compare_most_lag: s
    compare_longest_gap: s over which the other motion is interpolated
    compare_least_joints, compare_least_frames: that tell whether it is the same movement
    compare_alike, compare_apart_m: share of how joints move side by side that the other motion must explain, and m that
        may be left all the same: other movements explain 0.06 at most and leave 0.1 m or more; the same one with 40 mm
        of noise per axis explains 0.76 or more, or, where the person hardly moves, leaves 0.05 m (walking, boxing,
        waving, sitting down, serving; simulated, seed 5)
    compare_wrong_units: How often a length is counted too long by a wrong unit.
    compare_alike_lengths: log of the ratio (1.3) by which people and the joints of programs differ
    compare_mirrored: a mirrored world must lower the cost to this share
    compare_sentinel_frames, compare_sentinel_share: positions that come back so often, in frames and as a share, are
        marks of a missing joint
    contradiction_look_apart_m, contradiction_wrong_apart_m: m by which views contradict each other beyond the usual,
        from which on a clip is worth a look, and not to be trusted. On scenes (seeds 600 to 607) it was less than 5.5
        mm through the right cameras, with things in the masks as well, 9 to 16 mm with a calibration that is 1 % off,
        which costs 20 mm, 17 to 23 with one that is 3 % off, 12 to 14 with cameras that are a frame or two late.
    contradiction_look_more_m2: m^2 of bare mask about a joint in a view, mean over the joints, median over the clip,
        from which on the masks show more than the body. Bodies alone had 0.0005 to 0.0019, and 0.0026 in bad masks of
        three views; with a chair, a skirt, a bag or a backpack there were 0.0034 to 0.009, in a coat 0.0024 to 0.008
        (the same scenes).
    doubts_jump, doubts_least_jump, doubts_sudden: A mask jumps when it changes by more than this many times the usual
        within a second, by this much more, and by this many times what it changed in the frame before.
    doubts_worse, doubts_spread: A view disagrees when its overlap, over half a second, lies this far below its usual
        one, and so many times its usual spread, and that of the other views is not half as far below theirs. Chosen on
        clean walks (seeds 0 and 3).
    doubts_stranger: A person else is there when a part of so much of the body's area lies apart from it in two views,
        and in half of them. Chosen, as doubts_less, on walks with and without another person (seeds 10 to 13).
    doubts_less: After something doubtful tracking is not back while the mean overlap lies so far below that before it.
    doubts_still: share of a mask's area: what changes less from frame to frame shows the same picture again
    doubts_still_points, doubts_few_points: Share of the person's size that key points move from frame to frame, beyond
        a detector's own digits; fewer points of a view tell nothing.
    doubts_shown: Share of a person that others must leave visible in a view whose overlap is compared with that of the
        other views. Chosen on people in the same masks (seed 430).
    doubts_after_s: s: doubtful stretches that are nearer to each other are one
    examine_looks: frames whose depth maps are looked at
    examine_around: of the person's size, around the key points, in which a mask is the person's when others are there
    examine_used: frames that a refinement looks at, as the rest has to judge it
    first_tracked: instants from which a body is fitted
    first_as_many, first_as_well: Share of the most points of a frame from which on a start is as good, and by how much
        fewer of its detections may agree: one limb of one view is 3 of 100.
    look_frames: frames, evenly over the clip, that are looked at first
    look_scatter: Share of the person's size by which the views' key points may disagree (median); detectors reach 0.01
        to 0.02, with another camera's calibration 0.1 and more.
    look_late_s: s by which views' key points may be out of step before the result is not to be trusted: a person who
        walks is 10 cm further by then
    look_outvote: views in step that show where the person is whatever another one says
    look_in_step: frames, those in the middle, by which it is checked whether views are in step: .2 s of work
    look_most_parallel: Share of the key points up to which all rays may be parallel.
    gait_correlation: s over which a smoothed motion errs alike.
    gait_heel_sd: m by which a heel is known less well than its ankle, per axis: the size of the foot and its turn.
        Chosen so that nine in ten step lengths lie in their 90 % intervals, on a captured walk on the bodies of the
        seeds 10 to 19.
    gait_least_swing: m that a foot goes to and fro along the facing direction in a step
    gait_least_seen: m of that which must be seen where the clip begins or ends meanwhile
    gait_between_frames: of a frame: what the parabola through the frames misses
    gait_least_step: s between two strikes of a foot
    gait_facing: s over which the facing direction is averaged
    gait_shortest, gait_longest: s of a stride
    gesture_max_frames: frames of a session that are read at most
    gesture_max_gestures: gestures of a session at most
    gesture_waiting: pictures of a session that may wait to be written
    gesture_telling: pictures by which a session is known
    path_surprise: m/s: by which a person moves otherwise than expected.
    path_slack: m: by which the axis of a hull may jump in addition.
    path_seen_share: Share of the looks in which a person must be found to be there: of two whose arms touch, the hull
        keeps one apart in every other look.
    path_others_widened: share of its longer side by which another's hull or rough body is widened
    path_core_m: m about their axis: what of another's hull hides a person. The rest may be the person's own.
    path_gone_s: s without a hull after which a path has ended
    path_part: share of the litres of the other hulls below which a hull is a part of a person
    path_clearly_m: m: people who stand nearer to each other are not counted as several unless several are asked for.
    placing_looked_at: frames from which places are found; the person should have walked and turned by then
    placing_calm: maps at the beginning whose median is looked at
    placing_lowest_m, placing_highest_m: m: no depth camera that sees a person hangs lower or higher above the floor:
        other distances are another unit
    placing_near: share of a frame's time by which a map may have been seen before or after its instant
    placing_least_share: of a picture: all that is smaller is no person
    placing_frames: different poses that are solved for together
    placing_rounds: solves for all places and poses together
    background_largest_lag_s: s by which a camera's pictures may come later than another's
    background_sure, background_gain: Frames: sd of an offset that is believed; half a log likelihood by which the
        offsets must be better than none
    background_scale_px: px: usual error of an outline when offsets are found
    engine_most_people: who can be followed at once: no computer keeps pace with more
    engine_history: areas that say which area is usual, one every fifth instant
    engine_latencies: instants whose latencies are kept
    engine_searches: searches and duels at one time
    engine_misses: shares of its pictures that a camera loses, from the one on that is worth a word
    eyes_room_s, eyes_room_pictures: s and pictures from which the empty room is learnt
    eyes_other_shape: share by which width over height may differ from the calibration's
    eyes_damaged: pictures in a row that cannot be read before a word is said
    eyes_quality: of the JPEG pictures that are passed on
    eyes_look_s: s after which a thread that waits for the other process checks whether to go on waiting
    eyes_closing_s: s in which it may let go of its cameras
    feeds_kept: pictures of each camera that are kept, in addition to those that others have not come to yet
    feeds_pace, feeds_known: pictures by which the rate is judged, and from which on it is
    feeds_recent: pictures by which it is judged how many are lost
    feeds_nonsense: pictures with times that cannot be, more than with others, after which a camera's own times are left
        alone
    feeds_again_s, feeds_longest_s: s after which a camera that has gone is asked for again: at first, at most
    feeds_slack_s: s that a picture may come later than the rate of its camera promises; after that it is not waited for
    feeds_gone_s, feeds_gone_periods: s, and frames, without a picture after which a camera is not there
    feeds_new: share of a period by which an instant lies behind the one before
    feeds_candidates: newest instants of which nothing more will come that are looked at
    feeds_same: share of a period within which a picture shows the instant
    live_fitted_s: s of motion that a body is fitted to
    live_sync_s: s of motion that the cameras' offsets are found from
    live_give_up_s: s after which a person who is lost is looked for as at the start
    live_pace, live_other: share of a step by which the usual one follows; by how much it must differ from what the
        tracker expects
    live_duel, live_won, live_give_up, live_shared: Instants of a duel; sum over them of IoU that has to be won; that
        may be lost again, alone and in shared masks
    live_challenge_s: s from the first duel in shared masks, in which starts are turned more often, to the next; then
        twice as long
    live_ease_s: time constant by which a step from one body to another is taken up
    live_window_s, live_every_s, live_audit_hz: s that a frame is judged with, and between two looks at all of them; how
        many frames are audited. `hypose track` also knows what comes after; live tracking does not.
    live_together_m, live_together_s: m, s: two bodies whose roots stay so near to each other for so long are one person
    live_rig_usual_rate: Hz of cameras that do not say
    search_slowly_hz: at which a start is looked for, and a body is fitted
    search_gap_s: s without pictures after which no person goes on as before
    search_decide, search_longest: instants that decide on a start; that are kept while it is looked for
    search_plain: mean IoU from which on a start is believed
    search_least_area: share of a picture that a person takes
    search_stride: m that a person goes between two frames in which they are looked for
    search_again_s, search_seldom_s: s until another person is looked for again where no person was found, doubled each
        time; at most
    processes_switch_s: s that a thread which takes or sends pictures waits at most for one that computes; Python's own
        5 ms are a share of a frame's time
    recorder_waiting: instants that may wait to be written; more are left out, and counted
    recorder_pause_s: s from one instant to the next, at a usual pace: that is a pause, not the pace
    recorder_describe_s: s after which what has been written since is a part of the recording
    rooms_every_s: s between two looks at what has changed
    rooms_light_s, rooms_thing_s: Time constants: of the room where it looks like the room, and of things that are
        neither the room nor the person
    rooms_sparse: px between two that tell how much brighter the light is
    rooms_margin: of the person's height in the picture, about the person, in which nothing is learnt
    rooms_moved_m, rooms_moved_grey, rooms_moved_share: m, grey levels, and share of the pixels, that change where a
        person has not left
    sides_give_up: Sum over frames of 1 - IoU that tracking again may lie above its best before it is broken off. What
        follows counts frames at up to 25 frames/s; at more it grows with the frame rate.
    sides_least: Sum over frames of IoU that has to be won: a turned body costs 0.05 to 0.1 in each.
    sides_undecided: Frames after its best after which it is broken off as well.
    sides_found_by, sides_least_back: Frame from which the first ones are looked at again, and sum over frames of IoU
        that has to be won.
    sides_met_m, sides_met_frames: m, frames: both tracks are one where their joints lie so near for so long.
    sides_elsewhere_m: m: a body whose joints lie so far off in the mean had been lost.
    sides_block: Frames read at once to go backwards: videos are read forwards.
    mesh_statures: Heights (m) that are taken for a person's, arms raised included.
    mesh_fine_vertices: vertices: a mesh with more is decimated for display, to half as many
    mesh_samples: points of the surface that the template is fitted to
    mesh_coarse: vertices of the mesh for scoring
    mesh_most_far: a fit worse than this is no person in a known pose: share of samples farther than 5 % of the stature
        from the template (0.000 for 30 scans of ten people in three poses, 0.07 and more for people squeezed to half
        their width and less)
    moved_off_degrees, moved_off_m: from which on a sensor stands elsewhere than the calibration says, m where the
        person is: how it turns about a person who does not turn hardly shows (2.4 degrees before right cameras, in 1
        s), and matters as little
    moved_frames, moved_least_s: poses that tell where sensors stand; s of a stretch in which they are known to stand
        still, at least
    moved_rough, moved_sure: poses and steps of a rough look, and share of the two above that it must see before all is
        looked at: sensors that stand where they should, as nearly always, cost a fifth so
    newcomer_left_share: Share of a tracked person's box that must be unexplained in the views that a person needs to be
        worth a look at the hull.
    newcomer_shorter_m, newcomer_taller_m: m: by how much the hull of one who returns may be lower (bent) or higher
        (arms up) than their body is tall.
    newcomer_one_place_m: m: two bodies whose roots are so near to each other are one person
    newcomer_nothing: Mean IoU below which a body explains nothing: a double had .01 (seed 450), people .78 and more
        (431, 441 to 444)
    newcomer_walking, newcomer_reach: m/s, and m: how fast, and how much further, a person who returns may have come
        from where they left.
    newcomer_drawn_s: s: a person who comes is found within that, by the next looks
    picture_target_px: The person's size in the pictures that are worked on: larger ones cost time, smaller ones limbs.
    picture_smallest_side: px: pictures are not made smaller than that
    picture_ahead_bytes: Of pictures that are read forwards and kept, so that no video is decoded backwards.
    picture_click_share: 1 sd of a click, as a share of the person's size in the picture.
    picture_length_frames: So many further frames with key points decide the lengths of a person whose body is not
        known.
    picture_far, picture_outside: Share of the person's size by which a key point lies elsewhere than on the body, and a
        joint outside of the mask: detectors put necks and hips up to 0.07 from the body's
    picture_deviation, picture_deviation_frame: Share of the key points, or joints, that are elsewhere from which on a
        motion is not to be trusted, and a frame is doubtful. Motions that lay on the person had 0.00 to 0.04, and 0.18
        at most in a frame (four real cameras, four simulated), those with limbs elsewhere, or key points half a second
        late, 0.30 to 0.65 (simulated)
    several_large, several_tall: Share of the largest part's area, and of its height, from which a part of a mask is a
        person, too: a person who is nearly twice as far away.
    several_often, several_now_and_then, several_views: Share of the frames in which a view must show several, without
        and with other evidence of them, and how many views must: an arm or a chair that a table cuts off is seen so by
        one.
    several_looks: frames that are looked at for several people
    points_m: m: key points belong to who stands no further from them.
    points_least_share: Share of the frames through which a person is followed who is tracked.
    people_start_s: s: the looks at the beginning that say who is there.
    people_look_s: s between two looks for a new person, who must be there in two.
    people_fit_s, people_fit_hz: s of frames, and their rate, from which a body is fitted.
    people_fewest: frames in which a new person must be found to be fitted
    people_gone_s: s without evidence after which a person has left.
    people_together_s: s: two bodies that stay in one place for so long are one person.
    rough_hidden: A view shows a person when no more than this share of the body is hidden.
    rough_few_seen: frames from which a body is fitted, at least, if there are so many
    rough_tried: frames that decide on the rough start
    rough_rivals: so many other starts are tried again with the others' bodies known
    rough_lost: 1 - IoU from which on a rough body is nowhere
    sensor_scale_m, sensor_weight: m: sd of a reported joint; weight of one in units of the robust rows' cost, half of
        it where it was inferred
    sensor_fewest: frames in which a sensor must report a joint for it to count
    sensor_alike: correlation of movements below which two clocks cannot be brought together
    sensor_apart_look_m, sensor_apart_m: m by which the joints of two sensors lie apart (median) from which on it is
        worth a look, and not to be trusted: 14 to 67 mm on 39 recordings of two real sensors; where one of them is 15 %
        too large 113, a second late 122, with left and right exchanged in every frame 240
    sensor_late_s, sensor_like: s by which a sensor's clock may be off, and the correlation of both movements from which
        on they tell: 0.12 s at most on the recordings above, where they tell
    sensor_nearer: share left at most of the distance between two sensors' joints when a clock is put right: who
        walks moves alike half a step later, with arms or sides exchanged
    sensor_legs_m: m of thigh and shank together, of people 0.9 to 2.3 m tall: sensors say 0.64 to 0.86 of adults
    sensor_of_height: thigh and shank as sensors see them, as a share of the height
    choice_plain, choice_sure: Mean IoU and weight from which on a start needs no other frame.
    choice_clearly: mean IoU by which another frame's start must be better, where no other person hides anything
    choice_later: Instants after a start that decide between its rivals; no step is so long that who walks is lost in
        it.
    choice_best, choice_likely: How many starts of a frame are tracked through the others, and how much each must be
        believed for it.
    choice_enough, choice_hopeless: After so many frames a way that costs so much more than the best one is not gone on.
    choice_particles, choice_never_s: particles of a short way from a start; s between two looks at rivals: never
    stranger_looked_at: px: of the longer side of the thinned masks in which parts are counted; a limb stays two or
        three pixels wide.
    stranger_along: shares of the way along a bone at which it is looked for
    check_tallest, check_smallest: m: what silhouettes of people span; arms raised and lying down included.
    check_least_overlap: Mean IoU of the best start; in the right pose the template has 0.6 (heavy people) to 0.85.
    check_worse_pose: How much less a named pose may overlap than another one; arms move to their place from up to 45
        degrees away.
    subject_poses, subject_looked_at: How many poses the outlines are fitted in, and among how many frames they are
        chosen
    subject_the_person: Mean IoU of the template's girths up to which masks are not of the person whose key points these
        are
    subject_bones, subject_sure_bones: per m^2: by what share (1 sd) bones may differ from those that key points give,
        of the squared median distance of key points from the body fitted to them, for what scatter does to a length
        grows so; and between which shares. Chosen on bodies from plain, detector-like and thinned out key points
        (combo, seeds 1248 to 1253)
    subject_height_wrong, subject_height_doubt: share by which the height that masks or depth show may differ from the
        one that is given before a motion is not to be trusted, and before it is worth a look
    subject_sure, subject_no_worse: sd of the height's logarithm up to which it is used at all, and the share of the
        mismatch that is left at most with it. Four people (seeds 50 to 53) whose height was given rightly came out
        within 0.5 %; given 13 % too small, 5 to 9 % below their own height at worst (poses were fitted to the wrong
        body), 8 to 15 % above the given one
    tracked_placed_m, tracked_early_s: m: a person who is wanted at a place stands no further from it; s: a place of so
        long before the first frame still tells of it.
    verdict_wrong_share: Mean probability over joints and frames of being wrong from which on nothing is trusted.
    verdict_limb_share: Share of the frames in which one and the same joint is doubtful, from which on nothing is
        trusted: who looks at the rest does not know what to believe of it.
    verdict_limb_p: How likely it must be wrong in those frames, in the mean: joints are doubtful long before they are
        likely wrong. On scenes (seeds 600 to 617) joints doubtful in half of the frames had .14 to .31 where the clip
        was never wrong, .19 to .40 where it was for some frames, and .28 to .91 where a limb was wrong all along. Where
        something else makes the whole clip worth a look, to be doubtful in half of the frames is enough: that is so in
        no usual clip of these seeds, and in three others, whose joints are off by 34 to 70 mm.
    trace_least_m: m; smaller displacements of joints by a pass are not recorded
    verdict_lost_share: Share of the frames without the person from which on the motion is not that of the recording.
    verdict_few_s: s: doubtful stretches that are shorter are not worth a look by themselves: they are named as all that
        is not good
    wardrobe_near_m: m between two people in which they may be taken for each other, and are not learnt from.
    wardrobe_looks: How often a person is looked at, apart from others, before it is decided who it is.
    wardrobe_unlike, wardrobe_clearly: Likeness of clothes below which it is another person, and by which others must be
        more alike for two to have been exchanged. On walks past each other (seeds 20 to 23) one and the same had 0.98
        and more, two people 0.5 and less.
    """

    again_poses: int = 12
    again_least_won: float = 0.3
    worth_frames: int = 60
    worth_prior: float = 0.25
    worth_noise: float = 2.0 / 480
    worth_places: int = 36
    compare_levels: tuple[float, float, float] = (0.5, 0.9, 0.95)
    compare_most_lag: float = 5.0
    compare_longest_gap: float = 0.1
    compare_least_joints: int = 4
    compare_least_frames: int = 8
    compare_alike: float = 0.2
    compare_apart_m: float = 0.08
    compare_wrong_units: tuple[float, ...] = (1000.0, 100.0, 39.37, 25.4, 10.0, 1.0, 0.01, 0.001)
    compare_alike_lengths: float = 0.26
    compare_mirrored: float = 0.5
    compare_sentinel_frames: int = 5
    compare_sentinel_share: float = 0.05
    contradiction_look_apart_m: float = 0.006
    contradiction_wrong_apart_m: float = 0.015
    contradiction_look_more_m2: float = 0.003
    doubts_jump: float = 1.8
    doubts_least_jump: float = 0.12
    doubts_sudden: float = 1.3
    doubts_worse: float = 0.15
    doubts_spread: float = 4.0
    doubts_stranger: float = 0.15
    doubts_less: float = 0.06
    doubts_still: float = 0.02
    doubts_still_points: float = 0.0005
    doubts_few_points: int = 6
    doubts_shown: float = 0.75
    doubts_after_s: float = 0.4
    examine_looks: int = 12
    examine_around: float = 0.3
    examine_used: int = 17
    first_tracked: int = 24
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
    gait_shortest: float = 0.6
    gait_longest: float = 2.5
    gesture_max_frames: int = 1_000_000
    gesture_max_gestures: int = 16
    gesture_waiting: int = 4
    gesture_telling: int = 10
    path_surprise: float = 1.0
    path_slack: float = 0.25
    path_seen_share: float = 0.5
    path_others_widened: float = 0.02
    path_core_m: float = 0.3
    path_gone_s: float = 0.8
    path_part: float = 0.4
    path_clearly_m: float = 0.6
    placing_looked_at: int = 400
    placing_calm: int = 9
    placing_lowest_m: float = 0.05
    placing_highest_m: float = 4.0
    placing_near: float = 0.6
    placing_least_share: float = 0.003
    placing_frames: int = 24
    placing_rounds: int = 2
    background_largest_lag_s: float = 0.4
    background_sure: float = 0.2
    background_gain: float = 6.0
    background_scale_px: float = 1.5
    engine_most_people: int = 8
    engine_history: int = 11
    engine_latencies: int = 1800
    engine_searches: int = 2
    engine_misses: tuple[float, float, float, float] = (0.05, 0.1, 0.2, 0.5)
    eyes_room_s: float = 2.0
    eyes_room_pictures: int = 12
    eyes_other_shape: float = 0.01
    eyes_damaged: int = 5
    eyes_quality: int = 85
    eyes_look_s: float = 0.2
    eyes_closing_s: float = 5.0
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
    live_give_up_s: float = 2.0
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
    live_together_m: float = 0.2
    live_together_s: float = 0.3
    live_rig_usual_rate: float = 30.0
    search_slowly_hz: float = 12.5
    search_gap_s: float = 1.0
    search_decide: int = 6
    search_longest: int = 250
    search_plain: float = 0.5
    search_least_area: float = 0.002
    search_stride: float = 0.4
    search_again_s: float = 2.0
    search_seldom_s: float = 60.0
    processes_switch_s: float = 0.0005
    recorder_waiting: int = 90
    recorder_pause_s: float = 1.0
    recorder_describe_s: float = 5.0
    rooms_every_s: float = 1.0
    rooms_light_s: float = 10.0
    rooms_thing_s: float = 30.0
    rooms_sparse: int = 3
    rooms_margin: float = 0.15
    rooms_moved_m: float = 0.05
    rooms_moved_grey: float = 12.0
    rooms_moved_share: float = 0.01
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
    moved_off_degrees: float = 4.0
    moved_off_m: float = 0.025
    moved_frames: int = 12
    moved_least_s: float = 0.6
    moved_rough: tuple[int, int] = (6, 3)
    moved_sure: float = 0.5
    newcomer_left_share: float = 0.1
    newcomer_shorter_m: float = 0.35
    newcomer_taller_m: float = 0.5
    newcomer_one_place_m: float = 0.2
    newcomer_nothing: float = 0.2
    newcomer_walking: float = 3.0
    newcomer_reach: float = 0.6
    newcomer_drawn_s: float = 0.4
    picture_target_px: float = 250.0
    picture_smallest_side: int = 320
    picture_ahead_bytes: int = 250_000_000
    picture_click_share: float = 0.010
    picture_length_frames: int = 10
    picture_far: float = 0.12
    picture_outside: float = 0.04
    picture_deviation: float = 0.15
    picture_deviation_frame: float = 0.2
    several_large: float = 0.3
    several_tall: float = 0.5
    several_often: float = 0.5
    several_now_and_then: float = 0.25
    several_views: int = 2
    several_looks: int = 7
    points_m: float = 0.6
    points_least_share: float = 0.1
    people_start_s: float = 0.5
    people_look_s: float = 0.12
    people_fit_s: float = 3.0
    people_fit_hz: float = 12.5
    people_fewest: int = 6
    people_gone_s: float = 0.4
    people_together_s: float = 0.3
    rough_hidden: float = 0.5
    rough_few_seen: int = 16
    rough_tried: int = 16
    rough_rivals: int = 2
    rough_lost: float = 0.6
    sensor_scale_m: float = 0.04
    sensor_weight: float = 0.3
    sensor_fewest: int = 10
    sensor_alike: float = 0.5
    sensor_apart_look_m: float = 0.085
    sensor_apart_m: float = 0.15
    sensor_late_s: float = 0.2
    sensor_like: float = 0.85
    sensor_nearer: float = 0.8
    sensor_legs_m: tuple[float, float] = 0.39, 0.99
    sensor_of_height: float = 0.43
    choice_plain: float = 0.6
    choice_sure: float = 0.9
    choice_clearly: float = 0.02
    choice_later: tuple[int, ...] = (1, 2, 3, 4, 5)
    choice_best: int = 2
    choice_likely: float = 0.05
    choice_enough: int = 6
    choice_hopeless: float = 0.04
    choice_particles: int = 32
    choice_never_s: float = 1e6
    stranger_looked_at: int = 160
    stranger_along: tuple[float, float, float] = (0.25, 0.5, 0.75)
    check_tallest: float = 3.2
    check_smallest: float = 0.4
    check_least_overlap: float = 0.4
    check_worse_pose: float = 0.05
    subject_poses: int = 8
    subject_looked_at: int = 24
    subject_the_person: float = 0.3
    subject_bones: float = 50.0
    subject_sure_bones: tuple[float, float] = (0.005, 0.05)
    subject_height_wrong: float = 0.12
    subject_height_doubt: float = 0.07
    subject_sure: float = 0.03
    subject_no_worse: float = 1.02
    tracked_placed_m: float = 1.0
    tracked_early_s: float = 0.5
    verdict_wrong_share: float = 0.12
    verdict_limb_share: float = 0.5
    verdict_limb_p: float = 0.35
    trace_least_m: float = 0.02
    verdict_lost_share: float = 0.3
    verdict_few_s: float = 0.12
    wardrobe_near_m: float = 0.7
    wardrobe_looks: int = 3
    wardrobe_unlike: float = 0.7
    wardrobe_clearly: float = 0.2


SETTINGS = PipelineSettings()
