"""Hits that are kept in a folder until it can be told where their photons parted."""

from dataclasses import replace

import numpy as np
import pytest
from leaflight.core.transport.photon_log import ENERGY_NAMES, Counters, EnergyAudit, Groups, ShardHits
from leaflight.core.transport.photons_ahead import NotedPartings, fetch_hits, keep_hits


@pytest.fixture
def hits():
    rng = np.random.default_rng(1)
    nothing = np.zeros(3)
    groups = Groups(np.zeros(4, np.int32), np.ones(4, np.float32), np.arange(4), np.array([0, 1, 1, 2, 3], np.int32))
    return ShardHits(
        tri=np.arange(5, dtype=np.int32),
        u=rng.random(5, np.float32),
        v=rng.random(5, np.float32),
        flux_rgb=rng.random((3, 5), np.float32),
        is_first=np.zeros(5, bool),
        audit=EnergyAudit(*(nothing for _ in ENERGY_NAMES)),
        counters=Counters(10, 20, 5),
        groups=groups,
        elsewhere=np.zeros(0, np.int64),
    )


@pytest.fixture
def noted():
    noted, half = NotedPartings(), np.full(2, 0.5, np.float32)
    for first in (6, 8):
        tri = np.array([first, first + 1], np.int32)
        place, factor = noted(tri, half, half * tri)
        assert place.dtype == np.int32
        assert factor.tolist() == [1.0, 1.0]
    return noted


def test_as_many_part_everywhere_and_where_is_told_later(tmp_path, hits, noted):
    keep_hits(tmp_path / "kept", hits, noted)
    asked = []

    def split_at(tri, u, v):
        asked.append((tri.tolist(), u.tolist(), v.tolist()))
        return tri + np.int32(100), np.full(len(tri), 7.0, np.float32)

    found = fetch_hits(tmp_path / "kept", split_at)
    assert asked == [([6, 7, 8, 9], [0.5] * 4, [3.0, 3.5, 4.0, 4.5])]
    assert found.groups.place.tolist() == [106, 107, 108, 109]
    assert found.groups.split.tolist() == [1.0] * 4  # as they parted, whatever is wished now
    assert found.groups.owner.tolist() == hits.groups.owner.tolist()
    np.testing.assert_array_equal(found.flux_rgb, hits.flux_rgb)
    assert found.counters == hits.counters


def test_they_are_fetched_once(tmp_path, hits, noted):
    keep_hits(tmp_path / "kept", hits, noted)
    fetch_hits(tmp_path / "kept", None)
    assert not (tmp_path / "kept").exists()
    with pytest.raises(OSError, match="kept"):
        fetch_hits(tmp_path / "kept", None)


def test_hits_without_groups_are_as_they_were(tmp_path, hits):
    keep_hits(tmp_path / "kept", replace(hits, groups=None), None)
    found = fetch_hits(tmp_path / "kept", lambda tri, u, v: 1 / 0)
    assert found.groups is None
    assert found.tri.tolist() == hits.tri.tolist()
