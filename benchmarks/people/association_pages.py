"""What docs/benchmarks.md says of the benchmarks of who is who across views."""

from __future__ import annotations

from benchmarks.bench_tables import Column, Line, Page, least, most

MIXED_UP = (
    "sides exchanged, 10 %",
    "sides exchanged, 30 %",
    "sides exchanged, 1 s",
    "legs exchanged, 1 s",
    "another camera's",
    "two cameras exchanged",
    "bystander in one view",
    "bystander instead, 40 %",
    "bystander in all views",
    "mirror in two views",
)
"""The ways of `bench mixed-up`."""

WHO_IS_WHO = (
    Page(
        "shelf",
        """Belagiannis 2014, Shelf, from the detections that the authors of the 4D Association published (not part of
        this project): share of correct parts in 3D of each actor, missed people counted as wrong; all: mean of actors 0
        to 2, as it is published. Not everybody has truth in all frames. Time of one thread for a frame, five views.""",
        (Column("measured"),),
        (
            *(Line(f"actor {a}", f"actor {a}", metric="pcp") for a in range(4)),
            Line("**all**", "all", (least(97.2),), metric="pcp", more="97.4"),
            Line("changes of identity", "all", (most(0),), metric="identity_swaps"),
            Line("people without truth per frame", "all", metric="surplus"),
            Line("ms per frame", "5 views", (most(5),), metric="ms_per_frame"),
        ),
        "published (arXiv 2106.11589)",
    ),
    Page(
        "two-people",
        """The man of Pose2Sim's balancing clip with a second person beside him and an observer in two views (the trial
        of two people of Pose2Sim's repository, not part of this project), against the same man tracked alone. That film
        was cut and scaled otherwise, up to 11 px, and is laid onto the other by its still background first. Masks are
        made with the key points; both people are in them where they overlap.""",
        (Column("mean, mm", "man_mm"), Column("worst frame, mm", "largest_mm")),
        tuple(Line(e, e, (most(20),)) for e in ("keypoints", "both", "silhouettes")),
    ),
    Page(
        "mixed-up",
        """A person in four views, with detections mixed up in ten ways before the person is chosen: largest over the
        frames, and mean, of a frame's mean error over 15 joints, mm. Nothing is given; masks show the person alone.
        Settings were chosen on seeds below 10.""",
        (
            Column("key points, largest", "max_mm", "{}/keypoints", spread=True),
            Column("mean", "mean_mm", "{}/keypoints"),
            Column("both, largest", "max_mm", "{}/both", spread=True),
            Column("mean", "mean_mm", "{}/both"),
            Column("count, share"),
        ),
        (
            *(Line(way, way, (most(130), most(130, 2))) for way in MIXED_UP),
            *(Line(f"runs beyond 130 mm, {e}", e, metric="beyond_130") for e in ("keypoints", "both")),
            *(Line(f"share of them that is said, {e}", e, (least(1, 4),), "said") for e in ("keypoints", "both")),
        ),
    ),
)
