"""What benchmarks rest on: claims, references, random scenes, and the measure of every comparison with Cycles."""

import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import print_claims
import pytest
from bench_files import compare_objects, sum_light
from claims import Claim, hold_claim, load_claims, publish_claims, tabulate_claims, tell_failures
from cycles_reference import COMMITTED, REFERENCES, Reference
from lightmap_errors import measure_errors
from zoo_plan import draw_plan
from zoo_reference import PageReference, Subject
from zoo_scene import describe

# Claims hold within their bounds only, are told by their worst case, and survive the way to a file.
SOME = [
    Claim("sun: error", 0.5, high=2.0, unit="%", case="rays"),
    Claim("sun: error", 1.5, high=2.0, unit="%", case="photons"),
    Claim("slope: over size", 2.02, 1.85, 2.15, points=((1.0, 2.0), (2.0, 4.0))),
    Claim("bias: seen", 7.0, low=4.0, unit="sigmas"),
]


@pytest.mark.parametrize(
    ("measured", "low", "high", "holds"),
    [
        *[(1, 1, 2, True), (2, 1, 2, True), (2.1, 1, 2, False), (0.9, 1, math.inf, False), (9, 1, math.inf, True)],
        *[(0, -math.inf, 0, True), (1, -math.inf, 0, False), (math.nan, 0, 1, False), (3, 3, 3, True), (4, 3, 3, False)],
    ],
)
def test_a_claim_holds_within_its_bounds(measured, low, high, holds):
    claim = Claim("a: b", measured, low, high)
    assert claim.holds is holds
    if math.isfinite(measured):
        assert (claim.strain <= 1) is holds


def test_a_claim_that_fails_is_seen():
    failing = [*SOME, Claim("sun: error", 2.5, high=2.0, unit="%", case="sky")]
    assert tell_failures(SOME) == 0
    assert tell_failures(failing) == 1
    assert tell_failures([]) == 1
    assert tabulate_claims(failing).rows == [
        ["sun", "error", "3", "2.5 % (sky)", "at most 2 %", "**1 fail**"],
        ["slope", "over size", "1", "2.02", "1.85 to 2.15", "yes"],
        ["bias", "seen", "1", "7 sigmas", "at least 4 sigmas", "yes"],
    ]


def test_the_table_of_all_benchmarks_goes_into_the_page(tmp_path, monkeypatch):
    page = tmp_path / "accuracy.md"
    page.write_text("a\n<!-- table: claims -->\nold\n<!-- end -->\nb\n", encoding="utf-8")
    monkeypatch.setattr(print_claims, "PUBLISHED", tmp_path / "claims")
    monkeypatch.setattr(print_claims, "PAGE", page)
    monkeypatch.setattr(sys, "argv", ["print_claims.py", "--docs"])
    for name, claims in (("one", SOME[:2]), ("two", SOME[2:])):
        publish_claims(name, claims, tmp_path / "claims")
    assert print_claims.main() == 0
    assert page.read_text(encoding="utf-8") == f"a\n<!-- table: claims -->\n\n{tabulate_claims(SOME)}\n\n<!-- end -->\nb\n"


def test_a_claim_that_fails_is_kept_and_raised():
    kept = []
    with pytest.raises(AssertionError, match=r"sun: error \[sky\]: 3 %, claimed: at most 2 %"):
        hold_claim(kept, Claim("sun: error", 3.0, high=2.0, unit="%", case="sky"))
    assert [claim.holds for claim in kept] == [False]


@pytest.mark.slow  # as all that asks for claims; it starts a pytest of its own
@pytest.mark.parametrize("together", [[], ["--numprocesses", "2", "--dist", "load"]], ids=["alone", "together"])
def test_pytest_writes_the_claims_of_its_tests(tmp_path, together):
    """Of those that hold some, in their order, and tells how many tests failed."""
    test = tmp_path / "test_some.py"
    test.write_text(
        "import pytest\n"
        "@pytest.mark.parametrize('case', range(6))\n"
        "def test_held(hold, case): hold('sun: error', case, high=4)\n"
        "def test_that_holds_nothing(): assert False\n",
        encoding="utf-8",
    )
    conftest = Path(__file__).parents[1] / "conftest.py"
    command = [sys.executable, "-m", "pytest", "-p", "conftest", "-c", conftest.parents[1] / "pyproject.toml", "--rootdir", tmp_path, test]
    run = subprocess.run(
        [*command, *together, "--claims", tmp_path / "claims.json"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(conftest.parent)},
    )
    assert run.returncode == 1, run.stdout + run.stderr
    *held, failed = load_claims(tmp_path / "claims.json")
    assert [(claim.name, claim.measured, claim.case) for claim in held] == [("sun: error", case, str(case)) for case in range(6)]
    assert failed == Claim("tests: those of these claims, and slow ones, that fail", 1, high=0)


# The references that bakes are held against, and the claims judged by them.
REFERENCE_SIZE = 32


def make_reference(noise=0.02):
    rng = np.random.default_rng(1)
    covered = rng.random((REFERENCE_SIZE, REFERENCE_SIZE)) < 0.7
    truth = np.zeros((REFERENCE_SIZE, REFERENCE_SIZE, 4), np.float32)
    truth[covered] = [*rng.uniform(0.5, 2.0, 3), 1.0]
    truth[..., 0] *= 1.0 + np.arange(REFERENCE_SIZE) / REFERENCE_SIZE
    first, second = (truth[covered][:, :3] * (1.0 + rng.normal(0.0, noise, (covered.sum(), 3))) for _ in range(2))
    return Reference("toy", covered, first, second, rng.random((50, 3, 2))), truth


def test_a_reference_is_read_as_it_was_written(tmp_path):
    reference, truth = make_reference()
    reference.save(tmp_path, 16, "5.0")
    read = Reference.load("toy", REFERENCE_SIZE, tmp_path)
    np.testing.assert_array_equal(read.covered, reference.covered)
    np.testing.assert_allclose(read.second, reference.second, rtol=1e-3)
    assert read.noise == pytest.approx(0.02 / np.sqrt(2.0), rel=0.1)
    bright = read.measure(truth * np.float32(1.1), reference.tri_uv)
    assert bright.bias == pytest.approx(0.1, abs=0.005)
    assert bright.texels == reference.covered.sum()


def test_another_layout_is_refused_and_rounding_is_not():
    reference, truth = make_reference()
    reference.check_layout(reference.tri_uv + 1e-6)
    for layout in (reference.tri_uv + 0.1 / REFERENCE_SIZE, reference.tri_uv[:-1]):
        with pytest.raises(ValueError, match="layout is not that of the reference"):
            reference.measure(truth, layout)
    with pytest.raises(ValueError, match="32 texels a side, the page 16"):
        reference.measure(truth[:16, :16], reference.tri_uv)


@pytest.mark.parametrize(("name", "size"), [(name, size) for size, names in COMMITTED.items() for name in sorted(names)])
def test_committed_references_have_little_noise_and_are_small(name, size):
    reference = Reference.load(name, size)
    assert reference.noise < 0.02  # it cancels, but for what it does to the choice of the best texels
    assert (REFERENCES / f"{name}_{size}.npz").stat().st_size < 1_000_000
    assert len(reference.first) == reference.covered.sum()


# What the benchmark of files makes of texels that are see-through.
def test_texels_count_by_how_opaque_they_are():
    light = np.ones((128, 3), np.float32)
    opaque = np.where(np.arange(128) % 2, 1.0, 0.25).astype(np.float32)
    owner = np.zeros(128, np.int16)
    reference = PageReference(np.ones((8, 16), bool), light, light, owner, 8, 1.0, opaque)
    subject = Subject(Path(), "leaf", ("Leaf",), "", 16, 2, "")
    value = light.copy()
    value[::2] = 2.0  # of those that are a quarter opaque
    (leaf,) = compare_objects(subject, value, reference)
    assert leaf.off == pytest.approx(0.25 / 1.25)
    assert sum_light(reference, value) / sum_light(reference, light) - 1.0 == pytest.approx(0.25 / 1.25)


# What the seeds of the zoo draw: the same every time, and over many seeds all that a benchmark of random scenes has to contain.
SEEDS = 50


@pytest.fixture(scope="module")
def plans():
    return [draw_plan(seed) for seed in range(SEEDS)]


def test_a_seed_draws_the_same_scene_every_time(plans):
    assert draw_plan(7) == plans[7]
    assert len({repr(replace(plan, seed=0)) for plan in plans}) == SEEDS
    # Written down once: benchmarks of different days and versions of Python draw the same scene of a seed.
    assert describe(draw_plan(5)).startswith("seed 5: 2 rooms, windows, walls of boxes; 3 lamps (3 point), sky; 16 objects, 5 not baked")


def test_a_third_is_not_baked_and_something_is(plans):
    for plan in plans:
        assert plan.baked == len(plan.things) - round(len(plan.things) / 3) > 0


# The measure that every comparison with Cycles uses.
N = 40_000


def renderings(noise: float, seed: int = 1):
    """True light, and two noisy renderings of it."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0.5, 2.0, (N, 3))
    return truth, *(truth * (1.0 + rng.normal(0.0, noise, truth.shape)) for _ in range(2))


def test_the_renderings_noise_cancels():
    truth, first, second = renderings(0.05)
    errors = measure_errors(truth, first, second)
    assert errors.texels == N
    assert max(errors.rel, errors.nrmse) < 0.01
    assert abs(errors.bias) < 0.001
    assert errors.p99 > 0.05


def test_each_measure_is_what_it_says():
    truth, _, _ = renderings(0.0)
    errors = measure_errors(truth * 1.1, truth, truth)
    mean = truth.mean()
    assert errors.bias == pytest.approx(0.1)
    assert errors.nrmse == pytest.approx(0.1 * np.sqrt((truth**2).mean()) / mean)
    assert errors.rel == pytest.approx(np.sqrt(((0.1 * truth) ** 2 / (truth**2 + (0.1 * mean) ** 2)).mean()), rel=1e-3)
    assert errors.p99 == pytest.approx(np.quantile(0.1 * truth.sum(1) / (truth.sum(1) + 0.3 * mean), 0.99))


def test_few_bad_texels_are_left_out_of_rel_alone():
    truth, _, _ = renderings(0.0)
    value = truth.copy()
    value[: N // 200] = 0.0
    errors = measure_errors(value, truth, truth)
    assert errors.rel == 0.0
    assert errors.nrmse > 0.05
    assert errors.bias < -0.004
    value[: N // 50] = 0.0
    assert measure_errors(value, truth, truth).rel > 0.05


def test_black_texels_count_where_the_bake_left_them_not_where_a_rendering_did():
    truth, _, _ = renderings(0.0)
    value, first, second = truth.copy(), truth.copy(), truth.copy()
    value[:1000] = 0.0
    first[1000:2000] = 0.0
    second[2000:3000] = 0.0
    errors = measure_errors(value, first, second)
    assert errors.texels == N - 2000
    assert errors.bias == pytest.approx(-truth[:1000].sum() / np.delete(truth, slice(1000, 3000), 0).sum())
