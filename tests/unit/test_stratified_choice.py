"""Clusters, strata of a choice, and rays until they agree."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from leaflight.core.lights.stratified_choice import (
    Clusters,
    Demand,
    choose_by_strata,
    cumulate,
    cut_evenly,
    find_reach,
    gather_until_sure,
    in_order,
    sort_by_place,
)


def random_clusters(count: int, most: int) -> Clusters:
    rng = np.random.default_rng(count)
    weight = rng.uniform(0.1, 1.0, count)
    return Clusters.of(weight, rng.random((count, 3)), np.zeros((count, 3)), np.full(count, 0.25), cut_evenly(weight, most))


def test_clusters_are_runs_of_all_emitters():
    clusters = random_clusters(1000, 50)
    assert len(clusters) <= 50
    assert clusters.start[0] == 0
    assert clusters.start[-1] == 1000
    assert (np.diff(clusters.start) > 0).all()
    assert clusters.weight.max() < 2 * clusters.weight.mean()
    assert clusters.weight.sum() == pytest.approx(clusters.weight_end[-1])
    assert (clusters.square > 0.25).all()


def test_few_emitters_are_clusters_of_themselves():
    clusters = random_clusters(20, 50)
    every = np.arange(20)
    chosen, chance = clusters.choose(every, np.full(20, 0.5))
    assert np.array_equal(chosen, every)
    assert (chance == 1).all()
    assert (clusters.square == 0.25).all()


def test_emitters_are_chosen_within_their_cluster_by_weight():
    clusters = random_clusters(100, 10)
    cluster = np.repeat(np.arange(len(clusters)), 1000)
    chosen, chance = clusters.choose(cluster, np.tile((np.arange(1000) + 0.5) / 1000, len(clusters)))
    weight = np.diff(clusters.weight_end)
    assert chance == pytest.approx(weight[chosen] / clusters.weight[cluster])
    assert np.bincount(chosen) / 1000 == pytest.approx(weight / np.repeat(clusters.weight, np.diff(clusters.start)), abs=2e-3)


def test_reach_is_half_the_diagonal_of_a_texel():
    around = np.array([[x, y, 0] for y in (-1, 1) for x in (-1, 1)]) / np.sqrt(12)  # of a unit square: its Gauss points
    starts = (np.array([[5.0, 0, 0], [0, 7, 0]]) + np.array([[3.0], [0.5]])[:, :, None] * around[:, None, None]).reshape(4, 2, 2, 3)
    for points in (starts, starts[[0, 3]]):
        assert find_reach(points[:, 0].reshape(-1, 3), 2) == pytest.approx([3 / np.sqrt(2)] * 2)
        assert find_reach(points[:, 1].reshape(-1, 3), 2) == pytest.approx([0.5 / np.sqrt(2)] * 2)


def test_strata_give_each_cluster_its_part_of_the_choices():
    chances = np.array([[1.0, 0, 3, 0], [0, 0, 0, 2], [5, 5, 5, 5]])
    end = np.empty((3, 4))
    cumulate(chances, 0, end)
    rows = np.array([2, 0, 1, 0])
    step, cluster, chance, rest = choose_by_strata(end, rows, np.array([7, 0, 2, 9], np.uint32), 16, np.random.default_rng(1))
    assert all(sorted(one) == list(range(16)) for one in step.T)
    counts = np.stack([np.bincount(one, minlength=4) for one in cluster.reshape(16, 4).T])
    assert counts == pytest.approx(16 * (chances / chances.sum(axis=1, keepdims=True))[rows])
    assert pytest.approx((chances / chances.sum(axis=1, keepdims=True))[rows[:, None], cluster.reshape(16, 4).T]) == chance.reshape(16, 4).T
    assert rest.min() >= 0
    assert rest.max() <= 1
    assert 0.3 < rest.mean() < 0.7


def test_values_are_put_into_the_order_of_their_strata():
    step = np.array([[1, 2], [2, 0], [0, 1]])
    assert in_order(step, np.repeat(step.ravel()[:, None], 3, axis=1))[..., 0].tolist() == [[0, 0], [1, 1], [2, 2]]


class TestGathering:
    def gather(self, level: np.ndarray, noise: np.ndarray):
        """Rays of rows by these means and standard deviations; keeps what it was asked."""
        rng, asked = np.random.default_rng(1), []

        def gather(rows, span):
            asked.append((rows, span))
            value = level[rows] + noise[rows] * rng.normal(size=(span[1] - span[0], len(rows)))
            return np.repeat(value[..., None], 3, axis=2), value.size

        return gather, asked

    def test_rows_that_agree_stop_and_the_others_go_on(self):
        level, noise = np.full(256, 5.0), np.repeat([0.0, 1.0], 128)
        gather, _ = self.gather(level, noise)
        value, variance, traced = gather_until_sure(gather, np.arange(256), Demand(1e-3), np.zeros((256, 3)))
        assert traced == 128 * 4 + 128 * 64
        assert (value[:128] == 5).all()
        assert not variance[:128].any()
        assert variance[128:].mean() == pytest.approx(1 / 64, rel=0.1)
        assert value[128:].mean() == pytest.approx(5, abs=0.05)

    def test_what_other_light_outshines_may_be_noisy(self):
        gather, _ = self.gather(np.full(64, 1.0), np.full(64, 0.5))
        assert gather_until_sure(gather, np.arange(64), Demand(1e-3), np.full((64, 3), 1e4))[2] == 4 * 64

    def test_neighbours_of_a_doubtful_row_go_on_with_it(self):
        noise = np.zeros(256)
        noise[10] = 10.0
        gather, asked = self.gather(np.ones(256), noise)
        gather_until_sure(gather, np.arange(256), Demand(0.01), np.zeros((256, 3)))
        assert [(len(rows), span) for rows, span in asked] == [(256, (0, 4)), (64, (4, 16)), (64, (16, 64))]

    def test_even_noise_of_a_tile_is_left_to_smoothing(self):
        level = np.full(256, 1.0)
        level[128:160] = 1.5  # an edge through the second tile
        gather, asked = self.gather(level, np.full(256, 0.1))
        tiles = np.arange(64, 192).reshape(2, 64)
        gather_until_sure(gather, np.arange(256), Demand(0.025, 16, smoothed=tiles), np.zeros((256, 3)))
        assert [(len(rows), span) for rows, span in asked] == [(256, (0, 4)), (192, (4, 16))]

    def test_rows_that_found_nothing_by_chance_go_on_where_more_is_foreseen(self):
        """One ray in 500 finds all of the light: alone, and in tiles that are left to smoothing."""
        rng, chance, rows = np.random.default_rng(3), 2e-3, np.arange(64 * 64)

        def gather(rows, span):
            value = (rng.random((span[1] - span[0], len(rows))) < chance) / chance
            return np.repeat(value[..., None], 3, axis=2), value.size

        foreseen = np.ones(len(rows)), np.full(len(rows), 1 / chance)
        for smoothed in (np.zeros((0, 64), np.int64), rows.reshape(-1, 64)):
            demand, base, told, alone = Demand(0.05, smoothed=smoothed), np.zeros((len(rows), 3)), [], []
            for _ in range(16):
                value, _, traced = gather_until_sure(gather, rows, demand, base, foreseen=foreseen)
                assert traced == 64 * len(rows)
                told.append(value.mean())
                alone.append(gather_until_sure(gather, rows, demand, base)[0].mean())
            noise = np.sqrt(1 / chance / 64 / len(rows) / 16)
            assert np.mean(told) == pytest.approx(1.0, abs=3 * noise)
            assert np.mean(alone) < 1.0 - 5 * noise  # which is what it is for

    def test_where_little_noise_is_foreseen_nobody_goes_on_by_own_rays_alone(self):
        noise = np.zeros(256)
        noise[10] = 0.05
        gather, asked = self.gather(np.ones(256), noise)
        gather_until_sure(gather, np.arange(256), Demand(0.01), np.zeros((256, 3)), foreseen=(np.ones(256), np.zeros(256)))
        assert len(asked) == 1

    def test_rows_that_are_not_asked_do_not_calm_their_neighbours(self):
        """One noisy row asked in each block: beside rows without light of this kind, whose error is 0."""
        noise = np.zeros(256)
        noise[::2] = 0.5
        gather, asked = self.gather(np.ones(256), noise)
        gather_until_sure(gather, np.arange(0, 256, 2), Demand(0.018, 16), np.full((256, 3), 10.0))
        assert len(asked[1][0]) == 128

    def test_rows_with_nothing_to_gather_are_left_out(self):
        gather, _ = self.gather(np.ones(100), np.zeros(100))
        learned = []
        value, _, _ = gather_until_sure(gather, np.arange(50, 60), Demand(0.01), np.zeros((100, 3)), learn=learned.append)
        assert value[:, 0].nonzero()[0].tolist() == list(range(50, 60))
        assert [rows.tolist() for rows in learned] == [[]]
        assert gather_until_sure(gather, np.arange(0), Demand(0.01), np.zeros((100, 3)))[2] == 0


def test_emitters_are_sorted_by_facing_first():
    centre = np.random.default_rng(1).random((100, 3)) - 0.5
    normal = np.eye(3)[np.arange(100) % 3] * np.where(np.arange(100) % 2, 1, -1)[:, None]
    order = sort_by_place(centre, normal)
    facing = [tuple(normal[i]) for i in order]
    assert sum(a != b for a, b in pairwise(facing)) == 5
    assert sorted(order.tolist()) == list(range(100))
