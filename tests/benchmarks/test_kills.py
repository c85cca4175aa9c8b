"""What the benchmark of kills does to a cache, and how it judges."""

import numpy as np

from benchmarks.robustness.kills import damage


def contents(folder):
    return {p.name: p.read_bytes() if p.is_file() else None for p in folder.iterdir()}


def test_damage_is_done_to_some_files_and_follows_from_the_seed(tmp_path):
    ways = set()
    for seed in range(30):
        for name in ("a", "b"):
            (tmp_path / name / str(seed)).mkdir(parents=True)
            for k in range(6):
                (tmp_path / name / str(seed) / f"{k}.kernel").write_bytes(bytes([k]) * 40)
            damage(tmp_path / name / str(seed), np.random.default_rng(seed))
        before = {f"{k}.kernel": bytes([k]) * 40 for k in range(6)}
        after = contents(tmp_path / "a" / str(seed))
        assert after == contents(tmp_path / "b" / str(seed))
        changed = [n for n in before if after.get(n, b"gone") != before[n]]
        assert 0 < len(changed) <= 4
        ways |= {"gone" if n not in after else "folder" if after[n] is None else "bytes" for n in changed}
    assert ways == {"gone", "folder", "bytes"}
