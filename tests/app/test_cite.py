"""`hypose cite`: papers by method and by results, and BibTeX that has every field."""

import pytest

from hypose.app.jobs.cite import papers_of
from hypose.errors import InputError
from hypose.fusion.fuse import FUSION_METHODS
from hypose.tracking.recipes import RECIPES


def test_every_recipe_and_fusion_has_its_papers():
    for name in (*RECIPES, *(f"fusion-{m}" for m in FUSION_METHODS)):
        assert papers_of(name)[0].key == "hypose"
    assert {"alcoverro2014"} == {p.key for p in papers_of("hpf")[1:]}


def test_bibtex(hypose):
    code, out, _ = hypose("cite", "gesture", "--bibtex")
    assert code == 0
    assert out.count("@") == 3 and out.count("{") == out.count("}")
    assert "@phdthesis{alcoverro2014," in out and "year = {2009}" in out


def test_what_is_no_method(tmp_path):
    (tmp_path / "provenance.json").write_text("{}")
    with pytest.raises(InputError, match="tells no method"):
        papers_of(str(tmp_path))
