"""The claims that the benchmark of the paper makes, and its measure of error."""

import numpy as np
import paper_bakes
import paper_claims
import paper_tables
import pytest


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
