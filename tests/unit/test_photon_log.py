"""What a shard reports, put together from pieces."""

import numpy as np
from leaflight.core.transport.photon_log import PhotonLog, SideHits

RED = np.float32([[1.0], [0.0], [0.0]])


def deposit(log, tri, group=None):
    count = len(tri)
    place = np.linspace(0, 1, count, dtype=np.float32)
    log.deposit(np.array(tri, np.int32), place, 1 - place, RED.repeat(count, axis=1), np.full(count, group is None), group)


def test_pieces_follow_each_other():
    log = PhotonLog()
    log.photons = 4
    for watts, sums in enumerate((log.emitted, log.absorbed, log.escaped, log.remainder)):
        sums += watts
    log.count_rays(3, None)
    log.count_rays(2, None)
    deposit(log, [3, 1])
    deposit(log, [2])
    hits = log.take()
    assert hits.tri.tolist() == [3, 1, 2]
    assert hits.u.tolist() == [0, 1, 0]
    assert hits.flux_rgb.shape == (3, 3)
    assert hits.is_first.all()
    assert (hits.counters.photons, hits.counters.rays, hits.counters.deposits) == (4, 5, 3)
    assert [watts[0] for watts in (hits.audit.emitted, hits.audit.absorbed, hits.audit.escaped, hits.audit.remainder)] == [0, 1, 2, 3]
    assert hits.groups is None


def test_groups_are_numbered_on_and_own_rays_and_deposits():
    log = PhotonLog()
    for place, split in ((7, 0.5), (9, 2.0)):
        own = log.open_groups(np.full(2, place, np.int32), np.full(2, split, np.float32))
        several = own.repeat(3)
        log.count_rays(6, several)
        deposit(log, [0, 0], several[2:4])
    groups = log.take().groups
    assert groups.place.tolist() == [7, 7, 9, 9]
    assert groups.split.tolist() == [0.5, 0.5, 2.0, 2.0]
    assert groups.rays.tolist() == [3, 3, 3, 3]
    assert groups.owner.tolist() == [0, 1, 2, 3]


def test_some_deposits_alone_keep_what_is_theirs():
    log = PhotonLog()
    group = log.open_groups(np.int32([4, 5]), np.ones(2, np.float32)).repeat(2)
    log.count_rays(4, group)
    deposit(log, [7, 8, 9, 6], group)
    hits = log.take()
    some = hits.only(np.array([1, 2]))
    assert some.tri.tolist() == [8, 9]
    assert [some.u.tolist(), some.v.tolist()] == [hits.u[1:3].tolist(), hits.v[1:3].tolist()]
    assert [some.flux_rgb.shape, some.is_first.shape] == [(3, 2), (2,)]
    assert some.groups.owner.tolist() == [0, 1]
    assert some.groups.rays.tolist() == [2, 2]
    assert some.counters == hits.counters


def test_a_shard_without_photons_has_all_fields():
    hits = PhotonLog().take()
    assert [len(hits.tri), hits.flux_rgb.shape, hits.groups] == [0, (3, 0), None]
    log = PhotonLog()
    log.open_groups(np.zeros(1, np.int32), np.ones(1, np.float32))  # whose photons were all absorbed
    assert log.take().groups.rays.tolist() == [0]


def test_hits_on_sides_without_a_lightmap_are_kept_in_order():
    log = PhotonLog()
    assert log.take().elsewhere.tri.tolist() == []
    for tri in ([5, 2, 5], [], [2]):
        some = np.array(tri, np.float32)
        log.light_elsewhere(SideHits(np.array(tri, np.int32), some / 10, some / 20, some > 3, np.tile(some, (3, 1))))
    found = log.take().elsewhere
    assert found.tri.tolist() == [5, 2, 5, 2]
    assert found.is_front.tolist() == [True, False, True, False]
    np.testing.assert_array_equal(found.flux_rgb, np.float32([[5, 2, 5, 2]] * 3))
    assert log.take().elsewhere.tri.tolist() == []


def test_what_is_taken_before_the_end_is_not_told_again():
    """Groups are told with it once: what becomes of them later is a piece without."""
    log = PhotonLog()
    group = log.open_groups(np.int32([4, 5]), np.ones(2, np.float32))
    for tri, under_way in (([7, 8], group), ([9], group[1:])):
        log.photons += len(under_way)
        log.count_rays(len(under_way), under_way)
        log.emitted += 1.0
        deposit(log, tri, under_way)
        assert log.n_hit == len(tri)
        hits = log.take()
        assert (hits.tri.tolist(), hits.audit.emitted.tolist()) == (tri, [1.0] * 3)
        assert (hits.counters.photons, hits.counters.rays, hits.counters.deposits) == (len(tri),) * 3
        assert (hits.groups is None) == (tri == [9])
    assert log.n_hit == 0
