"""Targets of the benchmarks: which kept figures docs/benchmarks.md shows, and what each is held to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

Rows = Mapping[tuple[str, str], Mapping[str, Any]]
"""The rows of a benchmark's document by (metric, case)."""


@dataclass(frozen=True)
class Figure:
    """A figure of a benchmark's document and its target.

    metric, case: of its row in the document.
    at_least, at_most: the target in the row's unit; None where there is none.
    of: case of the same metric whose value the target is multiplied by; empty for none.
    ratio: the target is for the row's ratio to its baseline, not for its value.
    """

    metric: str
    case: str
    at_least: float | None = None
    at_most: float | None = None
    of: str = ""
    ratio: bool = False

    def value(self, rows: Rows) -> float | None:
        """Return what the target is for; None when it was not measured or is not finite."""
        row = rows.get((self.metric, self.case))
        return None if row is None else row["ratio" if self.ratio else "value"]

    def met(self, rows: Rows) -> bool | None:
        """Return whether the target is reached; None without a target or without the figure."""
        if (self.at_least is None and self.at_most is None) or (self.metric, self.case) not in rows:
            return None
        value, scale = self.value(rows), 1.0
        if self.of:
            other = rows.get((self.metric, self.of))
            if other is None or other["value"] is None:
                return None
            scale = other["value"]
        if value is None:
            return False
        return (self.at_least is None or value >= scale * self.at_least) and (
            self.at_most is None or value <= scale * self.at_most
        )


@dataclass(frozen=True)
class Benchmark:
    """What the page says of a benchmark: its name, one phrase on what is measured, and its figures."""

    name: str
    says: str
    figures: tuple[Figure, ...]


TARGETS = (
    Benchmark(
        "product",
        "the default on synthetic walk, run, box and combo, four cameras, silhouettes; first pose given",
        (
            Figure("mean_error_mm", "default/all"),
            Figure("mean_error_mm", "default, estimated body/all", at_most=16),
            Figure("lost_share", "default, estimated body/all", at_most=0),
        ),
    ),
    Benchmark(
        "table-2.3",
        "Alcoverro 2014, table 2.3, synthetic clips of 10 s, four cameras; estimated body, first pose given",
        (
            Figure("mean_error_mm", "apf", at_most=60),
            Figure("mean_error_mm", "hpf", at_most=45),
            Figure("mean_error_mm", "hpf-apo"),
            Figure("difference_low_mm", "apf - hpf", at_least=0),
            Figure("difference_low_mm", "hpf - hpf-apo", at_least=0),
        ),
    ),
    Benchmark(
        "table-2.4",
        "Alcoverro 2014, table 2.4, synthetic clips of 10 s: hands, head and feet; estimated body, first pose given",
        (
            Figure("extremity_error_mm", "apf"),
            Figure("extremity_error_mm", "hpf"),
            Figure("extremity_error_mm", "dd-hpf"),
            Figure("extremity_error_mm", "dd-hpf+", at_most=40),
            Figure("difference_low_mm", "apf - hpf", at_least=0),
            Figure("difference_low_mm", "hpf - dd-hpf", at_least=0),
            Figure("difference_low_mm", "dd-hpf - dd-hpf+", at_least=0),
            Figure("extremity_error_mm", "dd-hpf+rivals", at_most=30),
        ),
    ),
    Benchmark(
        "error-model",
        "the probability that a joint is more than 100 mm off, silhouettes, seeds that nothing was fitted on",
        (
            Figure("auroc", "scenes", at_least=0.98),
            Figure("auroc", "scenes/arms", at_least=0.94),
            Figure("recall_150", "scenes/arms", at_least=0.93),
            Figure("frames_caught", "scenes", at_least=0.85),
            Figure("ece_p", "scenes", at_most=0.01),
            Figure("frames_flagged_good", "scenes, usual", at_most=0.1),
            Figure("auroc", "spoilt", at_least=0.9),
            Figure("not_good", "things in the masks", at_least=1),
            Figure("not_good", "wrong cameras", at_least=1),
        ),
    ),
    Benchmark(
        "arms",
        "elbows and wrists more than 100 or 150 mm off, held-out seeds",
        (
            Figure("wrong_100", "folded"),
            Figure("wrong_100", "all", at_most=0.04),
            Figure("wrong_150", "all", at_most=0.007),
            Figure("mean_error_mm", "all", at_most=17),
            Figure("arms_p95_mm", "all", at_most=60),
            Figure("wrong_100", "unsmoothed", at_most=0.08),
            Figure("wrong_100", "folded/colours", at_most=0.08),
            Figure("wrong_100", "serve", at_most=0.01),
            Figure("wrong_100", "ixmas-5/walk", at_most=0.05),
            Figure("wrong_100", "ixmas-5/punch", at_most=0.02),
            Figure("wrong_100", "demo", at_most=0.01),
            Figure("mean_error_mm", "demo", at_most=13.6),
            Figure("draw_difference_mm", "demo", at_most=40),
            Figure("draw_difference_mm", "balancing", at_most=40),
        ),
    ),
    Benchmark(
        "regions",
        "share of true joints inside the reported 90 % regions",
        (
            Figure("coverage_90", "torso", at_least=0.85, at_most=0.95),
            Figure("coverage_90", "arms", at_least=0.85, at_most=0.95),
            Figure("coverage_90", "legs", at_least=0.85, at_most=0.95),
            Figure("coverage_90", "head", at_least=0.85, at_most=0.95),
            Figure("coverage_90", "keypoints/torso", at_least=0.85, at_most=0.95),
            Figure("coverage_90", "keypoints/arms", at_least=0.85, at_most=0.95),
            Figure("coverage_90", "keypoints/legs", at_least=0.85, at_most=0.95),
            Figure("coverage_90", "keypoints/head", at_least=0.85, at_most=0.95),
            Figure("coverage_90", "both/torso", at_least=0.85, at_most=0.95),
            Figure("coverage_90", "both/arms", at_least=0.85, at_most=0.95),
            Figure("coverage_90", "both/legs", at_least=0.85, at_most=0.95),
            Figure("coverage_90", "both/head", at_least=0.85, at_most=0.95),
        ),
    ),
    Benchmark(
        "real-balancing",
        "Pose2Sim's balancing clip: 12 joints against triangulated key points; loco_px: in a camera left out",
        (
            Figure("loco_px", "pose2sim"),
            Figure("median_mm", "silhouettes", at_most=30),
            Figure("p95_mm", "silhouettes", at_most=80),
            Figure("median_mm", "keypoints", at_most=12),
            Figure("median_mm", "both", at_most=12),
            Figure("bone_sd_mm", "both", at_most=2),
            Figure("iou", "both", at_least=0.83),
            Figure("loco_px", "both", at_most=0.95, ratio=True),
        ),
    ),
    Benchmark(
        "detector",
        "videos alone, points and masks of hypose's detector",
        (
            Figure("median_mm", "both", at_most=16),
            Figure("iou", "both", at_least=0.82),
            Figure("loco_px", "both", at_most=12),
            Figure("error_mm", "both", at_most=1.2, ratio=True),
            Figure("loco_px", "both/another detector's", at_most=12),
        ),
    ),
    Benchmark(
        "regions-real",
        "share of left-out measurements inside the 90 % regions, real recordings",
        (
            Figure("coverage_90", "keypoints/camera left out", at_least=0.75, at_most=0.97),
            Figure("coverage_90", "both/camera left out", at_least=0.75, at_most=0.97),
            Figure("coverage_90", "sensors/45", at_least=0.75, at_most=0.97),
            Figure("coverage_90", "sensors/90", at_least=0.75, at_most=0.97),
        ),
    ),
    Benchmark(
        "real-opensim",
        "OpenSim's inverse kinematics on the exported model and markers",
        (
            Figure("marker_rmse_mm", "balancing", at_most=15),
            Figure("columns_missing", "balancing", at_most=0),
        ),
    ),
    Benchmark(
        "real-uu4cam",
        "masks of a real clip against a student's, and the visual hull against the masks",
        (
            Figure("mask_iou", "worst view", at_least=0.9),
            Figure("hull_iou", "worst view", at_least=0.85),
        ),
    ),
    Benchmark(
        "speed-scorer",
        "time to weigh one pose in one view of 640 x 480, as a share of OpenCV filling triangles",
        (
            Figure("ratio_to_opencv", "1t", at_most=0.016667),
            Figure("ratio_to_opencv", "2t", at_most=0.01),
            Figure("spearman_to_fine", "standing", at_least=0.999),
            Figure("spearman_to_fine", "walking", at_least=0.999),
        ),
    ),
    Benchmark(
        "speed-solve",
        "one solve of a frame: 4 views, 36 degrees of freedom, one thread",
        (
            Figure("ms_per_frame", "contours", at_most=8),
            Figure("ms_per_frame", "balancing", at_most=8),
            Figure("ms_per_frame", "keypoints", at_most=1),
            Figure("median_mm", "balancing", at_most=1.06, of="slow reference"),
        ),
    ),
    Benchmark(
        "speed-tracking",
        "whole tracking, four views, two cores",
        (
            Figure("frames_per_second", "masks:default/4", at_least=100),
            Figure("frames_per_second", "masks:hpf/4", at_least=6),
            Figure("frames_per_second", "masks:apf/4", at_least=6),
            Figure("frames_per_second", "480p:default/4", at_least=50),
            Figure("frames_per_second", "1080p:default/4", at_least=30),
            Figure("frames_per_second", "balancing 1080p:default/4", at_least=30),
            Figure("frames_per_second", "keypoints:clip/4", at_least=100),
            Figure("decode_ratio", "balancing 1080p", at_most=1.5),
            Figure("peak_memory_mib", "all", at_most=1024),
        ),
    ),
    Benchmark(
        "starts",
        "clips that begin seated, crouching or with arms anywhere: share that is right after one second",
        (
            Figure("right", "all"),
            Figure("right", "standing"),
            Figure("right", "crouching"),
            Figure("right", "seated"),
            Figure("right", "on a chair"),
        ),
    ),
    Benchmark(
        "people",
        "two and three people in the same masks; over_alone_mm: added error compared with each alone",
        (
            Figure("flagged", "touching/4", at_least=0.01),
            Figure("mean_mm", "touching+keypoints/4", at_most=22),
            Figure("over_alone_mm", "4 cameras", at_most=5),
            Figure("over_alone_mm", "5 cameras", at_most=2),
            Figure("over_alone_mm", "0.55 m, 4 cameras", at_most=8),
            Figure("over_alone_mm", "0.55 m, 5 cameras", at_most=8),
            Figure("frames_120", "all", at_most=0),
            Figure("identity_swaps", "all", at_most=0),
            Figure("invented", "all", at_most=0),
            Figure("births_found", "all", at_least=0.9),
            Figure("births_false", "all", at_most=0),
            Figure("start_ok", "both", at_least=0.9),
            Figure("time_ratio", "2", at_most=1.25),
            Figure("time_ratio", "3", at_most=1.25),
        ),
    ),
    Benchmark(
        "people-players",
        "two people on a court; silent: wrong by more than 40 mm and called good",
        (
            Figure("silent", "late", at_most=0),
            Figure("silent", "in step", at_most=0),
        ),
    ),
    Benchmark(
        "people-clothes",
        "people who are tracked under another's name after leaving and coming back",
        (
            Figure("wrong", "another comes/pictures", at_most=0),
            Figure("wrong", "places exchanged/pictures", at_most=0),
        ),
    ),
    Benchmark(
        "people-shelf",
        "Belagiannis 2014, Shelf, from published detections: correct parts (published: 97.4 %)",
        (
            Figure("pcp", "all", at_least=97.2),
            Figure("identity_swaps", "all", at_most=0),
            Figure("ms_per_frame", "5 views", at_most=5),
        ),
    ),
    Benchmark(
        "people-real",
        "a real clip with a second person, against the same man tracked alone",
        (
            Figure("man_mm", "keypoints", at_most=20),
            Figure("man_mm", "both", at_most=20),
            Figure("man_mm", "silhouettes", at_most=20),
        ),
    ),
    Benchmark(
        "cameras",
        "captured movement, three real camera rigs, key points with a detector's errors",
        (
            Figure("pose2sim_mm", "all"),
            Figure("triangulation_mm", "all"),
            Figure("mean_mm", "all", at_most=16),
            Figure("coverage_90", "all", at_least=0.85, at_most=0.95),
        ),
    ),
    Benchmark(
        "cameras-gait",
        "foot strikes and step lengths, ten bodies, three cameras, against the captured feet",
        (
            Figure("foot_strike_frames", "all", at_most=1),
            Figure("foot_off_frames", "all", at_most=1),
            Figure("step_length_mm", "all", at_most=15),
            Figure("coverage_90", "all", at_least=0.85, at_most=0.95),
        ),
    ),
    Benchmark(
        "real-caliscope",
        "four webcams without a trigger, MediaPipe's points: pixels in a camera left out",
        (Figure("loco_px", "hypose", at_most=1, of="caliscope"),),
    ),
    Benchmark(
        "body",
        "body measures of 23 subjects from five cameras, without a height",
        (
            Figure("segment_error_cm", "motion", at_most=2),
            Figure("segment_error_cm", "one_pose", at_most=2.5),
            Figure("shoulder_height_error_cm", "all", at_most=1.5),
            Figure("girth_error_pct", "all", at_most=10),
            Figure("min_view_iou", "all", at_least=0.9),
            Figure("seconds_per_subject", "all", at_most=60),
            Figure("tracking_error_mm", "fitted/all", at_most=30),
            Figure("tracking_gain", "all", at_least=0.25),
            Figure("tracking_gain", "worst", at_least=-0.05),
        ),
    ),
    Benchmark(
        "body-real",
        "the balancing clip with a body from silhouettes alone",
        (
            Figure("median_mm", "start from key points", at_most=50),
            Figure("median_mm", "start from the hull", at_most=50),
        ),
    ),
    Benchmark(
        "calibration",
        "boards before five cameras, 0.25 px of noise, worst camera",
        (
            Figure("focal_error_px", "9x6 board"),
            Figure("position_error_mm", "9x6 board"),
            Figure("rms_px", "uu4cam"),
        ),
    ),
    Benchmark(
        "boardless",
        "cameras found from one walking person, largest error of all rigs",
        (
            Figure("turn_deg_largest", "known", at_most=0.5),
            Figure("place_mm_largest", "known", at_most=40),
            Figure("place_by_height_mm_largest", "known", at_most=80),
            Figure("lag_frames_largest", "known", at_most=0.15),
            Figure("up_deg_largest", "known", at_most=1),
            Figure("seconds", "known", at_most=40),
            Figure("turn_deg_largest", "unknown", at_most=0.7),
            Figure("place_mm_largest", "unknown", at_most=100),
            Figure("focal_pct_largest", "unknown", at_most=3.5),
            Figure("lag_frames_largest", "unknown", at_most=0.15),
            Figure("up_deg_largest", "unknown", at_most=1),
            Figure("turn_deg_largest", "balancing", at_most=1),
            Figure("place_mm_largest", "balancing", at_most=50),
        ),
    ),
    Benchmark(
        "calibration-faults",
        "planted faults found in recordings; half of the recordings are healthy",
        (
            Figure("verdict_precision", "all", at_least=0.95),
            Figure("verdict_recall", "all", at_least=0.95),
        ),
    ),
    Benchmark(
        "calibration-real",
        "the balancing clip as shipped and with cameras refined from the person",
        (
            Figure("refined_residual_px", "keypoints", at_most=7),
            Figure("refined_residual_px", "silhouettes", at_most=7.5),
            Figure("left_out_px", "silhouettes", at_most=0.6, ratio=True),
        ),
    ),
    Benchmark(
        "calibration-sync",
        "offsets of up to five frames between four cameras, largest error",
        (
            Figure("sync_error_largest_frames", "walk, keypoints", at_most=0.2),
            Figure("sync_error_largest_frames", "walk, silhouettes", at_most=0.2),
            Figure("sync_error_largest_frames", "walk, both", at_most=0.2),
            Figure("sync_error_largest_frames", "arms, keypoints", at_most=0.2),
            Figure("sync_error_largest_frames", "arms, silhouettes", at_most=0.2),
            Figure("sync_error_largest_frames", "arms, both", at_most=0.2),
        ),
    ),
    Benchmark(
        "live",
        "four virtual cameras over the network loopback, same processor",
        (
            Figure("poses_per_second", "480p/30", at_least=29),
            Figure("latency_p50_ms", "480p/30", at_most=40),
            Figure("latency_p99_ms", "480p/30", at_most=80),
            Figure("skipped", "480p/60", at_most=50),
            Figure("poses_per_second", "1080p/30", at_least=20),
            Figure("error_ratio", "walk", at_most=1.25),
            Figure("error_ratio", "combo", at_most=1.25),
            Figure("error_ratio", "faults", at_most=1.25),
            Figure("memory_growth_mib", "30 min", at_most=20),
            Figure("frames_lost", "slow client", at_most=0),
        ),
    ),
    Benchmark(
        "fusion-table-1",
        "Asteriadis 2013, table 1, simulated sensors: share of correct majorities (published: 0.833 to 0.95)",
        (
            Figure("success", "swarm/A/t50", at_least=0.9),
            Figure("success", "swarm/A/t100", at_least=0.9),
            Figure("success", "swarm/A/adaptive", at_least=0.9),
            Figure("success", "swarm/B/t50", at_least=0.95),
            Figure("success", "swarm/B/t100", at_least=0.92),
            Figure("success", "swarm/B/adaptive", at_least=0.95),
        ),
    ),
    Benchmark(
        "fusion-human4d",
        "distance of 15 joints from the truth, against the best single sensor in hindsight",
        (
            Figure("mpjpe_mm", "A/fit", at_most=0.6, of="A/best_single"),
            Figure("mpjpe_mm", "B/fit", at_most=0.6, of="B/best_single"),
            Figure("mpjpe_mm", "H/fit", at_most=0.6, of="H/best_single"),
        ),
    ),
    Benchmark(
        "fusion-real",
        "two Kinect v2 on one person: distance between the sensors' joints after registration",
        (
            Figure("agreement_mm", "parallel", at_most=13),
            Figure("agreement_mm", "45", at_most=26),
            Figure("agreement_mm", "90", at_most=49),
            Figure("agreement_mm", "parallel/causal", at_most=14),
            Figure("agreement_mm", "45/causal", at_most=35),
            Figure("agreement_mm", "90/causal", at_most=61),
            Figure("agreement_mm", "45/even", at_most=31),
            Figure("coverage_90", "45", at_least=0.75, at_most=0.97),
            Figure("coverage_90", "90", at_least=0.75, at_most=0.97),
            Figure("not_good", "occlusion or two people", at_least=0.8),
            Figure("untrusted", "one person", at_most=0.5),
            Figure("bone_sd_mm", "fit", at_most=3),
            Figure("jitter_mm", "fit", at_most=1, of="mean"),
        ),
    ),
    Benchmark(
        "fusion-speed",
        "15 joints, 3 sensors, one core",
        (
            Figure("ms_per_frame", "fit", at_most=0.3),
            Figure("ms_per_frame", "swarm", at_most=1),
            Figure("ms_per_frame", "swarm/improved", at_most=1),
            Figure("ms_per_frame", "restart", at_most=5),
            Figure("ms_per_frame", "restart/improved", at_most=5),
            Figure("ms_per_frame", "6_persons", at_most=33),
            Figure("latency_p99_ms", "all", at_most=20),
        ),
    ),
    Benchmark(
        "depth",
        "simulated depth cameras, captured motion: 15 joints",
        (
            Figure("mean_mm", "sdk/two"),
            Figure("mean_mm", "one", at_most=45),
            Figure("ms_per_frame", "one", at_most=8),
            Figure("mean_mm", "two", at_most=28),
            Figure("registration_deg", "two", at_most=0.5),
            Figure("registration_mm", "two", at_most=15),
            Figure("ms_per_frame", "two", at_most=8),
            Figure("latency_p99_ms", "two", at_most=50),
            Figure("mean_mm", "three", at_most=22),
            Figure("ms_per_frame", "three", at_most=8),
            Figure("mean_mm", "one+colour", at_most=1, of="one"),
            Figure("mean_mm", "one+colour", at_most=1, of="colour alone"),
            Figure("coverage_90", "all", at_least=0.85, at_most=0.95),
        ),
    ),
    Benchmark(
        "gesture-table-3.1",
        "Alcoverro 2014, table 3.1, simulated: area under the curve by clipping distance",
        (
            Figure("auc", "clipped_15", at_least=1.3, of="unclipped"),
            Figure("auc", "clipped_15/tee", at_least=2, of="unclipped/tee"),
        ),
    ),
    Benchmark(
        "gesture-table-3.2",
        "Alcoverro 2014, table 3.2, simulated: average precision at 10 px (published: 0.69)",
        (
            Figure("mean_ap", "online_hard", at_least=0.88),
            Figure("mean_ap", "online_hard_published"),
            Figure("ap_difference_low", "online_hard_published - online_random_as_many", at_least=0),
            Figure("ap_difference_low", "online_random_as_many - offline_boosted", at_least=0),
        ),
    ),
    Benchmark(
        "gesture-table-3.3",
        "Alcoverro 2014, table 3.3: three sessions of three minutes",
        (
            Figure("ap_5cm", "interactive/9min"),
            Figure("ap_5cm", "offline_published/9min"),
        ),
    ),
    Benchmark(
        "gesture-semi-synthetic",
        "real depth crops of 24 hand signs in simulated rooms",
        (Figure("mean_ap", "letters", at_least=0.8),),
    ),
    Benchmark(
        "gesture-speed",
        "one thread, 640 x 480, 15 trees",
        (
            Figure("detect_ms", "one", at_most=5),
            Figure("detect_ms", "six", at_most=33),
            Figure("train_frames_per_second", "all", at_least=100),
            Figure("model_mb", "all", at_most=10),
        ),
    ),
    Benchmark(
        "gesture-false-alarms",
        "ten minutes of free movement without gestures",
        (
            Figure("false_alarms_per_minute", "hard/recursion"),
            Figure("holds_found", "hard/recursion"),
        ),
    ),
    Benchmark(
        "mono-arm",
        "one camera, an arm of 7 degrees of freedom, 8 s; runs of twenty whose hand is kept",
        (
            Figure("mean_error_mm", "robust_3/whole_clip", at_most=80),
            Figure("hand_kept", "robust_3/whole_clip", at_least=16),
            Figure("mean_error_mm", "gaussian_1"),
        ),
    ),
    Benchmark(
        "mono-body",
        "one camera, 30 degrees of freedom, 1.2 s, pelvis aligned",
        (
            Figure("root_aligned_mm", "full"),
            Figure("root_aligned_mm", "superquadrics"),
            Figure("root_aligned_mm", "gaussian"),
        ),
    ),
    Benchmark(
        "mono-speed",
        "one core, 384 x 288 px",
        (
            Figure("seconds_per_frame", "arm", at_most=0.06),
            Figure("seconds_per_frame", "body", at_most=0.15),
        ),
    ),
    Benchmark(
        "mono-real",
        "one view of the balancing clip, pelvis aligned",
        (
            Figure("root_aligned_mm", "keypoints"),
            Figure("depth_mm", "keypoints"),
            Figure("root_aligned_mm", "edges"),
        ),
    ),
    Benchmark(
        "speed-start",
        "disk space, and time from the start of a process to the first pose",
        (
            Figure("install_mb", "core", at_most=500),
            Figure("cold_start_s", "track", at_most=90),
            Figure("cold_start_s", "fuse", at_most=90),
            Figure("warm_start_s", "track", at_most=1.5),
            Figure("warm_start_s", "fuse", at_most=1.5),
            Figure("warm_start_s", "help", at_most=1.5),
        ),
    ),
    Benchmark(
        "speed-short-clip",
        "processor time of `hypose track`, 100 frames of key points, four cameras",
        (
            Figure("cpu_s", "all", at_most=10),
            Figure("cpu_s", "trc", at_most=6),
        ),
    ),
    Benchmark(
        "speed-batch",
        "a hundred recordings on two workers; a worker killed twice",
        (
            Figure("speed_up", "two workers", at_least=1.8),
            Figure("identical", "two kills", at_least=1),
        ),
    ),
    Benchmark(
        "studio",
        "the page in headless Chromium, processor only",
        (
            Figure("opens_s", "long result", at_most=3),
            Figure("opens_s", "slowest of ten", at_most=3),
            Figure("server_mb", "at most", at_most=400),
            Figure("pictures_per_s", "gesture screen", at_least=28),
            Figure("click_p50_ms", "gesture screen", at_most=60),
        ),
    ),
)
