"""A bake that goes on from what was kept is the bake that did not stop; what does not fit is refused."""

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from boxes import lamp_scene, make_solver
from leaflight.core.bake import checkpoint
from leaflight.core.bake.checkpoint import INFO_FILE, load_checkpoint, read_info, remove_checkpoint, save_checkpoint
from leaflight.core.integrate import direct_shards
from leaflight.core.parallel import shared_arrays
from leaflight.core.transport import rounds
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=32, padding=1, max_photons=600_000, error=1e-4)


def run(solver, stop_after=10**9):
    asked = []

    def should_stop():
        asked.append(True)
        return solver.round >= stop_after

    return solver.run(lambda message: None, should_stop)


def keep(folder, settings=SETTINGS, stop_after=1, scene=None, forced=False):
    """Where the state of a bake is kept, of the lamp scene if not another, and its light."""
    solver = make_solver(folder / "first", scene or lamp_scene(), settings, forced=forced)
    light = run(solver, stop_after)
    save_checkpoint(folder / "kept", solver, light.error)
    return folder / "kept", light


@pytest.fixture(scope="module")
def first_round(tmp_path_factory):
    """A folder in which `keep` has kept a bake after its first round."""
    folder = tmp_path_factory.mktemp("first_round")
    keep(folder)
    return folder


@pytest.fixture
def kept(first_round, tmp_path):
    """A copy of that state; the bake's own folder is `first`, beside it."""
    shutil.copytree(first_round, tmp_path, dirs_exist_ok=True)
    return tmp_path / "kept"


def go_on(folder, kept, settings=SETTINGS, scene=None, forced=False):
    solver = make_solver(folder / "second", scene or lamp_scene(), settings, forced=forced, begun=False)
    load_checkpoint(kept, folder / "second", settings).give_to(solver)
    return run(solver)


def light_bytes(light):
    arrays = [light.solution.coefficient, light.solution.variance, light.leaves, light.direct.irradiance, light.direct.variance]
    arrays += [light.gathered.irradiance, light.gathered.variance] if light.gathered else []
    return b"".join(array.tobytes() for array in arrays)


def test_a_state_from_before_a_choice_keeps_its_layout(tmp_path, kept):
    """Even Out and pages by themselves came later; who goes on has neither."""
    assert checkpoint.keep_layout(kept, SETTINGS) == SETTINGS
    told = json.loads((kept / INFO_FILE).read_text())
    for name in ("even_out", "max_pages"):
        del told["identity"][name]
    (kept / INFO_FILE).write_text(json.dumps(told))
    assert checkpoint.keep_layout(kept, SETTINGS) == replace(SETTINGS, even_out=False, max_pages=1)
    assert checkpoint.keep_layout(kept, replace(SETTINGS, density=9.0)) == replace(SETTINGS, density=9.0, even_out=False)
    assert checkpoint.find_differences(kept, tmp_path / "first", replace(SETTINGS, even_out=False, max_pages=1)) == []
    assert checkpoint.keep_layout(tmp_path / "none", SETTINGS) == SETTINGS


@pytest.mark.parametrize(
    ("settings", "stop_after"),
    [(replace(SETTINGS, direct="photons", basis="quadratic"), 2), (replace(SETTINGS, hierarchical=False, error=0.01), 1)],
)
def test_an_interrupted_bake_goes_on_to_the_bytes_of_one_that_was_not(tmp_path, settings, stop_after):
    forced = np.arange(786) < 50
    whole = run(make_solver(tmp_path / "whole", lamp_scene(), settings, forced=forced))
    kept, part = keep(tmp_path, settings, stop_after, forced=forced)
    assert (part.stopped_by, part.rounds) == ("interrupted", stop_after)
    assert whole.rounds > stop_after
    rest = go_on(tmp_path, kept, settings, forced=forced)
    assert light_bytes(rest) == light_bytes(whole)
    assert (rest.photons, rest.rounds, rest.error) == (whole.photons, whole.rounds, whole.error)
    assert rest.ledger.audit_w() == whole.ledger.audit_w()
    assert rest.ledger.rays == whole.ledger.rays


def test_shards_that_were_under_way_when_a_bake_stopped_are_not_missing_when_it_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(rounds, "SHARD_PHOTONS", 1 << 13)  # so that there are many of a round
    settings = replace(SETTINGS, direct="photons")
    whole = run(make_solver(tmp_path / "whole", lamp_scene(), settings))
    kept, _ = keep(tmp_path, settings, 2)
    late = load_checkpoint(kept, tmp_path / "first", settings).late
    assert len(late) == 2 * rounds.SMALL_PAIRS
    rest = go_on(tmp_path, kept, settings)
    assert light_bytes(rest) == light_bytes(whole)
    assert (rest.photons, rest.rounds, rest.error) == (whole.photons, whole.rounds, whole.error)
    assert rest.ledger.rays == whole.ledger.rays
    assert not list((tmp_path / "second").glob("view_*"))

    solver = make_solver(tmp_path / "third", lamp_scene(), settings, begun=False)
    load_checkpoint(kept, tmp_path / "third", settings).give_to(solver)
    save_checkpoint(tmp_path / "again", solver, run(solver, 0).error)  # stopped before it got anywhere
    (tmp_path / "more").mkdir()
    assert light_bytes(go_on(tmp_path / "more", tmp_path / "again", settings)) == light_bytes(whole)


def test_a_bake_whose_direct_light_was_shot_again_goes_on_to_a_smaller_error(tmp_path, monkeypatch):
    monkeypatch.setattr(direct_shards, "TOLERANCE", 20.0)  # so that the first turn is too coarse
    kept, part = keep(tmp_path, replace(SETTINGS, error=0.04, denoise=False, max_photons=3_000_000), 10**9)
    passes, noise = part.direct.passes.copy(), part.direct.variance.mean()
    assert (part.stopped_by, passes.max() > 1) == ("error", True)
    rest = go_on(tmp_path, kept, replace(SETTINGS, error=0.02, denoise=False, max_photons=3_000_000))
    assert rest.stopped_by == "error"
    assert (rest.direct.passes >= passes).all()
    assert rest.direct.variance.mean() < 0.5 * noise


def test_light_that_is_gathered_after_every_round_is_that_of_a_bake_that_was_not_stopped(tmp_path):
    settings = replace(SETTINGS, size=12, error=0.01, max_photons=1_600_000)
    whole = run(make_solver(tmp_path / "whole", lamp_scene(), settings), 3)
    kept, _ = keep(tmp_path, settings, 2)
    solver = make_solver(tmp_path / "second", lamp_scene(), settings, begun=False)
    load_checkpoint(kept, tmp_path / "second", settings).give_to(solver)
    rest = run(solver, 3)
    assert light_bytes(rest) == light_bytes(whole)
    assert rest.error == whole.error
    assert rest.ledger.gathered == whole.ledger.gathered > 0


def test_gathered_light_is_kept(tmp_path):
    """A bake that goes on has the light and the error that the first one ended with, until both get better."""
    settings = replace(SETTINGS, error=0.02)
    kept, light = keep(tmp_path, settings, 10**9)
    assert (light.stopped_by, light.gathered is None) == ("error", False)
    solver = make_solver(tmp_path / "second", lamp_scene(), replace(settings, error=0.015), begun=False)
    load_checkpoint(kept, tmp_path / "second", solver.settings).give_to(solver)
    assert light_bytes(run(solver, 0)) == light_bytes(light)
    assert run(solver, 0).error == pytest.approx(light.error, rel=0.02)  # less noise is filtered
    rest = run(solver)
    assert rest.gathered.counters["rays"] == rest.ledger.gathered > light.ledger.gathered, "no ray was sent in vain"
    assert rest.error <= 0.015


def test_another_scene_or_method_is_refused_by_name(tmp_path, kept):
    with pytest.raises(ValueError, match="another scene; bake again"):
        go_on(tmp_path, kept, scene=lamp_scene(rho=0.51))
    for knob, value in (("seed", 2), ("basis", "constant"), ("size", 33), ("direct", "photons")):
        with pytest.raises(ValueError, match=f"another {knob}"):
            load_checkpoint(kept, tmp_path / "first", replace(SETTINGS, **{knob: value}))
    free = replace(SETTINGS, error=0.5, max_photons=10**7, time_limit=3.0, workers=3, margin=2, passes=("albedo",), formats=("png",))
    assert load_checkpoint(kept, tmp_path / "first", free).round == 1


def test_what_is_no_state_is_refused(tmp_path, kept):
    with pytest.raises(ValueError, match="holds no state"):
        load_checkpoint(tmp_path / "nowhere", tmp_path, SETTINGS)
    next(kept.glob("*/packed.bin")).unlink()
    with pytest.raises(ValueError, match="is damaged"):
        load_checkpoint(kept, tmp_path / "first", SETTINGS)
    info = json.loads((kept / INFO_FILE).read_text())
    (kept / INFO_FILE).write_text(json.dumps(info | {"version": 0}))
    assert read_info(kept) is None


@pytest.mark.parametrize("place", [9, 500, -1])
def test_no_byte_of_a_state_may_change(tmp_path, kept, place):
    """Numbers that are counted or pointed with would end the bake far from here."""
    file = next(kept.glob("*/packed.bin"))
    content = bytearray(file.read_bytes())
    content[place] ^= 64
    file.write_bytes(content)
    with pytest.raises(ValueError, match=r"the state of the bake is damaged \(its files are not those that were kept\); bake again\."):
        load_checkpoint(kept, tmp_path / "first", SETTINGS)


@pytest.mark.parametrize(
    "change",
    [
        {"photons": "many"},
        {"photons": -1},
        {"photons": 2**70},
        {"error": None},
        {"error": math.nan},
        {"bytes": []},
        {"identity": ["scene"]},
        {"identity": {"scene": 5}},
        {"digest": 5},
        {"more": 1},
    ],
)
def test_a_note_of_a_state_that_says_something_else_is_none(kept, change):
    info = json.loads((kept / INFO_FILE).read_text())
    (kept / INFO_FILE).write_text(json.dumps(info | change))
    assert read_info(kept) is None


@pytest.mark.parametrize("text", ["[" * 100_000, "5", "null", "\xff", "{}" + " " * 2_000_000])
def test_no_text_in_place_of_a_note_is_the_end(tmp_path, text):
    (tmp_path / INFO_FILE).write_text(text, encoding="latin-1")
    assert read_info(tmp_path) is None


def test_a_state_is_not_written_through_a_link(tmp_path, kept):
    solver = make_solver(tmp_path / "second", lamp_scene(), SETTINGS, begun=False)
    (tmp_path / "theirs").mkdir()
    shutil.rmtree(kept / "state")
    (kept / "state").symlink_to(tmp_path / "theirs")
    save_checkpoint(kept, solver, 0.1)
    assert list((tmp_path / "theirs").iterdir()) == []
    assert load_checkpoint(kept, tmp_path / "first", SETTINGS).photons == read_info(kept).photons == 0


def test_a_state_too_large_is_not_kept_and_said(tmp_path, kept):
    size = read_info(kept).bytes
    on_disk = sum(path.stat().st_size for path in kept.rglob("*") if path.is_file())
    assert 0.8 * on_disk < size <= on_disk
    solver = make_solver(tmp_path / "second", lamp_scene(), SETTINGS, begun=False)
    run(solver, 1)
    with pytest.raises(ValueError, match="MB allowed; it is not kept"):
        save_checkpoint(kept, solver, 0.1, most_bytes=1000)
    assert read_info(kept) is None  # nor is the old one, of other images


def test_a_full_disk_leaves_no_half_state(tmp_path, kept, monkeypatch):
    solver = make_solver(tmp_path / "second", lamp_scene(), SETTINGS, begun=False)
    run(solver, 1)

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(shared_arrays, "open", fail, raising=False)
    with pytest.raises(OSError, match="cannot be kept there"):
        save_checkpoint(kept, solver, 0.1)
    assert read_info(kept) is None


def test_only_our_own_files_are_removed(tmp_path, kept):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "state").mkdir()
    remove_checkpoint(tmp_path / "other")
    assert (tmp_path / "other" / "state").is_dir()
    (kept / "mine.txt").touch()
    remove_checkpoint(kept)
    assert [path.name for path in kept.iterdir()] == ["mine.txt"]
    remove_checkpoint(kept)
    (kept / "mine.txt").unlink()
    save_checkpoint(kept, make_solver(tmp_path / "third", lamp_scene(), SETTINGS, begun=False), 1.0)
    assert checkpoint.read_info(kept).photons == 0
    remove_checkpoint(kept)
    assert not kept.exists()


def test_progress_tells_of_the_photons_of_this_time_only(tmp_path, kept):
    first = read_info(kept)
    settings = replace(SETTINGS, error=0.02)
    solver, told = make_solver(tmp_path / "second", lamp_scene(), settings, begun=False), []
    load_checkpoint(kept, tmp_path / "second", settings).give_to(solver)
    solver.started -= 1000.0
    light = solver.run(told.append, lambda: False)
    assert told[0].photons == first.photons
    assert told[0].photons_per_s == 0.0
    assert math.isnan(told[0].seconds_left)
    assert told[-1].photons_per_s == pytest.approx((light.photons - first.photons) / 1000.0, rel=0.1)
