"""List the papers behind a method, to be cited with its results; also as BibTeX."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hypose import __version__
from hypose.errors import InputError
from hypose.io.files import read_json


@dataclass(frozen=True)
class Paper:
    """Work to cite.

    key, kind: of the BibTeX entry.
    authors: joined by " and ".
    where: journal, conference or school with volume and pages, by BibTeX field.
    """

    key: str
    kind: str
    authors: str
    year: int
    title: str
    where: tuple[tuple[str, str], ...] = ()

    @property
    def text(self) -> str:
        """The work as one line of a list of references."""
        names = self.authors.split(" and ")
        listed = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
        return f"{listed} ({self.year}). {self.title}. {', '.join(v for _, v in self.where)}."

    @property
    def bibtex(self) -> str:
        """The work as an entry of a .bib file."""
        fields = [("author", self.authors), ("title", f"{{{self.title}}}"), ("year", str(self.year)), *self.where]
        return f"@{self.kind}{{{self.key},\n" + "".join(f"  {k} = {{{v}}},\n" for k, v in fields) + "}"


_WORKS = [
    Paper(
        "hypose",
        "software",
        "The hypose developers",
        2026,
        "hypose: human motion from ordinary cameras",
        (("version", f"version {__version__}"),),
    ),
    Paper(
        "alcoverro2014",
        "phdthesis",
        "Alcoverro, M.",
        2014,
        "Stochastic optimization and interactive machine learning for human motion analysis",
        (("school", "Universitat Politècnica de Catalunya"),),
    ),
    Paper(
        "deutscher2005",
        "article",
        "Deutscher, J. and Reid, I.",
        2005,
        "Articulated body motion capture by stochastic search",
        (("journal", "International Journal of Computer Vision"), ("volume", "61(2)"), ("pages", "185-205")),
    ),
    Paper(
        "isard1998",
        "article",
        "Isard, M. and Blake, A.",
        1998,
        "CONDENSATION: conditional density propagation for visual tracking",
        (("journal", "International Journal of Computer Vision"), ("volume", "29(1)"), ("pages", "5-28")),
    ),
    Paper(
        "maccormick2000",
        "inproceedings",
        "MacCormick, J. and Isard, M.",
        2000,
        "Partitioned sampling, articulated objects, and interface-quality hand tracking",
        (("booktitle", "European Conference on Computer Vision"), ("pages", "3-19")),
    ),
    Paper(
        "asteriadis2013",
        "inproceedings",
        "Asteriadis, S. and Chatzitofis, A. and Zarpalas, D. and Alexiadis, D. S. and Daras, P.",
        2013,
        "Estimating human motion from multiple Kinect sensors",
        (("booktitle", "MIRAGE 2013, Berlin"),),
    ),
    Paper(
        "sminchisescu2001",
        "techreport",
        "Sminchisescu, C. and Triggs, B.",
        2001,
        "A robust multiple hypothesis approach to monocular human motion tracking",
        (("institution", "INRIA"), ("number", "Rapport de recherche 4208")),
    ),
    Paper(
        "saffari2009",
        "inproceedings",
        "Saffari, A. and Leistner, C. and Santner, J. and Godec, M. and Bischof, H.",
        2009,
        "On-line random forests",
        (("booktitle", "ICCV Workshops"), ("pages", "1393-1400")),
    ),
]
PAPERS = {paper.key: paper for paper in _WORKS}
"""Works by the key of their BibTeX entry."""

_THESIS, _SWARM = ("alcoverro2014",), ("asteriadis2013",)
METHODS: dict[str, tuple[str, ...]] = {
    "default": _THESIS,
    "sir": ("isard1998",),
    "apf": ("deutscher2005",),
    "partitioned": ("maccormick2000",),
    **dict.fromkeys(("hpf", "hpf+", "hpf-apo", "hpf-apo+", "dd-hpf", "dd-hpf+", "dd-hpf+5", "dd-hpf+rivals"), _THESIS),
    "subject": _THESIS,
    "monocular": ("sminchisescu2001",),
    **dict.fromkeys(("fusion-fit", "fusion-swarm", "fusion-published", "fusion-published-window"), _SWARM),
    "gesture": (*_THESIS, "saffari2009"),
}
"""Keys of the works behind each method, without hypose itself."""


def papers_of(name: str) -> tuple[Paper, ...]:
    """List the works to cite for a method by its name, or for a results folder by its provenance; hypose first.

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
    return tuple(PAPERS[key] for key in ("hypose", *METHODS.get(method, ())))  # other baselines are textbook filters


def formatted_papers(papers: Sequence[Paper], bibtex: bool) -> str:
    """Format works as text, or as BibTeX."""
    return "\n\n".join(p.bibtex for p in papers) if bibtex else "\n".join(p.text for p in papers)
