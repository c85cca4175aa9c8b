"""List the papers behind a method, to be cited with its results; also as BibTeX."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hypose import __version__
from hypose.errors import InputError
from hypose.io.files import read_json

PAPERS: dict[str, tuple[str, dict[str, str]]] = {
    "hypose": (
        "software",
        {
            "author": "The hypose developers",
            "title": "hypose: human motion from ordinary cameras",
            "year": "2026",
            "version": f"version {__version__}",
        },
    ),
    "alcoverro2014": (
        "phdthesis",
        {
            "author": "Alcoverro, M.",
            "title": "Stochastic optimization and interactive machine learning for human motion analysis",
            "year": "2014",
            "school": "Universitat Politècnica de Catalunya",
        },
    ),
    "deutscher2005": (
        "article",
        {
            "author": "Deutscher, J. and Reid, I.",
            "title": "Articulated body motion capture by stochastic search",
            "year": "2005",
            "journal": "International Journal of Computer Vision",
            "volume": "61(2)",
            "pages": "185-205",
        },
    ),
    "isard1998": (
        "article",
        {
            "author": "Isard, M. and Blake, A.",
            "title": "CONDENSATION: conditional density propagation for visual tracking",
            "year": "1998",
            "journal": "International Journal of Computer Vision",
            "volume": "29(1)",
            "pages": "5-28",
        },
    ),
    "maccormick2000": (
        "inproceedings",
        {
            "author": "MacCormick, J. and Isard, M.",
            "title": "Partitioned sampling, articulated objects, and interface-quality hand tracking",
            "year": "2000",
            "booktitle": "European Conference on Computer Vision",
            "pages": "3-19",
        },
    ),
    "asteriadis2013": (
        "inproceedings",
        {
            "author": "Asteriadis, S. and Chatzitofis, A. and Zarpalas, D. and Alexiadis, D. S. and Daras, P.",
            "title": "Estimating human motion from multiple Kinect sensors",
            "year": "2013",
            "booktitle": "MIRAGE 2013, Berlin",
        },
    ),
    "sminchisescu2001": (
        "techreport",
        {
            "author": "Sminchisescu, C. and Triggs, B.",
            "title": "A robust multiple hypothesis approach to monocular human motion tracking",
            "year": "2001",
            "institution": "INRIA",
            "number": "Rapport de recherche 4208",
        },
    ),
    "saffari2009": (
        "inproceedings",
        {
            "author": "Saffari, A. and Leistner, C. and Santner, J. and Godec, M. and Bischof, H.",
            "title": "On-line random forests",
            "year": "2009",
            "booktitle": "ICCV Workshops",
            "pages": "1393-1400",
        },
    ),
}
"""Works by the key of their BibTeX entry: its kind and its fields, authors joined by " and "."""

_THESIS, _SWARM = ("alcoverro2014",), ("asteriadis2013",)
METHODS: dict[str, tuple[str, ...]] = {
    "default": _THESIS,
    "sir": ("isard1998",),
    "apf": ("deutscher2005",),
    "partitioned": ("maccormick2000",),
    **dict.fromkeys(("hpf", "hpf+", "hpf-apo", "dd-hpf", "dd-hpf+", "dd-hpf+5", "dd-hpf+rivals"), _THESIS),
    "subject": _THESIS,
    "monocular": ("sminchisescu2001",),
    **dict.fromkeys(("fusion-fit", "fusion-swarm", "fusion-published", "fusion-published-window"), _SWARM),
    "gesture": (*_THESIS, "saffari2009"),
}
"""Keys of the works behind each method, without hypose itself."""


def papers_of(name: str) -> tuple[str, ...]:
    """List the keys of the works to cite, hypose first.

    name: name of a method, or a results folder, whose provenance names the method.
    Raises: InputError lists the methods.
    """
    path, method = Path(name), name
    if name not in METHODS and (path.is_dir() or path.suffix == ".json"):
        path = path / "provenance.json" if path.is_dir() else path
        try:
            method = str(read_json(path, "a provenance.json")["recipe"])
        except (KeyError, TypeError) as error:
            raise InputError(
                f"{path} tells no method ({error}); give a folder that hypose track or fuse wrote, or a method's name."
            ) from None
    if method not in METHODS and not method.startswith("fusion-"):
        raise InputError(
            f"There is no method or results folder {name!r}; give a folder that hypose track or fuse wrote, or one of "
            f"{', '.join(METHODS)}."
        )
    return ("hypose", *METHODS.get(method, ()))  # other baselines are textbook filters


def formatted_papers(keys: Sequence[str], bibtex: bool) -> str:
    """Format works (papers) as a list of references, one per line, or as BibTeX.

    keys: keys of the works.
    """
    out = []
    for key in keys:
        kind, fields = PAPERS[key]
        if bibtex:
            values = {**fields, "title": f"{{{fields['title']}}}"}
            out.append(f"@{kind}{{{key},\n" + "".join(f"  {k} = {{{v}}},\n" for k, v in values.items()) + "}\n")
        else:
            *others, last = fields["author"].split(" and ")
            authors = f"{', '.join(others)} and {last}" if others else last
            out.append(f"{authors} ({fields['year']}). {fields['title']}. {', '.join([*fields.values()][3:])}.")
    return "\n".join(out).rstrip()
