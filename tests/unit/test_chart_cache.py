"""Charts of the last bake: what is known is not unwrapped again, and is the same."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from boxes import bake_folder, lamp_scene
from leaflight.core.atlas import chart_cache
from leaflight.core.atlas.chart_cache import ChartCache
from leaflight.core.atlas.chart_search import find_charts
from leaflight.core.util.messages import Warning_
from leaflight.core.util.settings import Settings
from scenes import box_mesh, grid_mesh, make_scene, moved, sphere_mesh

pytestmark = pytest.mark.usefixtures("open_image_io")
BALL, CLOTH = sphere_mesh("Ball", rings=20, segments=40), grid_mesh("Cloth", cells=24, noise=0.4)  # too large to be unwrapped together
QUICK = Settings(size=32, padding=1, workers=1, error=0.3, max_photons=2000)
N_CLOTH = make_scene([CLOTH]).n_tri


@pytest.fixture
def asked(monkeypatch):
    """How many triangles xatlas was asked for, each time."""
    counts, real = [], chart_cache.Unwrapping
    monkeypatch.setattr(chart_cache, "Unwrapping", lambda *arrays: counts.append(len(arrays[0])) or real(*arrays))
    return counts


@pytest.fixture
def bake_lamp(tmp_path):
    """Bakes the lamp of so much power into a folder of images; gives its result and what was told."""

    def bake_lamp(images="images", power=(10.0, 5.0, 2.5), **knobs):
        scene = lamp_scene()
        scene = replace(scene, lights=(replace(scene.lights[0], power_rgb=power),))
        told, result = bake_folder(tmp_path, scene, replace(QUICK, **knobs), output=str(tmp_path / images))
        return result, [message.text for message in told if isinstance(message, Warning_)]

    return bake_lamp


def stop_here(*_, **__):
    raise KeyboardInterrupt


def save_charts(scene, file, earlier=None):
    kept = earlier or ChartCache()
    found = find_charts(scene, True, kept=kept)
    kept.save(file)
    return found


def test_only_what_has_changed_is_unwrapped_whatever_comes_before_it(tmp_path, asked):
    """Numbers of vertices and polygons begin elsewhere then."""
    save_charts(make_scene([BALL, CLOTH]), tmp_path / "charts")
    asked.clear()
    kept = ChartCache.load(tmp_path / "charts")
    changed = make_scene([box_mesh("New"), moved(BALL, (0.0, 0.0, 1.0)), CLOTH])
    found = find_charts(changed, True, kept=kept)
    assert (N_CLOTH in asked, kept.known) == (False, 1)
    plain = find_charts(changed, True)
    np.testing.assert_array_equal(found.uv, plain.uv)
    np.testing.assert_array_equal(found.chart, plain.chart)


@pytest.mark.parametrize(
    "change",
    [
        lambda mesh: replace(mesh, vertex=mesh.vertex * 1.001),
        lambda mesh: replace(mesh, polygons=[polygon[1:] + polygon[:1] for polygon in mesh.polygons]),
    ],
)
def test_another_shape_is_not_taken_for_it(tmp_path, change):
    save_charts(make_scene([CLOTH]), tmp_path / "charts")
    kept = ChartCache.load(tmp_path / "charts")
    find_charts(make_scene([change(CLOTH)]), True, kept=kept)
    assert kept.known == 0


def test_another_version_unwraps_anew(tmp_path, monkeypatch):
    save_charts(make_scene([CLOTH]), tmp_path / "charts")
    monkeypatch.setattr(chart_cache, "hash_code", lambda: "another")
    kept = ChartCache.load(tmp_path / "charts")
    find_charts(make_scene([CLOTH]), True, kept=kept)
    assert kept.known == 0


def test_what_a_bake_has_not_used_is_kept_no_longer(tmp_path):
    file = tmp_path / "charts"
    save_charts(make_scene([BALL, CLOTH]), file)
    size = file.stat().st_size
    save_charts(make_scene([CLOTH]), file, ChartCache.load(file))
    assert file.stat().st_size < 0.6 * size
    kept = ChartCache.load(file)
    find_charts(make_scene([BALL, CLOTH]), True, kept=kept)
    assert kept.known == 1


@pytest.mark.parametrize("content", [b"", b"no charts", None])
def test_a_damaged_file_is_as_none(tmp_path, content):
    file, scene = tmp_path / "charts", make_scene([CLOTH])
    plain = save_charts(scene, file)
    file.write_bytes(file.read_bytes()[:-200] if content is None else content)
    kept = ChartCache.load(file)
    np.testing.assert_array_equal(find_charts(scene, True, kept=kept).uv, plain.uv)
    assert kept.known == 0
    kept.save(file)
    assert list(tmp_path.iterdir()) == [file]


def test_a_bake_with_another_lamp_unwraps_nothing_and_gives_what_the_first_one_would(bake_lamp, tmp_path, asked):
    bake_lamp()
    asked.clear()
    result, _ = bake_lamp(power=(3.0, 2.0, 1.0))
    assert (asked, result["skipped"]["objects_unwrapped_before"]) == ([], 2)
    first, _ = bake_lamp("others", power=(3.0, 2.0, 1.0))
    assert (len(asked), first["skipped"]["objects_unwrapped_before"]) == (1, 0)
    assert [Path(file["path"]).read_bytes() for file in result["files"]] == [Path(file["path"]).read_bytes() for file in first["files"]]


def test_a_forced_bake_takes_nothing_from_an_earlier_one(bake_lamp):
    bake_lamp()
    assert bake_lamp(force=True)[0]["skipped"]["objects_unwrapped_before"] == 0


def test_charts_that_cannot_be_kept_are_told_and_the_bake_goes_on(bake_lamp, tmp_path, monkeypatch):
    def fill_disk(self, file, is_whole):
        raise OSError("no space left")

    monkeypatch.setattr(ChartCache, "save", fill_disk)
    result, told = bake_lamp()
    assert f"the charts cannot be kept in {tmp_path / 'images'} (no space left), so the next bake unwraps all meshes again" in told
    assert Path(result["files"][0]["path"]).exists()


def test_a_bake_that_is_stopped_before_there_is_light_keeps_them(bake_lamp, monkeypatch):
    """Who has waited for them once would wait again."""
    with monkeypatch.context() as patch:
        patch.setattr("leaflight.core.bake.find_light.find_receivers", stop_here)
        with pytest.raises(KeyboardInterrupt):
            bake_lamp()
    assert bake_lamp()[0]["skipped"]["objects_unwrapped_before"] == 2


def test_charts_of_a_bake_that_does_not_come_to_all_are_kept_beside_earlier_ones(tmp_path, asked):
    """As of one that is stopped while it unwraps."""
    file = tmp_path / "charts"
    save_charts(make_scene([BALL]), file)
    kept = ChartCache.load(file)

    def stop(*_):
        if N_CLOTH in asked:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        find_charts(make_scene([CLOTH, moved(BALL, (0.0, 0.0, 1.0)), BALL]), True, stop, kept)
    kept.save(file, is_whole=False)
    again = ChartCache.load(file)
    find_charts(make_scene([BALL]), True, kept=again)
    assert again.known == 1


def test_charts_that_do_not_fit_a_page_are_kept_for_a_larger_one(bake_lamp):
    with pytest.raises(ValueError, match="do not fit a page"):
        bake_lamp(size=16, padding=8)
    assert bake_lamp()[0]["skipped"]["objects_unwrapped_before"] == 2
