"""The benchmark of the paper, whole at toy size, and its measure of error."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from boxes import lamp_scene
from leaflight.core import executors, workers
from leaflight.core.scene import Light, Material
from scenes import make_scene, moved, quad_mesh

sys.path.append(str(Path(__file__).resolve().parents[1] / "bench"))

import bench_paper
import paper_bakes
import paper_tables

TOY = bench_paper.Effort(size=48, square_size=32, figure_2=2e4, figure_3=3e4, sweep=1e4)
CAMERA = {"matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2.0], [0, 0, 0, 1]], "angle_rad": 0.6}


def square_scene():
    """figure2_square.blend, its sheet of two sides."""
    sheet = dataclasses.replace(moved(quad_mesh("Sheet", 4.0, 8.0), (0.5, -3.5, 1.0)), receives=False)
    lamp = Light("AREA", "Lamp", (0.5, 0.5, 2.0), power_rgb=(40.0,) * 3, size_m=(0.3, 0.3))
    return make_scene([quad_mesh("Square"), sheet], [lamp], [Material("Black", (0.0,) * 3)])


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    scenes = lamp_scene(), square_scene()
    yield bench_paper.measure_paper(tmp_path_factory.mktemp("paper"), *scenes, TOY, executors.InlineExecutor())
    workers.forget_folders()


def test_every_table_is_filled(measured):
    assert set(measured.tables) == {"figure 2", "figure 3", "leaves for the same error", "overhead", "hints", "knobs"}
    for table in measured.tables.values():
        assert table.rows
        assert all(len(row) == len(table.head) for row in table.rows)
        assert "nan" not in str(table)


def test_the_square_is_that_of_the_closed_form(measured):
    bake = measured.square["linear"]
    truth = paper_tables.square_irradiance(paper_tables.texel_positions(bake.stage))
    area = bake.stage.texels.texel_area
    arrived = (bake.values()[:, 0] * area).sum()
    assert arrived == pytest.approx((truth * area).sum(), rel=4 / np.sqrt(TOY.figure_2))
    assert len(bake.light.leaves) < len(measured.square["constant"].light.leaves)


def test_the_hierarchy_errs_less_than_the_fixed_mesh(measured):
    flat, constant = (measured.curves[name][-1] for name in ("flat", "constant"))
    assert flat.leaves > 2 * constant.leaves
    assert constant.nrmse < 0.7 * flat.nrmse


def test_the_paper_shows_stable_nodes_at_or_below_the_current_ones(measured):
    bake = measured.room["constant"].stage.bake(400_000)  # two rounds, so that there are split nodes
    current = np.flatnonzero(bake.light.tree.current)
    assert bake.light.tree.depth[current].max() > 0
    np.testing.assert_array_equal(np.sort(bake.show_stable(10**9)), current)
    shown = bake.leaf_of(bake.show_stable(8))
    below = ~bake.light.tree.current[shown]
    assert below.any()
    assert (bake.light.received[shown[below]] >= 8).all()


def test_noise_of_the_references_cancels():
    rng = np.random.default_rng(1)
    truth = rng.uniform(1.0, 2.0, (20_000, 3))
    noisy = [truth + rng.normal(0.0, 0.3, truth.shape) for _ in range(2)]
    reference = paper_bakes.Reference(*noisy, truth, truth[:, 0], np.ones(len(truth)))
    none, some = (reference.measure(truth * (1 + error)) for error in (0.0, 0.1))
    assert none.nrmse < 0.03
    assert some.nrmse == pytest.approx(0.1 * np.sqrt((truth**2).mean()) / truth.mean(), rel=0.1)


def test_tables_go_between_their_marks():
    text = "a\n<!-- table: one -->\nold\n<!-- end -->\nb\n<!-- table: two -->\nkept\n<!-- end -->\n"
    new = bench_paper.put_tables(text, {"one": paper_tables.Table(("x",), [["1"]])})
    assert new == "a\n<!-- table: one -->\n\n| x |\n| --- |\n| 1 |\n\n<!-- end -->\nb\n<!-- table: two -->\nkept\n<!-- end -->\n"


def test_pictures_are_drawn_and_small(measured, tmp_path):
    pytest.importorskip("matplotlib")  # of the bench extra, not of the tests'
    bench_paper.draw_paper(measured, CAMERA, tmp_path)
    sizes = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    assert set(sizes) == {"figure2.png", "figure3_solution.png", "figure3_mesh.png", "floor.png", "curves.png"}
    assert max(sizes.values()) < 200_000
