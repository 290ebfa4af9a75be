"""A bake's way out of Blender and back, without the process between."""

import dataclasses
import errno
import sys
from dataclasses import replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_copy, list_files, make_geometry_nodes, make_material, open_room, save_scene
from leaflight.addon.app import session
from leaflight.addon.app.arguments import BakeRequest
from leaflight.addon.app.job import library_paths
from leaflight.addon.read import tags, uv_layer
from leaflight.addon.show import restore
from leaflight.core.bake.bake import run_bake
from leaflight.core.scene.snapshot import list_arrays, load_snapshot
from leaflight.core.util.job import JOB_FILE, LAYOUT_FILE, SNAPSHOT_FILE, Job
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=32, error=0.5, max_photons=5000, workers=1)


@pytest.fixture(autouse=True)
def _room(monkeypatch):
    open_room()
    monkeypatch.setattr(sys, "path", [*sys.path, *library_paths()])


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "job"
    path.mkdir()
    return path


@pytest.fixture
def request_(tmp_path):
    return BakeRequest(SETTINGS, output=tmp_path / "maps")


def prepare(request, folder):
    return session.prepare(bpy.context, request, folder)


def bake(request, folder, between=lambda: None):
    """A whole bake; what happens `between` is the user's doing meanwhile. Gives the warnings."""
    work = prepare(request, folder)
    run_bake(folder, lambda message: None, lambda: False)
    between()
    return session.assign(bpy.context, work, session.read_result(work))


def shown_images(name):
    """Names of the images in an object's materials."""
    trees = [slot.material.node_tree for slot in bpy.data.objects[name].material_slots if slot.material]
    return {node.image.name for tree in trees for node in tree.nodes if node.type == "TEX_IMAGE" and node.image}


def test_job_says_what_was_asked(request_, folder, tmp_path):
    prepare(dataclasses.replace(request_, began=2.5), folder)
    assert list_files(folder) == sorted([JOB_FILE, SNAPSHOT_FILE])
    job = Job.load(folder)
    assert job == Job(SETTINGS, str(tmp_path / "maps"), "lightmap", began=2.5, after_s=job.after_s)
    assert 0.0 < job.after_s < 10.0
    assert [one.name for one in load_snapshot(folder / SNAPSHOT_FILE).objects] == ["Cube", "Floor"]


def test_pages_are_named_after_the_file(request_, folder, tmp_path):
    save_scene(tmp_path / "Küche 2.blend")
    prepare(request_, folder)
    assert Job.load(folder).atlas_name == "Küche 2"
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_plane_add()
    prepare(replace(request_, scene=tmp_path / "model.glb"), folder)
    assert Job.load(folder).atlas_name == "model"


def test_bake_is_shown_on_every_object(request_, folder):
    assert bake(request_, folder) == []
    for name in ("Floor", "Cube"):
        assert shown_images(name) == {"lightmap_0.combined"}
        uv = np.empty(2 * len(bpy.data.objects[name].data.loops), np.float32)
        bpy.data.objects[name].data.uv_layers["Leaflight"].uv.foreach_get("vector", uv)
        assert uv.min() >= 0.0
        assert uv.max() <= 1.0
        assert np.ptp(uv) > 0.05


def test_the_first_pass_and_format_are_shown(request_, folder):
    bake(replace(request_, settings=replace(SETTINGS, passes=("lighting", "albedo"), formats=("png", "exr"))), folder)
    image = bpy.data.images["lightmap_0.lighting"]
    assert image.filepath.endswith("lightmap_0.lighting.png")
    assert shown_images("Floor") == {image.name}


def add_twins(*scales):
    """Linked duplicates of the cube, and their names with its own."""
    cube = bpy.data.objects["Cube"]
    for k, scale in enumerate(scales):
        twin = add_copy(cube)
        twin.name, twin.location.x, twin.scale = f"Twin {k}", 1.5 + k, scale
    return ["Cube", *(f"Twin {k}" for k in range(len(scales)))]


def read_uv(name, layer="Leaflight"):
    """What an object's lightmap is looked up with: its UVs, put in their place where it has one."""
    obj = bpy.data.objects[name]
    uv = np.empty((len(obj.data.loops), 2), np.float32)
    obj.data.uv_layers[layer].uv.foreach_get("vector", uv.reshape(-1))
    place = np.array(obj.get(uv_layer.PLACE, (1, 1, 0, 0)))
    return uv * place[:2] + place[2:]


@pytest.mark.parametrize("options", [{}, {"atlas": False}])
def test_linked_duplicates_keep_sharing_their_mesh(request_, folder, options):
    names = add_twins((1, 1, 1), (-2, 2, 2), (1, 1, 1.5))
    assert bake(replace(request_, settings=replace(SETTINGS, size=64, **options)), folder) == []
    assert {bpy.data.objects[name].data for name in names} == {bpy.data.meshes["Cube"]}
    layout, snapshot = np.load(folder / LAYOUT_FILE), load_snapshot(folder / SNAPSHOT_FILE)
    for i, one in enumerate(snapshot.objects):
        rows = snapshot.tri_object == i
        np.testing.assert_allclose(read_uv(one.name)[snapshot.tri_corner[rows]], layout["tri_uv"][rows], atol=1e-6)
    assert len({tuple(bpy.data.objects[name][uv_layer.PLACE]) for name in names}) == (4 if options.get("atlas", True) else 1)
    assert len({frozenset(shown_images(name)) for name in names}) == (1 if not options else len(set(layout["object_page"][:4])))
    restore.remove_bake(bpy.context.scene)
    assert not any(uv_layer.PLACE in obj for obj in bpy.data.objects)


def test_who_is_too_unlike_the_others_wears_a_copy_of_the_mesh_and_is_told(request_, folder):
    names = add_twins((1, 1, 1), (20, 1, 1), (20, 1, 1))
    warnings = bake(replace(request_, settings=replace(SETTINGS, size=64)), folder)
    assert [subject for subject, text in warnings if "too unlike the others" in text] == names[2:]
    data = [bpy.data.objects[name].data for name in names]
    assert data[0] == data[1] == bpy.data.meshes["Cube"]
    assert data[2] == data[3] != data[0]
    restore.remove_bake(bpy.context.scene)
    assert {bpy.data.objects[name].data for name in names} == {bpy.data.meshes["Cube"]}


@pytest.mark.parametrize(("scale", "options"), [((20, 1, 1), {}), ((1, 1, 1), {"share_meshes": False})])
def test_copies_of_meshes_are_no_change_of_the_scene(request_, folder, scale, options):
    names = add_twins((1, 1, 1), scale)
    request = replace(request_, settings=replace(SETTINGS, size=64, **options))
    bake(request, folder)
    assert len({bpy.data.objects[name].data for name in names}) > 1
    assert prepare(request, folder).kept


def test_linked_duplicates_with_a_layer_of_the_users_have_an_image_each(request_, folder):
    """Their UVs are the same by design, so they cannot share a page."""
    names = add_twins((1, 1, 1))
    bake(replace(request_, uv_layer="UVMap"), folder)
    assert {bpy.data.objects[name].data for name in names} == {bpy.data.meshes["Cube"]}
    assert not shown_images(names[0]) & shown_images(names[1])
    assert not any(uv_layer.PLACE in obj for obj in bpy.data.objects)


def test_an_earlier_bake_is_not_baked_and_stays_shown(request_, folder, tmp_path):
    clean = prepare(request_, folder).export.snapshot
    first = tmp_path / "first"
    first.mkdir()
    bake(request_, first)
    assert restore.is_preview_on(bpy.context.scene)
    again = prepare(request_, folder).export.snapshot
    assert (again.materials, again.images) == (clean.materials, clean.images)
    assert restore.is_preview_on(bpy.context.scene)
    with pytest.raises(ValueError, match="no such object"):
        prepare(replace(request_, objects=("Cubus",)), folder)
    assert restore.is_preview_on(bpy.context.scene)


def wear_unlike_materials():
    """The cube by a slot of its own, the floor by none, and a grid whose half of one material Geometry Nodes lift."""
    cube, paint, other = bpy.data.objects["Cube"], make_material("Paint"), make_material("Other")
    cube.data.materials.append(other)
    cube.material_slots[0].link, cube.material_slots[0].material = "OBJECT", paint
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=2, y_subdivisions=1, location=(0.0, 0.0, 3.0))
    grid = bpy.context.object
    for material in (paint, other):
        grid.data.materials.append(material)
    grid.data.polygons[1].material_index = 1
    tree, lift = make_geometry_nodes("GeometryNodeSetPosition")
    selection = tree.nodes.new("GeometryNodeMaterialSelection")
    selection.inputs["Material"].default_value, lift.inputs["Offset"].default_value = paint, (0.0, 0.0, 0.5)
    tree.links.new(selection.outputs[0], lift.inputs["Selection"])
    grid.modifiers.new("Lift", "NODES").node_group = tree


def note_slots():
    """How each slot is linked, and whether it shows a bake, and over what."""
    return {
        obj.name: [(slot.link, tags.is_made(slot.material), tags.find_original(slot.material)) for slot in obj.material_slots]
        for obj in bpy.data.objects
    }


@pytest.mark.parametrize("layer", ["", "UVMap"])  # of ours, of the user's
def test_a_scene_that_wears_a_bake_is_read_as_without(request_, folder, tmp_path, layer):
    wear_unlike_materials()
    request, first = replace(request_, uv_layer=layer), tmp_path / "first"
    first.mkdir()
    clean = list_arrays(prepare(request, folder).export.snapshot)
    bake(request, first)
    shown = note_slots()
    assert {"Cube", "Floor"} <= {name for name in shown if shown_images(name)}
    again = list_arrays(prepare(request, folder).export.snapshot)
    assert [name for name in clean if not np.array_equal(clean[name], again[name])] == []
    assert note_slots() == shown


def link_room(path):
    """Another file that shows the objects of a saved one."""
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(path), link=True) as (found, wanted):
        wanted.objects = found.objects
    for obj in wanted.objects:
        bpy.context.scene.collection.objects.link(obj)


@pytest.mark.parametrize("has_material", [False, True])
def test_a_linked_file_that_wears_its_bake_is_read_as_without(request_, folder, tmp_path, has_material):
    read, first = [], tmp_path / "first"
    first.mkdir()
    for wears in (False, True):
        open_room()
        if has_material:
            material = make_material("Paint")
            material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.8, 0.1, 0.1, 1.0)
            bpy.data.objects["Floor"].data.materials.append(material)
        if wears:
            bake(request_, first)
        link_room(tmp_path / f"room {wears}.blend")
        export = prepare(request_, folder).export
        read.append((export.snapshot.materials, export.snapshot.images, {text for _, text in export.warnings}))
    assert read[0] == read[1]


def delete_cube():
    bpy.data.objects.remove(bpy.data.objects["Cube"])


def edit_cube():
    bpy.data.objects["Cube"].data.clear_geometry()


@pytest.mark.parametrize("between", [delete_cube, edit_cube])
def test_what_the_user_changed_meanwhile_is_told_and_the_rest_is_shown(request_, folder, between):
    warnings = bake(request_, folder, between)
    assert [subject for subject, _ in warnings] == ["Cube"]
    assert "was deleted or edited during the bake" in warnings[0][1]
    assert shown_images("Floor") == {"lightmap_0.combined"}


def test_an_object_renamed_meanwhile_is_still_found(request_, folder):
    def rename():
        bpy.data.objects["Cube"].name = "Box"

    assert bake(request_, folder, rename) == []
    assert shown_images("Box") == {"lightmap_0.combined"}


def test_check_folder_makes_it_and_leaves_nothing(tmp_path):
    session.check_folder(tmp_path / "a" / "b")
    assert list_files(tmp_path / "a" / "b") == []
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"file/c: is no folder that can be written \(Not a directory\); choose another one\.$"):
        session.check_folder(tmp_path / "file" / "c")


def test_trying_a_folder_touches_nothing_that_is_there(tmp_path):
    """Neither what another bake tries it with nor where links lead."""
    victim = tmp_path / "victim.txt"
    victim.write_text("the user's")
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / ".leaflight_probe").symlink_to(victim)
    session.check_folder(tmp_path / "maps")
    assert victim.read_text() == "the user's"
    assert (tmp_path / "maps" / ".leaflight_probe").is_symlink()


def test_check_file(tmp_path, monkeypatch):
    session.check_file(tmp_path / "new" / "report.json")
    assert list_files(tmp_path / "new") == []
    with pytest.raises(OSError, match=r"new: is a folder; give the name of a file\.$"):
        session.check_file(tmp_path / "new")
    (tmp_path / "old.json").write_text("{}")
    session.check_file(tmp_path / "old.json")
    monkeypatch.setattr(session.os, "access", lambda *_: False)  # root may write everywhere
    with pytest.raises(OSError, match=r"old\.json: is write-protected;"):
        session.check_file(tmp_path / "old.json")


def test_temporary_folder_without_room(request_, folder, monkeypatch):
    def fail(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(session, "save_snapshot", fail)
    with pytest.raises(OSError, match=r"the scene cannot be kept there \(No space left on device\); make room, or set TMPDIR"):
        prepare(request_, folder)
