"""What docs/benchmarks.md says of each benchmark: its table, what was asked for, and at most five lines of prose."""

from __future__ import annotations

from benchmarks.bench_plot import Panels
from benchmarks.bench_tables import Column, Line, Page, least, most, within
from benchmarks.cameras.captured_pages import CAPTURED
from benchmarks.multiview.multiview_pages import BODIES, SEVERAL_CAMERAS
from benchmarks.people.association_pages import WHO_IS_WHO
from benchmarks.people.people_pages import PEOPLE_PAGES

_CAMERAS = (
    Page(
        "calibration",
        """Boards moved before five cameras (60 frames, 0.25 px of noise, worst camera of each rig), and two real
        board clips against the calibration they came with.""",
        (
            Column("focal, px", "focal_error_px", spread=True),
            Column("position, mm", "position_error_mm", spread=True),
            Column("rms, px", "rms_px"),
            Column("from the given, mm", "agreement_mm, worst camera"),
            Column("from the given, degrees", "agreement_deg, worst camera"),
            Column("hull IoU", "hull_iou, worst view"),
        ),
    ),
    Page(
        "doctor",
        """Half of the recordings are healthy, half have one planted fault; precision and recall of the verdicts, with
        kind and camera. Limits were chosen on seeds 0 to 41, seeds from 1000 on are reported. Silhouettes alone
        miss swaps of neighbours, and timing and poses of static clips.""",
        (
            Column("precision", "verdict_precision"),
            Column("recall", "verdict_recall"),
            Column("healthy without a finding", "healthy_without_finding"),
        ),
        (Line("key points and masks", "all", (least(0.95, 0), least(0.95, 1))), Line("masks alone", "silhouettes")),
        picture=Panels(("verdict_precision", "verdict_recall", "recall")),
    ),
    Page(
        "doctor-real",
        """The balancing clip as shipped: scaled videos, key points one frame early, 6 px in camera 1, biased
        extrinsics. Median residual on frames that were not used, and triangulation in a camera left out.""",
        (
            Column("residual, px", "refined_residual_px"),
            Column("camera left out, px", "left_out_px"),
            Column("x Pose2Sim as shipped", "left_out_px", ratio=True),
        ),
        (
            Line("shipped", "shipped"),
            Line("refined from key points", "keypoints", (most(7, 0),)),
            Line("from silhouettes alone", "silhouettes", (most(7.5, 0), most(0.6, 2))),
            Line("from silhouettes, starts 140 mm off", "silhouettes, starts 140 mm off", (most(8, 0),)),
            Line("from both", "both"),
        ),
    ),
    Page(
        "sync",
        """Offsets of -5.0 to 5.0 frames between four cameras found from motion (walk, waving arms), from a sound (a
        clap in a noisy room) and from a lamp; frames at 25 frames/s. Weights were chosen on seeds 0 to 41.""",
        (Column("mean error, frames", "sync_error_frames"), Column("largest", "sync_error_largest_frames")),
        tuple(
            Line(f"{case}, {name}", f"{case}, {name}", (most(0.2, 1),))
            for case in ("walk", "arms")
            for name in ("keypoints", "silhouettes", "both")
        )
        + (Line("sound", "sound"), Line("lamp", "lamp")),
        picture=Panels(("sync_error_frames", "sync_error_largest_frames"), lines={"sync_error_largest_frames": 0.2}),
    ),
)

_NOISE_BINS = ((0.6, 0.9), (0.9, 1.5), (1.5, 2.5), (2.5, 3.5), (3.5, 5.5))
_CYCLES = {"t50": "t = 50", "t100": "t = 100", "adaptive": "adaptive"}
_FUSION = (
    Page(
        "fusion-table-1",
        """Asteriadis 2013, Table 1, on simulated sensors: share (%) of the cases in which the swarm's majority comes
        from a sensor that tracks the hand. `published` registers by the triangle of every frame, as printed. Seeds
        from 2000 on, on which nothing was chosen.""",
        tuple(Column(f"{s}, {words}", "success", f"{{}}/{s}/{c}", 100) for s in "AB" for c, words in _CYCLES.items()),
        (
            Line("published (paper: 87.5, 83.3; 91.7, 95.0)", "published"),
            Line("improved", "swarm", (*(least(90, c) for c in range(3)), least(95, 3), least(92, 4), least(95, 5))),
        ),
        picture=Panels(("success", "within_share")),
    ),
    Page(
        "fusion-departures",
        """What each departure from the paper is worth: success with one changed at a time, on seeds below 1000.""",
        (Column("success", "success"),),
    ),
    Page(
        "fusion-human4d",
        """Mean distance (mm) over 15 joints from the truth: simulated sensors A and B, and HUMAN4D's run from its
        four real camera poses (H). All methods but `published` use the same registration.""",
        tuple(Column(s, "mpjpe_mm", f"{s}/{{}}", spread=True) for s in "ABH"),
        (
            Line("best single sensor, in hindsight", "best_single"),
            Line("swarm, published", "published"),
            Line("swarm, published, registered over the clip", "published-window"),
            Line("swarm, improved", "swarm"),
            Line("fit", "fit", tuple(most(0.6, c, "best_single") for c in range(3))),
            Line("fit, causal", "fit/causal"),
        ),
    ),
    Page(
        "fusion-real",
        """Two real Kinect v2 on one person, parallel, 45 and 90 degrees apart, three recordings each: median distance
        between the sensors' joints after registration over the whole clip and on the way (causal), and bone lengths and
        jitter (median second difference) of what is fused. There is no truth: agreement is not accuracy. Regions and
        verdicts are of the even recordings, on which nothing of them was chosen.""",
        lines=(
            *(
                Line(f"agreement, {title}, {how}", case + more, (most(limit),), "agreement_mm")
                for more, how, limits in (("", "whole clip", (13, 26, 49)), ("/causal", "causal", (14, 35, 61)))
                for title, case, limit in zip(
                    ("parallel", "45 degrees", "90 degrees"), ("parallel", "45", "90"), limits, strict=True
                )
            ),
            *(
                Line(f"agreement, triangle per frame (published), {case}", f"{case}/per_frame", metric="agreement_mm")
                for case in ("parallel", "45", "90")
            ),
            Line("agreement, 45 degrees, even recordings, whole", "45/even", (most(31),), "agreement_mm"),
            *(
                Line(f"in one sensor's 90 % regions, {case} degrees{words}", case + more, bars, "coverage_90")
                for case in ("45", "90")
                for more, words, bars in (
                    ("", "", (within(0.75, 0.97),)),
                    ("/clear", ", what the other does not doubt", ()),
                )
            ),
            Line("occlusion or two people: not called good", "occlusion or two people", (least(0.8),), "not_good"),
            Line("one person: not to be trusted", "one person", (most(0.5),), "untrusted"),
            Line("bone-length sd of the fit", "fit", (most(3),), "bone_sd_mm"),
            Line("of the mean", "mean", metric="bone_sd_mm"),
            Line("of the improved swarm", "swarm", metric="bone_sd_mm"),
            Line("jitter of the fit", "fit", (most(1, 0, "mean"),), "jitter_mm"),
            Line("of the mean", "mean", metric="jitter_mm"),
            Line("of the improved swarm", "swarm", metric="jitter_mm"),
        ),
        picture=Panels(("agreement_mm", "jitter_mm")),
    ),
    Page(
        "fusion-speed",
        """15 joints, 3 sensors, 2100 candidates, one core; each frame's time is its smallest over the repetitions.
        The latency is that of six persons without sockets, three sensors of which one falls silent for two
        seconds; it waits for late sensors, and on a busy machine for timers.""",
        lines=(
            Line("fit, recorded", "fit", (most(0.3),), "ms_per_frame"),
            Line("fit, stream with its registration", "fit/stream", metric="ms_per_frame"),
            Line("swarm, published, restarts included", "swarm", (most(1),), "ms_per_frame"),
            Line("swarm, improved", "swarm/improved", (most(1),), "ms_per_frame"),
            Line("a restart frame, published", "restart", (most(5),), "ms_per_frame"),
            Line("a restart frame, improved", "restart/improved", (most(5),), "ms_per_frame"),
            Line("fit of six persons", "6_persons", (most(33),), "ms_per_frame"),
            Line("latency, median", "all", metric="latency_median_ms"),
            Line("latency, 99 %", "all", (most(20),), "latency_p99_ms"),
        ),
        picture=Panels(("ms_per_frame",)),
    ),
    Page(
        "depth",
        """Depth cameras as evidence, all simulated ([how](depth.md)): captured motion with turns to both profiles, one
        sensor in front, two at 90 degrees, three all round. Errors over 15 joints; `sdk`: simulated skeletons of the
        same sensors, fused. Coverage: joints in their 90 % regions. Told: which joints are wrong by more than 100 mm,
        area under the curve. ms/frame: of one map, one thread, median. Late: live, two sensors. Two people pass each
        other 0.8 m apart. Seeds from 710 on, on which nothing was chosen.""",
        (
            Column("mean, mm", "mean_mm", spread=True),
            Column("95 %, mm", "p95_mm"),
            Column("in 90 % regions", "coverage_90"),
            Column("degrees", "registration_deg", spread=True),
            Column("mm", "registration_mm", spread=True),
            Column("ms/frame", "ms_per_frame"),
            Column("x OpenCV fill", "ms_per_frame", ratio=True),
            Column("wrong joints told", "wrong_auroc"),
            Column("late, 99 %, ms", "latency_p99_ms"),
            Column("two people, mm", "together_mm", "people/{}"),
            Column("alone", "alone_mm", "people/{}"),
        ),
        (
            Line("one sensor", "one", (most(45, 0), most(8, 5))),
            Line("two", "two", (most(28, 0), most(0.5, 3), most(15, 4), most(8, 5), most(50, 8))),
            Line("three", "three", (most(22, 0), most(8, 5))),
            Line("one and a colour camera", "one+colour", (most(1, 0, "one"), most(1, 0, "colour alone"))),
            Line("colour camera alone, body and start given", "colour alone"),
            Line("sdk skeletons of two", "sdk/two"),
            Line("sdk skeletons of three", "sdk/three"),
            Line("all", "all", (least(0.85, 2), most(0.95, 2))),
        ),
        picture=Panels(("mean_mm",)),
    ),
    Page(
        "depth-noise",
        """Real and simulated depth cameras: noise about planes of 9 x 9 px (the calmest fifth), holes, and values
        between both sides at jumps of 10 cm. Azure Kinect: one frame of a desk; Kinect: hands before the first
        generation's; simulated: walls, and a person's edges.""",
        (
            *(Column(f"{a:g}-{b:g} m, mm", "noise_mm", f"{{}}/{a:g}-{b:g}") for a, b in _NOISE_BINS),
            Column("holes at edges", "edge_holes"),
            Column("between both sides", "edge_between"),
        ),
        (Line("Azure Kinect", "azure"), Line("Kinect", "kinect"), Line("simulated", "simulated")),
    ),
)

_GESTURE_COLUMNS = ("tee", "cross", "pause", "silence", "ok", "volume_up")
_GESTURES = (
    Page(
        "gesture-table-3.1",
        """Clipping distances, trained in two fixed empty rooms, tested in clutter: offline boosted as published
        (random negatives), area under recall over 1 - precision at 10 px; and online learning. Drawn people in
        drawn rooms.""",
        (
            *(Column(g.replace("_", " "), "auc", f"{{}}/{g}") for g in _GESTURE_COLUMNS),
            Column("mean", "auc", spread=True),
        ),
        (
            Line("clipped at 15 cm", "clipped_15", (least(1.3, 6, "unclipped"), least(2, 0, "unclipped"))),
            Line("30 cm", "clipped_30"),
            Line("50 cm", "clipped_50"),
            Line("not clipped", "unclipped"),
            Line("boosted sub-forests, not clipped", "subforest"),
        ),
    ),
    Page(
        "gesture-table-3.2",
        """12 people trained, 6 others tested in cluttered rooms with a second person in most pictures: average
        precision at 10 px of online learning with hard and with random negatives and of offline boosting on the
        same frames.""",
        (
            *(Column(g.replace("_", " "), "ap", f"{{}}/{g}") for g in _GESTURE_COLUMNS),
            Column("mean", "mean_ap", spread=True),
            Column("mean, 5 cm", "mean_ap", "{}/5cm"),
        ),
        (
            Line("online, hard negatives", "online_hard", (least(0.88, 6), least(2, 6, "online_random")), more="0.69"),
            Line("online, random negatives", "online_random"),
            Line("offline boosted, negatives around the place", "offline_boosted_around"),
            Line("offline boosted as published", "offline_boosted"),
        ),
        "published, mean",
    ),
    Page(
        "gesture-sweeps",
        """Alpha and beta of the online forest for one gesture ("pause"), and the balance of its trees.""",
        (Column("AP", "ap"),),
    ),
    Page(
        "gesture-table-3.3",
        """Three sessions of 3 minutes of one person, the forest resumed, against offline learning on the same frames;
        average precision at 10 px and 5 cm, tested in other rooms.""",
        (Column("10 px", "ap_10px", spread=True), Column("5 cm", "ap_5cm", spread=True), Column("min", "minutes")),
    ),
    Page(
        "gesture-semi-synthetic",
        """Real depth crops of 24 hand signs of one person, split by time, pasted into simulated cluttered rooms;
        every letter against all others.""",
        (Column("mean AP", "mean_ap"),),
        (Line("10 px", "letters", (least(0.8),)), Line("5 cm", "letters/5cm")),
    ),
    Page(
        "gesture-speed",
        """One thread, processor time, 640 x 480, 15 trees of depth at most 20, simulated sensor, cluttered rooms.""",
        lines=(
            Line("find one gesture", "one", (most(5),), "detect_ms"),
            Line("the same with a deep forest", "one/deep", metric="detect_ms"),
            Line("find six gestures", "six", (most(33),), "detect_ms"),
            Line("AP (5 cm) lost to early rejection", "all", metric="ap_lost_to_rejection"),
            Line("learn a frame", "all", (least(100),), "train_frames_per_second"),
            Line("memory of a growing forest", "all", (most(10),), "model_mb"),
            Line("offline fit of 15 trees", "all", metric="offline_fit_s"),
            Line("learn one sample", "all", metric="learn_one_us"),
        ),
    ),
    Page(
        "gesture-false-alarms",
        """Ten minutes of free movement without gestures after one short session for each of four gestures: events per
        gesture and minute, and what is found of gestures that are held.""",
        (
            Column("false alarms per minute", "false_alarms_per_minute", spread=True),
            Column("holds found", "holds_found", spread=True),
        ),
    ),
)

_MONO = (
    Column("kept", "kept_track"),
    Column("median, mm", "median_error_mm"),
    Column("depth, mm", "depth_mm"),
    Column("picture, px", "image_error_px"),
    Column("90 % regions of the best", "coverage_90_best"),
)
_ONE_CAMERA = (
    Page(
        "mono-arm",
        """One camera, a 7-dof arm for 8 s across trunk, face and pillar; elbow, wrist and knuckles in the world.
        Kept: in the picture to the end, and the median in space below 150 mm. Whole clip: tracked both ways and
        solved as one.""",
        (Column("mean, mm", "mean_error_mm", spread=True), Column("at most 80 mm", "at_most_80"), *_MONO),
    ),
    Page(
        "mono-body",
        """One camera, 30 dof, 1.2 s (and 8 s), 7 hypotheses; 14 joints, pelves made to coincide; and what each part
        of the method is worth.""",
        (Column("mean, mm", "root_aligned_mm", spread=True), *_MONO),
    ),
    Page(
        "mono-speed",
        """Processor time of one core per frame of 384 x 288 px, beside OpenCV's optical flow of the whole picture in
        the same run, and the share of the stages.""",
        lines=(
            Line("arm, 3 hypotheses", "arm", (most(0.06),), "seconds_per_frame"),
            Line("body, 7 hypotheses", "body", (most(0.15),), "seconds_per_frame"),
        ),
        picture=Panels(("seconds_per_frame", "stage_share")),
    ),
    Page(
        "mono-real",
        """One view of the balancing clip: 12 limb joints against the key points triangulated from all four views,
        middles of the hips made to coincide. The start is from this view's key points.""",
        (
            Column("mean, mm", "root_aligned_mm"),
            Column("median, mm", "median_mm"),
            Column("depth, mm", "depth_mm"),
            Column("picture, px", "image_error_px"),
        ),
    ),
)

_ROBUSTNESS = (
    Page(
        "start",
        """What is installed, MB; then processor time from the start of a process to the first pose, less the work on
        the recording itself, with nothing compiled yet (compiled by all cores at once) and later, and of
        `hypose track --help`.""",
        lines=(
            Line("installed, MB", "core", (most(500),), "install_mb"),
            Line("first start, s: track", "track", (most(90),), "cold_start_s"),
            Line("first start, s: fuse", "fuse", (most(90),), "cold_start_s"),
            Line("later starts, s: track", "track", (most(1.5),), "warm_start_s"),
            Line("later starts, s: fuse", "fuse", (most(1.5),), "warm_start_s"),
            Line("later starts, s: help", "help", (most(1.5),), "warm_start_s"),
        ),
    ),
    Page(
        "short-clip",
        """Processor time of `hypose track` on 100 frames of key points from four cameras (the balancing clip): with all
        files and the report, and with motion.trc alone.""",
        lines=(
            Line("all files and the report, s", "all", (most(10),), "cpu_s"),
            Line("motion.trc alone, s", "trc", (most(6),), "cpu_s"),
        ),
    ),
    Page(
        "inputs",
        """The same detections of a walk (100 frames, four cameras) in every layout of key points that is read: largest
        distance of a joint from the track of the OpenPose files, and of 40 spoilt sets (y upwards, mirrored, other
        sizes, other orders, damaged bytes, cut files) the share refused, and read as something else.""",
        (
            Column("poses, mm", "pose_difference_mm"),
            Column("refused", "refused"),
            Column("guessed wrong", "guessed_wrong"),
        ),
    ),
    Page(
        "kills",
        """SIGKILL at random moments of all long commands, half of the time over finished results: files lost, files
        half written, and the share of second runs that give the same bytes.""",
        (
            Column("lost", "lost_results"),
            Column("half written", "half_written"),
            Column("same bytes", "resumed_identical"),
        ),
    ),
    Page(
        "faults",
        """The evidence of a walk is spoilt for two seconds: mean error (mm) before, during and in the last second,
        time to recover, and frames (%) flagged, wrong, and wrong without any flag; medians over the seeds.""",
        (
            Column("before", "error_before_mm"),
            Column("during", "error_during_mm"),
            Column("last second", "error_after_mm"),
            Column("recovered, s", "recovered_s"),
            Column("flagged", "flagged_share", scale=100),
            Column("wrong", "wrong", scale=100),
            Column("not flagged", "unflagged_wrong", scale=100),
        ),
    ),
    Page(
        "batch",
        """A hundred recordings of 30 frames on one worker and on two, with a worker killed twice on the way.""",
        lines=(
            Line("two workers", "two workers", (least(1.8),), "speed_up"),
            Line("results that are the same bytes", "two kills", (least(1),), "identical"),
        ),
    ),
)

_STUDIO = (
    Page(
        "studio",
        """The page in headless Chromium, which draws on the processor, and a server of its own: a result of 60 000
        frames that it has not seen, then ten results of 15 000 frames with pictures one after the other; a recorded
        session of 30 pictures a second on the gesture screen.""",
        lines=(
            Line("60 000 frames open, s", "long result", (most(3),), "opens_s"),
            Line("the same again, s", "long result again", (), "opens_s"),
            Line("slowest of ten results, s", "slowest of ten", (most(3),), "opens_s"),
            Line("server's memory at most, MB", "at most", (most(400),), "server_mb"),
            Line("and after ten results, MB", "after ten results", (), "server_mb"),
            Line("pictures a second, gestures", "gesture screen", (least(28),), "pictures_per_s"),
            Line("with View beside it", "gesture screen, View beside it", (), "pictures_per_s"),
            Line("click to effect, ms (median)", "gesture screen", (most(60),), "click_p50_ms"),
        ),
    ),
)

_LIVE = (
    Page(
        "live",
        """Four virtual cameras send motion JPEG over the loopback, in a process of their own, and everything runs on
        the same processor: synthetic people of another shape space than the tracker's, whose bodies are fitted while
        they are followed. Errors are compared with those of `hypose track` frame by frame on the same pictures.""",
        lines=(
            Line("poses a second, 640 x 480 at 30", "480p/30", (least(29),), "poses_per_second"),
            Line("latency there, ms (median)", "480p/30", (most(40),), "latency_p50_ms"),
            Line("latency there, ms (99 %)", "480p/30", (most(80),), "latency_p99_ms"),
            Line("poses a second, 640 x 480 at 60", "480p/60", (), "poses_per_second"),
            Line("instants skipped there, %", "480p/60", (most(50),), "skipped"),
            Line("poses a second, 1920 x 1080 at 30", "1080p/30", (least(20),), "poses_per_second"),
            Line("error over that of `hypose track`, walk", "walk", (most(1.25),), "error_ratio"),
            Line("the same, combo", "combo", (most(1.25),), "error_ratio"),
            Line("the same, with faults", "faults", (most(1.25),), "error_ratio"),
            Line("growth of memory in half an hour, MiB", "30 min", (most(20),), "memory_growth_mib"),
            Line("poses lost beside a slow listener", "slow client", (most(0),), "frames_lost"),
        ),
    ),
)

SECTIONS: dict[str, tuple[Page, ...]] = {
    "Several cameras": SEVERAL_CAMERAS,
    "Several people": PEOPLE_PAGES,
    "Who is who": WHO_IS_WHO,
    "Captured movement": CAPTURED,
    "Bodies": BODIES,
    "Calibration, faults, timing": _CAMERAS,
    "Live": _LIVE,
    "Depth sensors": _FUSION,
    "Gestures": _GESTURES,
    "One camera": _ONE_CAMERA,
    "Robustness": _ROBUSTNESS,
    "The page": _STUDIO,
}
"""The pages of all benchmarks by heading."""
