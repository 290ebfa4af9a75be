"""Clusters, strata of a choice, and rays until they agree."""

from __future__ import annotations

import numpy as np
import pytest
from leaflight.core.lights.stratified_choice import (
    Clusters,
    Demand,
    choose_by_strata,
    cumulate,
    cut_evenly,
    gather_until_sure,
)


def random_clusters(count: int, most: int) -> Clusters:
    rng = np.random.default_rng(count)
    weight = rng.uniform(0.1, 1.0, count)
    return Clusters.of(weight, rng.random((count, 3)), np.zeros((count, 3)), np.full(count, 0.25), cut_evenly(weight, most))


def test_emitters_are_chosen_within_their_cluster_by_weight():
    clusters = random_clusters(100, 10)
    cluster = np.repeat(np.arange(len(clusters)), 1000)
    chosen, chance = clusters.choose(cluster, np.tile((np.arange(1000) + 0.5) / 1000, len(clusters)))
    weight = np.diff(clusters.weight_end)
    assert chance == pytest.approx(weight[chosen] / clusters.weight[cluster])
    assert np.bincount(chosen) / 1000 == pytest.approx(weight / np.repeat(clusters.weight, np.diff(clusters.start)), abs=2e-3)


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

    def test_rows_that_found_nothing_by_chance_go_on_where_more_is_foreseen(self):
        """One ray in 500 finds all of the light."""
        rng, chance, rows = np.random.default_rng(3), 2e-3, np.arange(64 * 64)

        def gather(rows, span):
            value = (rng.random((span[1] - span[0], len(rows))) < chance) / chance
            return np.repeat(value[..., None], 3, axis=2), value.size

        foreseen = np.ones(len(rows)), np.full(len(rows), 1 / chance)
        demand, base, told, alone = Demand(0.05), np.zeros((len(rows), 3)), [], []
        for _ in range(16):
            value, _, traced = gather_until_sure(gather, rows, demand, base, foreseen=foreseen)
            assert traced == 64 * len(rows)
            told.append(value.mean())
            alone.append(gather_until_sure(gather, rows, demand, base)[0].mean())
        noise = np.sqrt(1 / chance / 64 / len(rows) / 16)
        assert np.mean(told) == pytest.approx(1.0, abs=3 * noise)
        assert np.mean(alone) < 1.0 - 5 * noise  # which is what it is for
