"""What docs/benchmarks.md says of captured movement seen through real cameras."""

from __future__ import annotations

from benchmarks.bench_plot import Panels
from benchmarks.bench_tables import Column, Line, Page, most, within

CAPTURED = (
    Page(
        "cameras",
        """Captured walking, running, boxing (CMU, on other bodies) and a run measured by Vicon, through three cameras
        of three real calibrations; key points err by 4 px of the pictures, slowly, with outliers, gaps and exchanged
        sides. Mean error of 12 limb joints without a constant offset of each, the body from the clip itself. In uu4cam
        the person is a third as large: its regions are too small, those of the others too large.""",
        (
            Column("mean error, mm", "mean_mm", spread=True),
            Column("with offsets", "raw_mm"),
            Column("triangulated", "triangulation_mm"),
            Column("sides mended", "triangulation_mm", "{}, sides mended"),
            Column("Pose2Sim's method", "pose2sim_mm"),
            Column("in 90 % regions", "coverage_90", scale=100),
        ),
        (
            Line("all", "all", (most(16), within(85, 95, 5))),
            *(Line(a, a) for a in ("walk", "run", "box", "vicon-run", "balancing", "uu4cam", "human4d")),
        ),
        picture=Panels(("mean_mm", "triangulation_mm", "coverage_90")),
    ),
    Page(
        "gait",
        """CMU's walk overground on ten bodies, three cameras, the same errors: distance of the events in frames (60/s)
        from those of the captured feet by the same definition, of step lengths in mm, and how many lie in their 90 %
        intervals. Last lines: the definition itself on another person's markers, against force plates (three events;
        the heel overhangs the edge of the plate, which makes its strike late).""",
        lines=(
            Line("foot strikes, median, frames", "all", (most(1),), "foot_strike_frames"),
            Line("feet leave the ground, median, frames", "all", (most(1),), "foot_off_frames"),
            Line("step length, median", "all", (most(15),), "step_length_mm"),
            Line("in 90 % intervals, %", "all", (within(85, 95),), "coverage_90", scale=100),
            Line("of strikes, %", "strike", metric="coverage_90", scale=100),
            Line("of step lengths, %", "step length", metric="coverage_90", scale=100),
            Line("events not found, %", "all", metric="missed", scale=100),
            Line("events invented, %", "all", metric="invented", scale=100),
            Line("strike, from the force plate, frames", "force plates", metric="foot_strike_bias_frames"),
            Line("off, from the force plates, frames", "force plates", metric="foot_off_bias_frames"),
        ),
        picture=Panels(("coverage_90", "foot_strike_frames", "step_length_mm")),
    ),
    Page(
        "caliscope",
        """A public recording of Caliscope: a person behind a desk, four webcams without a trigger, MediaPipe's points
        without scores and no pictures. Each camera left out in turn: median distance there, in pixels, of what the
        other three say; theirs are the same points triangulated as Caliscope does. Last column: distance of our
        body's points, and of our form of its triangulation, from the 3D file that it wrote.""",
        (
            Column("camera left out, px", "loco_px"),
            Column("shoulders to wrists, px", "loco_px", "{}, arms"),
            Column("from their file, mm", "agreement_mm"),
        ),
        (
            Line("hypose", "hypose", (most(1.0, 0, "caliscope"),)),
            Line("Caliscope's triangulation", "caliscope"),
        ),
        picture=Panels(("loco_px",)),
    ),
)
