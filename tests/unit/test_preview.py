"""Pages for the viewport: they show the light so far, cost little, and change nothing of the bake."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import furnace_scene, lamp_scene, make_solver, prepare_folder
from leaflight.core.bake import preview
from leaflight.core.bake.preview import PreviewPages, find_first_light
from leaflight.core.integrate import texel_light
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.output import resolve
from leaflight.core.transport import traced_scene
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=32, padding=1, direct="photons", error=1e-4, max_photons=300_000, passes=("lighting",))


def make_pages(folder, scene, settings=SETTINGS, tell=lambda message: None):
    texels = prepare_folder(folder, scene, settings)[1]
    surfaces = traced_scene.open_tracing(str(folder)).scene.surfaces
    return PreviewPages(folder / "pages", texels, surfaces, settings, tell), texels


def first_light(folder, settings):
    tracing = traced_scene.open_tracing(str(folder))
    return find_first_light(folder, settings, tracing.texels)


def test_first_light_is_all_of_the_light(tmp_path):
    pages, _ = make_pages(tmp_path, furnace_scene(0.5))
    (page,) = pages.draw(first_light(tmp_path, SETTINGS))
    lit = page[page[..., 3] > 0][:, :3].astype(float)
    assert lit.mean() == pytest.approx(2.0, rel=0.01)  # e / (1 - rho)
    assert lit.std() < 0.4


def test_pages_are_those_of_the_bake_but_for_its_blending(tmp_path):
    for name in ("combined", "indirect", "albedo"):
        settings = replace(SETTINGS, passes=(name,), max_photons=60_000)
        pages, texels = make_pages(tmp_path / name, furnace_scene(0.5), settings)
        light = make_solver(tmp_path / f"{name} solver", furnace_scene(0.5), settings).run(lambda message: None, lambda: False)
        (page,) = pages.draw(light)
        surfaces = traced_scene.open_tracing(str(tmp_path / name)).scene.surfaces
        final = resolve.Resolver(texel_light.light_at_texels(light, texels), texels, surfaces, 2).page(name, 0)
        np.testing.assert_array_equal(page[..., 3], final[..., 3])
        covered = final[..., 3] > 0
        assert page[covered][:, :3].astype(float).mean() == pytest.approx(final[covered][:, :3].mean(), rel=0.02), name


def test_shadow_rays_replace_photons_where_they_have_been_shot(tmp_path):
    pages, texels = make_pages(tmp_path, lamp_scene(), replace(SETTINGS, passes=("direct",)))
    first = first_light(tmp_path, SETTINGS)
    field = DirectField.none(len(texels.texel_area))
    half = np.arange(len(field.passes)) % 2 == 0
    field.passes[half], field.irradiance[half] = 1, 100.0 * np.pi
    (page,) = pages.draw(replace(first, direct=field), rays_alone=True)
    cell = page[texels.texel_xy[:, 1], texels.texel_xy[:, 0], 0]
    assert (cell[half] == 100.0).all()
    assert cell[~half].max() < 100.0


def test_large_pages_are_shown_smaller_and_as_bright(tmp_path, monkeypatch):
    pages, _ = make_pages(tmp_path, furnace_scene(0.5))
    first = first_light(tmp_path, SETTINGS)
    (whole,) = pages.draw(first)
    monkeypatch.setattr(preview, "MOST_TEXELS", 11 * 11)
    pages, _ = make_pages(tmp_path / "small", furnace_scene(0.5))
    (small,) = pages.draw(first)
    assert small.shape == (11, 11, 4)
    means = [page[page[..., 3] > 0][:, 0].astype(float).mean() for page in (whole, small)]
    assert means[0] == pytest.approx(means[1], rel=0.05)


def test_pages_come_no_faster_than_they_may_cost(tmp_path, monkeypatch):
    told, clock = [], [0.0]
    pages, _ = make_pages(tmp_path, furnace_scene(0.5), tell=told.append)
    first = first_light(tmp_path, SETTINGS)
    draw = pages.draw

    def draw_slowly(*light):
        clock[0] += 0.2
        return draw(*light)

    monkeypatch.setattr(pages, "draw", draw_slowly)
    monkeypatch.setattr(preview.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(preview.time, "thread_time", lambda: clock[0])
    for _ in range(100):
        pages.show(first)
        clock[0] += 0.1
    assert 5 <= len(told) <= 6  # each took 0.2 s: 2 s must pass between two
    assert np.load(told[-1].path).shape == (32, 32, 4)
    assert len(list((tmp_path / "pages").glob("*.npy"))) == preview._KEPT_TURNS


def test_messages_are_passed_on_and_show_what_has_come(tmp_path, monkeypatch):
    monkeypatch.setattr(preview, "LEAST_PAUSE_S", 0.0)
    monkeypatch.setattr(preview, "PAUSE_OF_COST", 0.0)
    told = []
    pages, texels = make_pages(tmp_path, lamp_scene(), tell=told.append)
    field = DirectField.none(len(texels.texel_area))
    tell = pages.join(first_light(tmp_path, SETTINGS), field)
    field.passes[:], field.irradiance[:] = 1, 50.0 * np.pi
    tell("a message")
    assert told[1] == "a message"
    before, after = (np.load(told[i].path)[..., 0].max() for i in (0, 2))
    assert before < 50.0 <= after


def test_a_page_that_blender_is_reading_stays(tmp_path, monkeypatch):
    """As on Windows, where a file that is open cannot be removed: the bake goes on."""
    monkeypatch.setattr(preview, "LEAST_PAUSE_S", 0.0)
    monkeypatch.setattr(preview, "PAUSE_OF_COST", 0.0)
    told = []
    pages, _ = make_pages(tmp_path, furnace_scene(0.5), tell=told.append)
    first = first_light(tmp_path, SETTINGS)

    def refuse(path, missing_ok=False):
        raise PermissionError(13, "The process cannot access the file because it is being used by another process", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(preview.Path, "unlink", refuse)
        for _ in range(preview._KEPT_TURNS + 1):
            pages.show(first)
    assert len(told) == preview._KEPT_TURNS + 1
