"""What docs/benchmarks.md says of the benchmarks of several cameras and of bodies."""

from __future__ import annotations

from benchmarks.bench_plot import Panels
from benchmarks.bench_tables import Column, Line, Page, least, most, within

_ERROR = "mean_error_mm"
_TABLE_2_3 = Page(
    "table-2.3",
    """Alcoverro 2014, Table 2.3, on synthetic scenes: mean error of 15 joints in mm, median over the seeds. Every seed
    is another person from another shape space than the tracker's body, dressed, with spoilt masks (jittered outlines,
    holes, blobs, shadows); height and first pose are given. Published presets are as printed (what deviates:
    [equations](equations.md)): no solve of the start, no recovery; hpf+ has both. Last line: the product, with the body
    from another clip and all frames solved together. Published figures are of real HumanEva recordings.""",
    (
        *(Column(a, _ERROR, f"{{}}/{a}", spread=True) for a in ("walk", "box", "run", "combo")),
        Column("all", _ERROR, "{}/all"),
        Column("sd over frames", "sd_error_mm", "{}/all"),
        Column("lost, %", "lost_share", "{}/all", 100),
        Column("s/frame", "seconds_per_frame", "{}/all"),
        Column("x apf", "seconds_per_frame", "{}/all", ratio=True),
    ),
    (
        Line("apf, 15 x 240 (baseline)", "apf", more="111.2"),
        Line("hpf, 7 x 572", "hpf", (most(1, 4, "apf"),), more="103.0"),
        Line("hpf-apo", "hpf-apo", (most(1, 4, "hpf"), most(45, 0), most(45, 1)), more="91.7"),
        Line("hpf-apo+", "hpf-apo+"),
        Line("hpf+", "hpf+"),
        Line("default", "default", (most(40, 0), most(40, 1), most(40, 2))),
        Line("**default, estimated body**", "default, estimated body", (most(16, 4), most(0, 6), most(0.5, 5, "apf"))),
    ),
    "published, all",
    Panels((_ERROR, "sd_error_mm", "lost_share")),
)

_TABLE_2_4 = Page(
    "table-2.4",
    """Alcoverro 2014, Table 2.4, on synthetic scenes: mean distance of hands, head and feet from the truth in mm,
    median over the seeds; published evaluations per frame (3500, 3500, 3500, 4000, 3000), every preset as printed.
    Hands and head are detected by skin colour in rendered pictures, the person's own colours learnt in frame 0,
    where the pose is given. Published figures are of real IXMAS recordings.""",
    (
        Column("all", "extremity_error_mm", spread=True),
        *(Column(a.replace("_", " "), "extremity_error_mm", f"{{}}/{a}") for a in ("cross_arms", "wave", "punch")),
        Column("hands", "hand_error_mm"),
        Column("s/frame", "seconds_per_frame"),
        Column("x apf", "seconds_per_frame", ratio=True),
    ),
    (
        Line("apf", "apf", more="199.6"),
        Line("hpf", "hpf", (most(1, 0, "apf"),), more="136.5"),
        Line("dd-hpf", "dd-hpf", (most(1, 0, "hpf"),), more="118.8"),
        Line("dd-hpf+", "dd-hpf+", (most(1, 0, "dd-hpf"), most(40)), more="106.0"),
        Line("dd-hpf+5", "dd-hpf+5", (most(1.1, 0, "dd-hpf+"),), more="113.9"),
        Line("dd-hpf+, rivals", "dd-hpf+rivals", (most(30),)),
    ),
    "published, all",
    Panels(("extremity_error_mm", "hand_error_mm"), lines={"extremity_error_mm": 40.0}),
)

_COURT = Page(
    "court-4",
    """A person 80 px tall, another one walking in view and in the masks, cameras up to two frames late, false blobs;
    a serve of 1.6 s. A frame is tracked when the mean error over 15 joints is at most 120 mm. Recovery: the time
    until a person who was out of every view for 0.6 s is found again for good, of the presets that recover.""",
    (
        Column("tracked, %", "tracked_share", scale=100, spread=True),
        Column("mean error, mm", _ERROR, spread=True),
        Column("recovery, s", "recovery_s"),
        Column("back within 1 s, %", "recovered_in_1s", scale=100),
        Column("s/frame", "seconds_per_frame"),
        Column("x OpenCV fill", "seconds_per_frame", ratio=True),
    ),
    (
        Line("apf", "apf"),
        Line("hpf", "hpf", (least(1, 0, "apf"),)),
        Line("hpf-apo", "hpf-apo", (least(1, 0, "hpf"),)),
        Line("hpf-apo+", "hpf-apo+"),
        Line("hpf+", "hpf+", (most(1, 2),)),
        Line("default", "default", (most(1, 2),)),
    ),
    picture=Panels(("tracked_share", _ERROR, "recovery_s"), lines={"recovery_s": 1.0}),
)

_ARMS = Page(
    "arms",
    """How often the product has an elbow or a wrist (whose joint is the hand's) farther off than 100 or 150 mm: body
    from another clip, default recipe, clip solved at the end, two draws of the particles; on held-out seeds from 600 on
    (settings were chosen on 500 to 507), on other motions and rigs, and on the recording of `hypose demo`.""",
    (
        Column("> 100 mm, %", "wrong_100", scale=100),
        Column("> 150 mm, %", "wrong_150", scale=100),
        Column("mean error, mm", _ERROR),
        Column("arms' p95, mm", "arms_p95_mm"),
        Column("two draws differ by, mm", "draw_difference_mm"),
    ),
    (
        Line("walk, box, run, combo", "all", (most(4), most(0.7, 1), most(17.0, 2), most(60, 3))),
        *(Line(a, a) for a in ("walk", "box", "run", "combo")),
        Line("the same, not smoothed", "unsmoothed", (most(8),)),
        Line("arms folded", "folded"),
        Line("the same, with `--colours`", "folded/colours", (most(8),)),
        Line("serve", "serve", (most(1),)),
        Line("walk, ixmas-5", "ixmas-5/walk", (most(5),)),
        Line("punch, ixmas-5", "ixmas-5/punch", (most(2),)),
        Line("demo", "demo", (most(1), most(13.6, 2), most(40, 4))),
        Line("balancing", "balancing", (most(40, 4),)),
    ),
    picture=Panels(("wrong_100", "wrong_150")),
)

_REGIONS = (
    *(Column(g, "coverage_90", f"{{}}{g}", 100) for g in ("torso", "arms", "legs", "head", "all")),
    Column("all, 50 %", "coverage_50", "{}all", 100),
    Column("all, 95 %", "coverage_95", "{}all", 100),
)
_HELD = tuple(within(85, 95, c) for c in range(4))
_DOUBT = Page(
    "doubt",
    """P(joint wrong by more than 100 mm): areas under the curve; share of arm joints more than 150 mm off, of frames
    with a wrong arm, and of good frames that are told as doubtful; calibration error; share of clips that do not end
    as good. Seeds that judge (1294 on: nothing was fitted or chosen on them), from silhouettes. Usual:
    the person alone, the right cameras, in time. Cameras that are not where or when they are said to be have a world of
    their own: errors are what a rigid motion of the clip leaves. The JSON holds regions, the clip's solve, both against
    its parts, verdicts.""",
    (
        Column("all", "auroc"),
        Column("arms", "auroc", "{}/arms"),
        Column("> 150 mm told", "recall_150", "{}/arms"),
        Column("wrong frames told", "frames_caught"),
        Column("good frames told", "frames_flagged_good"),
        Column("ECE of P", "ece_p"),
        Column("not good", "not_good"),
    ),
    (
        Line("scenes", "scenes", (least(0.98), least(0.94, 1), least(0.93, 2), least(0.85, 3), most(0.01, 5))),
        Line("usual scenes", "scenes, usual", (most(0.1, 4),)),
        Line("scenes, body roughly right", "scenes, roughly right"),
        Line("motion left out", "left-out", (least(0.9, 1),)),
        Line("key points spoilt", "spoilt", (least(0.9),)),
        Line("things in the masks", "things in the masks", (least(1.0, 6),)),
        Line("wrong or late cameras", "wrong cameras", (least(1.0, 6),)),
        Line("nothing wrong", "nothing wrong"),
    ),
)

_STARTS = Page(
    "starts",
    """Recordings of masks alone (level-1 corruption, pictures of half size, 1.4 s, four and five cameras) that begin
    with somebody who sits, crouches, steps, or holds the arms somewhere, and faces anywhere; every second seated one on
    a chair that is in the masks. Right: the joints are off by less than 60 mm on average about one second after the
    beginning. Said: of those that are not right, the share that does not end as good. Settings come from the seeds 700
    to 702.""",
    (
        Column("right", "right"),
        Column("heading right", "heading"),
        Column("error, mm", "error_mm"),
        Column("said", "said"),
        Column("right, but refused", "false_alarm"),
        Column("search, s", "seconds"),
    ),
    (
        Line("all", "all"),
        *(Line(p, p) for p in ("standing", "step", "arms forward", "arms up", "arms folded", "crouching")),
        Line("seated", "seated"),
        Line("seated, arms folded", "seated, arms folded"),
        Line("on a chair", "on a chair"),
    ),
)

_UNCERTAINTY = Page(
    "uncertainty",
    """Share (%) of the true joints inside the reported 90 % regions (and 50, 95 %), which are ellipsoids, on the
    scenes of table-2.3 with the clip solved as a whole; the body comes from another clip. The factors per group of
    joints come from other seeds (20 to 35). Regions should hold 85 to 95 % in every group.""",
    _REGIONS,
    (
        Line("silhouettes", "", _HELD),
        Line("key points alone", "keypoints/", _HELD),
        Line("both", "both/", _HELD),
    ),
    picture=Panels(
        ("coverage_50", "coverage_90", "coverage_95"),
        "silhouettes",
        {"coverage_50": 0.5, "coverage_90": 0.9, "coverage_95": 0.95},
    ),
)

_BALANCING = Page(
    "real-balancing",
    """Pose2Sim's balancing clip (4 cameras, 100 frames, refined extrinsics): 12 limb joints against the triangulated
    key points, which are a peer's answer, not marker truth, after one fixed offset per joint. Key points, both and
    Pose2Sim are judged against themselves, so what hugs the points most wins; a camera that was left out (median
    distance in it, px) is the fairer judge. Pose2Sim's method is written anew from its settings and measured in
    the same run.""",
    (
        Column("median, mm", "median_mm"),
        Column("p95, mm", "p95_mm"),
        Column("bone-length sd, mm", "bone_sd_mm"),
        Column("IoU", "iou"),
        Column("camera left out, px", "loco_px"),
        Column("x Pose2Sim", "loco_px", ratio=True),
    ),
    (
        Line("silhouettes", "silhouettes", (most(30, 0), most(80, 1))),
        Line("silhouettes, masks helped by key points", "silhouettes, masks with key points"),
        Line("key points", "keypoints", (most(12, 0),)),
        Line("both", "both", (most(12, 0), most(2, 2), least(0.83, 3), most(0.95, 5))),
        Line("Pose2Sim's method", "pose2sim"),
        Line("triangulation", "triangulation"),
    ),
    picture=Panels(("median_mm", "p95_mm", "iou", "loco_px"), lines={"iou": 0.83}),
)

_UU4CAM = Page(
    "real-uu4cam",
    """The UU four-camera clip, every 10th of 426 frames: masks against those of a student's work (largest piece of
    either), and the visual hull against the masks. The mask settings were chosen on this clip. What differs are
    rims, chair legs and the student masks' own raggedness.""",
    (Column("masks, IoU", "mask_iou"), Column("hull, IoU", "hull_iou")),
    (
        *(Line(f"cam{c}", f"cam{c}") for c in range(1, 5)),
        Line("worst view", "worst view", (least(0.9, 0), least(0.85, 1))),
    ),
    picture=Panels(("mask_iou", "hull_iou"), lines={"mask_iou": 0.9, "hull_iou": 0.85}),
)

_REGIONS_REAL = Page(
    "regions-real",
    """Share of what was left out inside the reported 90 % regions on real recordings. Balancing: the limbs' key points
    in the picture of a camera that was left out, where a detection errs as in the others. Sensors: the other Kinect's
    joints, on the even recordings; parallel ones make the same errors and are no test.""",
    (Column("in the region", "coverage_90"),),
    (
        *(
            Line(f"{words}, one camera of four left out", f"{evidence}/camera left out", (within(0.75, 0.97),))
            for evidence, words in (("keypoints", "key points"), ("both", "key points and silhouettes"))
        ),
        *(
            Line(f"Kinects {case} degrees apart, one left out", f"sensors/{case}", (within(0.75, 0.97),))
            for case in ("45", "90")
        ),
    ),
)

_DETECTOR = Page(
    "detector",
    """Tracked from videos alone, by the points and masks of the own detector. Balancing: 12 limb joints against the
    triangulated points of another detector, refined cameras; the camera left out is looked at through the points
    there, its own and the other detector's. Scenes: rendered people, against background subtraction with simulated key
    points.""",
    (
        Column("median, mm", "median_mm"),
        Column("IoU", "iou"),
        Column("camera left out, px", "loco_px"),
        Column("mean joint error, mm", "error_mm"),
        Column("x background", "error_mm", ratio=True),
    ),
    (
        Line("both", "both", (most(16, 0), least(0.82, 1), most(12, 2), most(1.2, 4))),
        Line("both, left out: the other detector's points", "both/another detector's", (most(12, 2),)),
        Line("silhouettes", "silhouettes"),
        Line("key points", "keypoints"),
    ),
)

_OPENSIM = Page(
    "opensim",
    """Balancing, tracked from key points, handed to OpenSim: its own inverse kinematics on the exported model, markers
    and weights. The markers are the tracked body's, so this says that nothing is lost on the way, not how near the
    motion is to the truth.""",
    (
        Column("markers, mm rms", "marker_rmse_mm"),
        Column("worst, mm", "marker_max_mm"),
        Column("columns that the model lacks", "columns_missing"),
        Column("angles apart, degrees", "angle_difference_deg"),
    ),
    (Line("balancing", "balancing", (most(15, 0), most(0, 2))),),
)

_SCORER = Page(
    "silhouette-scorer",
    """One silhouette is one pose in one view of 640 x 480, with kinematics, skinning, projection and the comparison
    with the mask: 500 poses, 4 views, 550 vertices, the person about 90 x 260 px. The first two lines are compared
    with OpenCV projecting and filling every front triangle of the same poses, without skinning.""",
    lines=(
        Line("1 thread", "1t", metric="us_per_silhouette"),
        Line("1 thread, share of OpenCV's time", "1t", (most(1 / 60),), "ratio_to_opencv"),
        Line("2 threads", "2t", metric="us_per_silhouette"),
        Line("2 threads, share of OpenCV's time", "2t", (most(1 / 100),), "ratio_to_opencv"),
        Line("upper half (a box per view)", "1t,box", metric="us_per_silhouette"),
        Line("head and trunk only", "1t,parts", metric="us_per_silhouette"),
        Line("an arm over the rest", "1t,arm", metric="us_per_silhouette"),
        Line("the fine mesh, 2599 vertices", "1t,fine", metric="us_per_silhouette"),
        Line(
            "rank correlation with the fine mesh, standing", "standing", (least(0.999),), "spearman_to_fine", digits=4
        ),
        Line("the same, walking", "walking", (least(0.999),), "spearman_to_fine", digits=4),
    ),
    picture=Panels(("us_per_silhouette",)),
)

_SOLVE = Page(
    "contour-solve",
    """The robust solve from the constant-velocity prediction: 4 views, 36 degrees of freedom, 8 iterations, one
    thread. Distance from where 60 iterations end: on walk at 25 frames/s, where limbs move 5 to 10 cm between
    frames. Balancing alone (no particles) against a slow reference: whole distances in images of twice the size,
    outlines three times as dense, 60 iterations.""",
    lines=(
        Line("contours, person 260 px tall", "contours", (most(8),), "ms_per_frame"),
        Line("contours, masks of half the size", "contours, half size", metric="ms_per_frame"),
        Line("contours, balancing", "balancing", (most(8),), "ms_per_frame"),
        Line("25 key points in each view", "keypoints", (most(1),), "ms_per_frame"),
        *(
            Line(f"to convergence after {n} iterations, median", f"{n} iterations, median", metric="to_converged_mm")
            for n in (2, 4, 6, 8)
        ),
        Line("the same after 8, 90th percentile", "8 iterations, p90", metric="to_converged_mm"),
        Line("balancing, solve alone", "balancing", (most(1.06, 0, "slow reference"),), "median_mm"),
    ),
    picture=Panels(("ms_per_frame", "to_converged_mm")),
)

_SPEED = Page(
    "multiview-speed",
    """Whole tracking by the clock: masks in (640 x 480, in memory) or four video files in. A decode ratio is
    processor time from files to evidence over decoding alone. Growth: time per frame with twice the particles,
    views or frames.""",
    lines=(
        Line("masks in, default", "masks:default/4", (least(100),), "frames_per_second"),
        Line("masks in, hpf 7 x 572", "masks:hpf/4", (least(6),), "frames_per_second"),
        Line("masks in, apf 15 x 240", "masks:apf/4", (least(6),), "frames_per_second"),
        Line("videos of 640 x 480, default", "480p:default/4", (least(50),), "frames_per_second"),
        Line("videos of 1440 x 1080, default", "1080p:default/4", (least(30),), "frames_per_second"),
        Line("balancing, 1088 x 1920, default", "balancing 1080p:default/4", (least(30),), "frames_per_second"),
        Line("key points of a whole clip", "keypoints:clip/4", (least(100),), "frames_per_second"),
        Line("evidence / decoding, 1080p", "1080p", metric="decode_ratio"),
        Line("evidence / decoding, balancing", "balancing 1080p", (most(1.5),), "decode_ratio"),
        Line("growth, particles x 2", "particles x 2", metric="growth"),
        Line("growth, views x 2", "views x 2", metric="growth"),
        Line("growth, frames x 2", "frames x 2", metric="growth"),
        Line("peak memory", "all", (most(1024),), "peak_memory_mib"),
    ),
    picture=Panels(("frames_per_second", "growth")),
)

_FRONT_BACK = Page(
    "front-back",
    """Front and back look alike in silhouettes: walk, jog and combo of 6 s, rig at half size, the body from the same
    clip. Share of the frames in which the body is turned around, and the mean error, as tracked frame after frame
    and after stretches that were turned have been tracked again; from the start that is found, and from one turned
    on purpose. Thresholds come from seeds 10 to 15.""",
    (
        Column("turned, %", "turned", scale=100),
        Column("mean error, mm", "error_mm", spread=True),
        Column("x as tracked", "error_mm", ratio=True),
        Column("s/frame", "seconds_per_frame"),
        Column("x without looks", "seconds_per_frame", ratio=True),
    ),
    (
        Line("own start, as tracked", "own start, as tracked"),
        Line("own start, mended", "own start, mended", (most(0, 0), most(1, 1, "own start, as tracked"))),
        Line("turned start, as tracked", "turned start, as tracked"),
        Line("turned start, mended", "turned start, mended", (most(0, 0),)),
        Line("tracking with looks", "own start"),
    ),
    picture=Panels(("turned", "error_mm")),
)

SEVERAL_CAMERAS = (
    _TABLE_2_3,
    _TABLE_2_4,
    _COURT,
    _DOUBT,
    _ARMS,
    _UNCERTAINTY,
    _BALANCING,
    _DETECTOR,
    _REGIONS_REAL,
    _OPENSIM,
    _UU4CAM,
    _SCORER,
    _SOLVE,
    _SPEED,
    _FRONT_BACK,
    _STARTS,
)

BODIES = (
    Page(
        "rigging",
        """Skinning weights by heat on the template, the procedural body and two subjects, compared with their own;
        and scans of subjects in three poses with 3 mm of noise, rigged without help.""",
        lines=tuple(
            Line(f"{metric}, {case}", f"8 scans, pose {case}, noise 3 mm", metric=metric)
            for metric in ("joints, mean error", "joints, largest error", "whole rigging")
            for case in ("t", "a", "standing")
        ),
    ),
    Page(
        "anthropometry",
        """Body measures of 23 subjects from 5 cameras, from 3 s of motion or from one held pose, without a height,
        and what the estimated body is worth to tracking (8 subjects, walk and box). Per segment:
        [anthropometry.md](anthropometry.md).""",
        lines=(
            Line("segment lengths, motion", "motion", (most(2),), "segment_error_cm"),
            Line("segment lengths, one pose", "one_pose", (most(2.5),), "segment_error_cm"),
            Line("shoulder height, all", "all", (most(1.5),), "shoulder_height_error_cm"),
            Line("girths, all", "all", (most(10),), "girth_error_pct"),
            Line("IoU, least view, all", "all", (least(0.9),), "min_view_iou"),
            Line("per subject", "all", (most(60),), "seconds_per_subject"),
            Line("tracking error with the template", "template/all", metric="tracking_error_mm"),
            Line("tracking error with the estimated body", "fitted/all", (most(30),), "tracking_error_mm"),
            Line("gain", "all", (least(0.25),), "tracking_gain"),
            Line("least gain of a subject", "worst", (least(-0.05),), "tracking_gain"),
        ),
    ),
    Page(
        "subject-balancing",
        """The real balancing clip with a subject from silhouettes alone; as real-balancing.""",
        (Column("median, mm", "median_mm"), Column("p95, mm", "p95_mm"), Column("IoU", "iou")),
        (
            Line("first pose from key points", "start from key points", (most(50),)),
            Line("first pose from the hull", "start from the hull", (most(50),)),
        ),
    ),
)
