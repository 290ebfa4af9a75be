"""The benchmark of the paper, whole at toy size, and its measure of error."""

import dataclasses

import bench_paper
import numpy as np
import paper_bakes
import paper_claims
import paper_split
import paper_tables
import pytest
from boxes import lamp_scene
from leaflight.core.parallel import executors, folders
from leaflight.core.scene.scene import Light, Material
from scenes import make_scene, moved, quad_mesh

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
    folders.forget_folders()


@pytest.mark.slow
def test_every_table_is_filled(measured):
    curves = {"figure 3", "leaves for the same error", "where the error comes from"}
    assert set(measured.tables) == {"figure 2", *curves, "overhead", "hints", "knobs"}
    for table in measured.tables.values():
        assert table.rows
        assert all(len(row) == len(table.head) for row in table.rows)
        assert "nan" not in str(table)


@pytest.mark.slow
def test_the_square_is_that_of_the_closed_form(measured):
    bake = measured.square["linear"]
    truth = paper_tables.square_irradiance(paper_tables.texel_positions(bake.stage))
    area = bake.stage.texels.texel_area
    arrived = (bake.values()[:, 0] * area).sum()
    assert arrived == pytest.approx((truth * area).sum(), rel=4 / np.sqrt(TOY.figure_2))
    assert len(bake.light.leaves) < len(measured.square["constant"].light.leaves)


@pytest.mark.slow
def test_the_hierarchy_errs_less_than_the_fixed_mesh(measured):
    flat, constant = (measured.curves[name][-1] for name in ("flat", "constant"))
    assert flat.leaves > 2 * constant.leaves
    assert constant.nrmse < 0.7 * flat.nrmse


@pytest.mark.slow
def test_the_error_is_split_into_what_leaves_cannot_hold_and_noise(measured):
    """The fixed mesh holds all of the light; of the best leaves less is lost than of those that a bake chose."""
    flat, *others = split = paper_split.measure_split(measured.room["flat"].stage, measured.reference, measured.reference, TOY.figure_3)
    assert flat.missing == pytest.approx(0.0, abs=1e-6)
    assert flat.noise == pytest.approx(flat.rel)
    for one in others:
        assert one.missing > 0.0
        assert abs(one.missing - one.noise) < one.rel < one.missing + one.noise
        assert one.rel < flat.rel
    by_name = {one.name: one for one in split}
    names = "and no node late", "and the best leaves", "each with or without its slope"
    late, best, degree = (by_name[f"... {name}"].rel for name in names)
    assert degree < best < late


@pytest.mark.slow
def test_the_paper_shows_stable_nodes_at_or_below_the_current_ones(measured):
    bake = measured.room["constant"].stage.bake(400_000)  # two rounds, so that there are split nodes
    current = np.flatnonzero(bake.light.tree.current)
    assert bake.light.tree.depth[current].max() > 0
    np.testing.assert_array_equal(np.sort(bake.show_stable(10**9)), current)
    shown = bake.leaf_of(bake.show_stable(8))
    below = ~bake.light.tree.current[shown]
    assert below.any()
    assert (bake.light.received[shown[below]] >= 8).all()


@pytest.mark.slow
def test_every_measure_is_claimed(measured):
    """Not that each holds: at toy size some do not."""
    names = {claim.name for claim in measured.claims}
    assert len(names) == 14
    assert len(measured.claims) == 2 + 9 + 3 + 4 + 5
    assert sum(claim.measured > 0 for claim in measured.claims) >= len(measured.claims) - 2  # no finest node is compared at toy size


def point(rel, leaves, photons):
    return paper_tables.Point(photons, leaves, rel, rel, paper_bakes.Errors(rel, rel), 1)


def swept(rel, at_contacts, **knobs):
    return paper_tables.Swept(paper_tables.Choice("", knobs), paper_bakes.Errors(rel, rel), paper_bakes.Errors(9.0, at_contacts), 1, 1)


def failing(claims):
    return {claim.name.partition(": ")[2] + claim.case for claim in claims if not claim.holds}


def test_claims_of_the_paper_fail_beyond_their_bounds():
    rows = [paper_tables.SquareRow(basis, "", leaves, rmse) for basis, leaves, rmse in (("constant", 10, 0.2), ("constant", 1, 0.1))]
    for leaves, rmse, told in ((5, 0.18, set()), (6, 0.18, {"leaves, linear over constant"}), (5, 0.19, {"error, linear over constant"})):
        assert failing(paper_claims.judge_square([*rows, paper_tables.SquareRow("linear", "", leaves, rmse)])) == told
    rels = {"flat": 1.0, "linear": 0.49, paper_tables.FLAT_GUIDED: 0.89, paper_tables.GUIDED: 0.39}
    curves = {name: [point(2.0, 10, 1e6), point(rel, 20, 4e6)] for name, rel in rels.items()}
    needs = {name: paper_tables.Need(1.0, *need) for name, need in (("flat", (9, 9)), ("constant", (5, 4)), ("linear", (4, 4.5)))}
    good = {**needs, "quadratic": paper_tables.Need(1.0, 3, 3)}
    assert failing(paper_claims.judge_curves(curves, good)) == set()
    bad = {**needs, "quadratic": paper_tables.Need(1.0, 3.7, 4.6)}
    for name, rel in (("linear", 0.51), (paper_tables.FLAT_GUIDED, 0.91), (paper_tables.GUIDED, 0.41)):
        curves[name].append(point(rel, 30, 8e6))
    assert len(failing(paper_claims.judge_curves(curves, bad))) == 5
    assert len(failing(paper_claims.judge_overhead(paper_tables.Overhead(9, 1.34, 1.34, 0.71)))) == 3
    assert failing(paper_claims.judge_overhead(paper_tables.Overhead(9, 1.33, 1.33, 0.70))) == set()
    assert len(failing(paper_claims.judge_overhead(paper_tables.Overhead(0, float("nan"), float("nan"), 0.70)))) == 2


def test_claims_of_hints_and_defaults_fail_beyond_their_bounds():
    def hints(contact, level):
        knobs = {"contact": False, "min_level": 0}, {"contact": True, "min_level": 0}, {"contact": False, "min_level": 3}
        return [swept(1.0, error, basis="linear", **one) for one, error in zip(knobs, (1.0, contact, level), strict=True)]

    assert failing(paper_claims.judge_hints(hints(0.89, 0.89))) == set()
    assert failing(paper_claims.judge_hints(hints(0.91, 0.89))) == {"nrmse at contacts, contact subdivision over nonelinear"}
    assert failing(paper_claims.judge_hints(hints(0.89, 0.91))) == {"nrmse at contacts, minimum level 3 over 0linear"}

    def knobs(rel, shallow, of_threshold=3.0):
        others = [swept(rel, 1.0, stability=2), swept(2.0, 1.0, oracle="paper", stability=8)]
        default = paper_tables.DEFAULTS.threshold
        printed = [swept(error, 1.0, oracle="paper", threshold=value) for value, error in ((default, 3.0), (2 * default, of_threshold))]
        return [swept(1.0, 1.0), *others, swept(shallow, 1.0, preview_depth=1), swept(2.0, 1.0, preview_depth=3), *printed]

    best = "rel over that of the best value tried"
    assert failing(paper_claims.judge_knobs(knobs(0.96, 1.12, 2.9))) == set()
    assert failing(paper_claims.judge_knobs(knobs(0.94, 1.12))) == {f"{best}stability"}
    assert failing(paper_claims.judge_knobs(knobs(0.96, 1.12, 2.8))) == {f"{best}threshold"}
    assert failing(paper_claims.judge_knobs(knobs(0.96, 1.1))) == {"rel, preview depth 2 over 1"}


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


@pytest.mark.slow
def test_pictures_are_drawn_and_small(measured, tmp_path):
    pytest.importorskip("matplotlib")  # of the bench extra, not of the tests'
    bench_paper.draw_paper(measured, CAMERA, tmp_path)
    sizes = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    assert set(sizes) == {"figure2.png", "figure3_solution.png", "figure3_mesh.png", "floor.png", "curves.png"}
    assert max(sizes.values()) < 200_000
