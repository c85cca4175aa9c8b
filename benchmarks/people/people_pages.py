"""What docs/benchmarks.md says of several people."""

from __future__ import annotations

from benchmarks.bench_tables import Column, Line, Page, least, most

_PEOPLE = Page(
    "people",
    """Two and three people in the same masks (4 s, level-1 corruption of the union), nothing given, beside each person
    alone by the product. Closest distances: 0.7 m crossing, 0.75 m
    round somebody who stands, 1.0 m side by side, 0.7 m past somebody who sits down, or who stays while the other
    is away for a second, 0.75 m among three, 0.55 m, arms that touch. Chosen on the seeds below 10, 200, 201,
    310, 420, touching of 430, hulls of children of 430, 431, the second fit on 431, 432, 440 to 444, sitting of
    450, returning and beside of 451. Time: processor's, without the start.""",
    (
        Column("mean, mm", "mean_mm", spread=True),
        Column("p95, mm", "p95_mm"),
        Column("alone, mm", "alone_mm"),
        Column("flagged, %", "flagged", scale=100),
        Column("over alone, mm", "over_alone_mm", spread=True),
        Column("count, share"),
    ),
    (
        *(Line(f"{n}, 4 cameras", f"{n}/4") for n in ("crossing", "around", "beside", "sitting", "returning", "three")),
        Line("close, 4 cameras", "close/4"),
        Line("touching, 4 cameras", "touching/4", (least(1, 3),)),
        Line("touching, with key points", "touching+keypoints/4", (most(22, 0),)),
        Line("from 0.7 m on, 4 cameras", "4 cameras", (most(5, 4),)),
        Line("from 0.7 m on, 5 cameras", "5 cameras", (most(2, 4),)),
        Line("from 0.7 m on, 8 cameras", "8 cameras"),
        Line("0.55 m, 4 cameras", "0.55 m, 4 cameras", (most(8, 4),)),
        Line("0.55 m, 5 cameras", "0.55 m, 5 cameras", (most(8, 4),)),
        Line("frames beyond 120 mm, from 0.7 m on", "all", (most(0, 5),), "frames_120"),
        Line("exchanges of identity, from 0.7 m on", "all", (most(0, 5),), "identity_swaps"),
        Line("people invented", "all", (most(0, 5),), "invented"),
        Line("found within 0.4 s", "all", (least(0.9, 5),), "births_found"),
        Line("found who is not there, from 0.7 m on", "all", (most(0, 5),), "births_false"),
        Line("at most 30 mm after 1 s", "both", (least(0.9, 5),), "start_ok"),
        Line("time, two people / twice one", "2", (most(1.25, 5),), "time_ratio"),
        Line("time, three people / three times one", "3", (most(1.25, 5),), "time_ratio"),
    ),
)

_PLAYERS = Page(
    "players",
    """Both people on the court of court-4: one serves, one walks, 80 px tall, cameras up to two frames late, 4 s. Late:
    tracked as they are; in step: after `hypose sync` from the same masks. Errors at the cameras' mean time. Silently
    wrong: more than 40 mm off and called good.""",
    (Column("mean, mm", "mean_mm", spread=True), Column("alone, mm", "alone_mm", spread=True), Column("count")),
    (
        *(Line(f"{who}, {case}", f"{who}/{case}") for case in ("late", "in step") for who in ("server", "walker")),
        Line("silently wrong, late", "late", (most(0, 2),), "silent"),
        Line("silently wrong, in step", "in step", (most(0, 2),), "silent"),
        Line("silently wrong, late, each alone", "late, alone", metric="silent"),
        Line("frames by which a lag is missed", "all", metric="offset_frames"),
    ),
)

_CLOTHES = Page(
    "clothes",
    """Twins of one body in clothes that are drawn by lot (in seed 330 alike), five cameras, 3.2 s: one leaves and the
    other comes to the same place a second later; or both leave and come back in each other's place. People who at the
    end are tracked under the other one's name, or not at all; pictures are rendered. Limits were chosen on seeds 20 to
    23.""",
    (Column("with pictures", "wrong", "{}/pictures"), Column("masks alone", "wrong", "{}/masks alone")),
    tuple(Line(case, case, (most(0),)) for case in ("another comes", "places exchanged")),
)

PEOPLE_PAGES = (_PEOPLE, _PLAYERS, _CLOTHES)
