"""Mechanisms that are switched off by name: what the names may be, where they count, and that light or the stated error follows."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from boxes import lamp_scene
from leaflight.core.bake import bake
from leaflight.core.bake.in_memory import solve_scene
from leaflight.core.output.image_file import read_image
from leaflight.core.scene.scene import Light, Material
from leaflight.core.scene.snapshot import hash_bake, save_snapshot
from leaflight.core.util import ablation
from leaflight.core.util.job import RESULT_FILE, SNAPSHOT_FILE, Job
from leaflight.core.util.settings import Settings
from scenes import box_mesh, make_scene, moved, quad_mesh, sphere_mesh

pytestmark = pytest.mark.usefixtures("open_image_io")
CORE = Path(ablation.__file__).resolve().parents[1]
PAGE = CORE.parent / "docs" / "ablation.md"
QUICK = Settings(size=48, padding=1, workers=1, error=0.03, max_photons=100_000)


def bake_without(folder, monkeypatch, *names, settings=QUICK, scene=None):
    """Pixels of a small room's bake without some mechanisms, its result, and what it told."""
    monkeypatch.setenv(ablation.VARIABLE, ",".join(names))
    folder = folder / ("_".join(names) or "all") / str(settings.workers)
    folder.mkdir(parents=True)
    save_snapshot(folder / SNAPSHOT_FILE, scene or lamp_scene())
    Job(settings, str(folder / "images"), "room").save(folder)
    told = []
    bake.run_bake(folder, told.append, lambda: False)
    result = json.loads((folder / RESULT_FILE).read_text())
    return read_image(Path(result["files"][0]["path"]))[0], result, told


def test_each_mechanism_is_asked_for_by_a_name_that_is_listed():
    asked = {name for path in CORE.rglob("*.py") for name in re.findall(r'uses\("(\w+)"\)', path.read_text(encoding="utf-8"))}
    of_settings = {"grain_filter", "seams", "contacts"}
    assert asked | of_settings == set(ablation.MECHANISMS)
    with pytest.raises(KeyError):
        ablation.uses("magic")


def test_the_page_lists_every_mechanism():
    text = PAGE.read_text(encoding="utf-8")
    assert [name for name in ablation.MECHANISMS if f"| {name} |" not in text] == []


def test_unknown_names_are_refused_with_those_that_are_known(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match=r"LEAFLIGHT_WITHOUT: magic is no mechanism; known are coefficient_shrinkage, .*tiles"):
        bake_without(tmp_path, monkeypatch, "tiles", "magic")
    monkeypatch.setenv(ablation.VARIABLE, " tiles , seams,")
    assert ablation.list_without() == ("seams", "tiles")


def test_settings_follow_the_mechanisms_that_they_switch(monkeypatch):
    monkeypatch.setenv(ablation.VARIABLE, "grain_filter,seams")
    assert ablation.trim_settings(QUICK) == replace(QUICK, denoise=False, seams=False)
    monkeypatch.delenv(ablation.VARIABLE)
    assert ablation.trim_settings(QUICK) == QUICK


def test_workers_of_a_cluster_are_refused_for_they_would_not_know(monkeypatch):
    monkeypatch.setenv(ablation.VARIABLE, "tiles")
    with pytest.raises(ValueError, match="cluster"):
        ablation.trim_settings(replace(QUICK, cluster="host:8786"))


def test_a_bake_without_something_is_another_bake(monkeypatch):
    job = Job(QUICK, "", "room")
    whole = hash_bake(lamp_scene(), job)
    monkeypatch.setenv(ablation.VARIABLE, "tiles")
    assert hash_bake(lamp_scene(), job) != whole


def test_switches_change_the_light_and_the_result_says_so(tmp_path, monkeypatch):
    pixels, result, told = bake_without(tmp_path, monkeypatch)
    assert "without" not in result
    assert not [one for one in told if ablation.VARIABLE in getattr(one, "text", "")]
    for name in ("coefficient_shrinkage", "grain_filter", "tiles", "contacts", "splitting", "block_agreement"):
        without, result_without, told = bake_without(tmp_path, monkeypatch, name)
        assert (without != pixels).any(), name
        assert result_without["without"] == [name]
        assert [one.text for one in told if ablation.VARIABLE in getattr(one, "text", "")]
        if name == "grain_filter":
            light = solve_scene(lamp_scene(), QUICK)
            np.testing.assert_array_equal(light.pages["combined"][0].astype(np.float16), without)  # which EXR files keep
            assert light.report["without"] == (name,)
            assert [text for _, text in light.warnings if ablation.VARIABLE in text]
        if name == "tiles":  # the processes that trace are told, too
            assert np.array_equal(bake_without(tmp_path, monkeypatch, name, settings=replace(QUICK, workers=2))[0], without)
    assert (bake_without(tmp_path, monkeypatch, "photons_ahead")[0] == pixels).all()


def full_scene():
    """Something for each mechanism: many lamps, one that glows, a sky, contacts, thin and round things, one without a lightmap."""
    lamp = Light("POINT", "Lamp", (0.1, 0.1, 0.6), power_rgb=(1.0,) * 3, radius_m=0.01)
    lamps = [replace(lamp, name=f"Lamp {k}", position_m=(0.2 * (k % 4), 0.2 * (k // 4), 0.6)) for k in range(20)]
    meshes = [
        quad_mesh("Floor"),
        box_mesh("Wall", (0.02, 0.8, 0.4), (0.5, 0.4, 0.2)),
        replace(box_mesh("Box", (0.2, 0.2, 0.2), (0.2, 0.3, 0.1)), receives=False),
        moved(sphere_mesh(radius_m=0.1), (0.8, 0.5, 0.1)),
        moved(sphere_mesh(rings=4, segments=8, radius_m=0.05), (0.8, 0.8, 0.5), name="Glowing"),
        box_mesh("Strip", (0.9, 0.002, 0.01), (0.5, 0.99, 0.3)),
        moved(quad_mesh("Roof", 0.9, 0.9), (0.0, 0.0, 0.8)),
    ]
    materials = [Material("Grey", (0.5,) * 3), Material("Light", (0.5,) * 3, emission_rgb=(5.0,) * 3)]
    scene = make_scene(meshes, lamps, materials)
    return replace(scene, tri_material=np.isin(scene.tri_object, (4, 5)).astype(np.int32), world_rgb=(0.2, 0.3, 0.4))


@pytest.mark.slow
def test_a_bake_without_any_of_them_has_much_the_same_light(tmp_path, monkeypatch):
    settings = replace(QUICK, error=0.1, workers=2)
    whole = bake_without(tmp_path, monkeypatch, settings=settings, scene=full_scene())[0][..., :3].mean()
    for name in ablation.MECHANISMS:
        pixels = bake_without(tmp_path, monkeypatch, name, settings=settings, scene=full_scene())[0]
        assert pixels[..., :3].mean() == pytest.approx(whole, rel=0.1), name
