"""A bake leaves no trace: a dump of every data-block is the same before a bake and after its removal."""

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_dump import differences, dump
from blend_rooms import add_copy, add_object, make_material, make_quads
from leaflight.addon.read import baked_copies, uv_layer
from leaflight.addon.show import images, materials_write, restore


def build_scene():
    """Multi-material, linked duplicates, object-linked, no slot, empty slot, shared with an object that is not baked."""
    red, blue, textured = make_material("Red"), make_material("Blue"), make_material("Textured")
    tree = textured.node_tree
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("Wood", 4, 4)
    tree.links.new(tree.nodes["Principled BSDF"].inputs["Base Color"], texture.outputs["Color"])

    two = make_quads("Two", ("First", "Second"))
    two.materials.append(red)
    two.materials.append(textured)
    two.polygons[1].material_index = 1
    two.uv_layers.active_index = 1
    two.uv_layers["First"].active_render = True
    baked = [add_object("MultiA", two), add_object("MultiB", two)]
    add_object("NotBaked", two)

    linked = make_quads("Linked")
    linked.materials.append(red)
    obj = add_object("ObjectLinked", linked)
    obj.material_slots[0].link = "OBJECT"
    obj.material_slots[0].material = blue
    baked.append(obj)
    hidden_choice = add_object("ObjectChoiceUnused", linked)  # an object-level material that is not shown
    hidden_choice.material_slots[0].link = "OBJECT"
    hidden_choice.material_slots[0].material = blue
    hidden_choice.material_slots[0].link = "DATA"
    baked.append(hidden_choice)

    bare = make_quads("Bare", ())
    bare.attributes.new("material_index", "INT", "FACE").data[1].value = 1
    baked += [add_object("BareA", bare), add_object("BareB", bare)]
    empty_slot = make_quads("EmptySlot")
    empty_slot.materials.append(None)
    baked.append(add_object("EmptySlot", empty_slot))
    return [obj.name for obj in baked]


def bake(names, directory, tag="a", mode="lighting"):
    """What a driver does after a bake."""
    path = directory / f"page_{tag}.png"
    source = bpy.data.images.new("writer", 4, 4)
    source.filepath_raw, source.file_format = str(path), "PNG"
    source.save()
    bpy.data.images.remove(source)
    image = images.load_image(path)
    objects = [bpy.data.objects[name] for name in names]
    for mesh in {obj.data for obj in objects}:
        uv_layer.write_layer(mesh, np.random.default_rng(1).random((len(mesh.loops), 2)))
        sharing = [obj for obj in objects if obj.data == mesh]
        for obj in sharing if len(sharing) > 1 else ():
            uv_layer.write_place(obj, np.random.default_rng(2).random(4))
    return materials_write.assign([(obj, image) for obj in objects], mode)


@pytest.fixture
def names():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return build_scene()


@pytest.mark.parametrize("mode", ["combined", "lighting", "nodes"])
def test_removing_leaves_no_trace(names, tmp_path, mode):
    before = dump()
    assert bake(names, tmp_path, mode=mode) == []
    assert differences(before, dump())
    assert [name for name in names if uv_layer.PLACE in bpy.data.objects[name]] == ["MultiA", "MultiB", *names[2:6]]
    restore.remove_bake()
    assert differences(before, dump()) == []


def test_removing_gives_parted_meshes_back(names, tmp_path):
    before = dump()
    mesh = bpy.data.meshes["Two"]
    others = [add_object(name, mesh) for name in ("C", "D", "E")]
    wearers = [*((bpy.data.objects[name], "one") for name in names[:2]), *((obj, obj.name > "D") for obj in others)]
    left = baked_copies.part_meshes(wearers, ())
    assert left == others
    copies = [obj.data for obj in others]
    assert copies[0] == copies[1] != copies[2]
    assert mesh not in copies
    assert bake([*names, "C", "D", "E"], tmp_path) == []
    restore.remove_bake()
    assert {obj.data for obj in others} == {mesh}
    bpy.data.batch_remove(others)
    assert differences(before, dump()) == []


def test_dump_sees_a_planted_trace(names):
    before = dump()
    bpy.data.objects["MultiA"].hide_render = True
    bpy.data.materials["Red"].node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.25
    found = differences(before, dump())
    assert len(found) == 2


def test_second_bake_replaces_the_first_and_restores_the_original(names, tmp_path):
    before = dump()
    bake(names, tmp_path, "a", "combined")
    bake(names[1:], tmp_path, "b", "lighting")
    bake(names, tmp_path, "c", "lighting")
    copies = [material for material in bpy.data.materials if "leaflight_made" in material]
    textures = [node for m in copies for node in m.node_tree.nodes if node.type == "TEX_IMAGE" and node.label]
    assert {node.image.name for node in textures if node.image} == {"page_c"}
    # Red, Textured, Blue and the empty slots, with a place on the page and without: shared by objects that show the same image
    assert len(copies) == 5
    restore.remove_bake(bpy.context.scene)
    assert differences(before, dump()) == []


def test_preview_switches_both_ways(names, tmp_path):
    before = dump()
    bake(names, tmp_path)
    shown = dump()
    assert restore.has_bake(bpy.context.scene)
    assert restore.is_preview_on(bpy.context.scene)
    restore.toggle_preview(bpy.context.scene, False)
    hidden = dump()
    assert restore.has_bake(bpy.context.scene)
    assert not restore.is_preview_on(bpy.context.scene)
    for name in names:
        assert hidden[f"objects/{name}"][2] == before[f"objects/{name}"][2]
    assert restore.toggle_preview(bpy.context.scene, True) == []
    assert differences(shown, dump()) == []
    restore.toggle_preview(bpy.context.scene, False)
    restore.remove_bake()
    assert differences(before, dump()) == []


def active_layer(name):
    return bpy.data.meshes[name].uv_layers.active.name


def test_solid_view_shows_the_bake_only_while_it_is_shown(names, tmp_path):
    alone = list({bpy.data.objects[name].data: name for name in names}.values())  # the Solid view knows no place on the page
    bake(alone, tmp_path)
    for name in alone:
        obj = bpy.data.objects[name]
        assert all(slot.material.node_tree.nodes.active.image.name == "page_a" for slot in obj.material_slots)
        assert obj.data.uv_layers.active.name == "Leaflight"
    restore.toggle_preview(bpy.context.scene, False)
    assert (active_layer("Two"), active_layer("Linked")) == ("Second", "UVMap")
    bpy.data.meshes["Two"].uv_layers.active = bpy.data.meshes["Two"].uv_layers["First"]
    restore.toggle_preview(bpy.context.scene, True)
    assert active_layer("Two") == "Leaflight"
    bpy.data.meshes["Linked"].uv_layers.active = bpy.data.meshes["Linked"].uv_layers["UVMap"]  # chosen while the bake is shown
    restore.toggle_preview(bpy.context.scene, False)
    assert (active_layer("Two"), active_layer("Linked")) == ("First", "UVMap")
    restore.toggle_preview(bpy.context.scene, True)
    restore.remove_bake()
    assert (active_layer("Two"), active_layer("Linked")) == ("First", "UVMap")
    assert_nothing_of_ours()


@pytest.mark.parametrize("shown", [True, False])
def test_restores_from_a_saved_file(names, tmp_path, shown):
    """The originals survive saving, though nothing but our pointers uses some of them."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "plain.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "plain.blend"))
    before = dump()
    bake(names, tmp_path)
    copies = copy_of_array(add_array())
    assert bpy.data.images["page_a"].filepath == "//page_a.png"
    restore.toggle_preview(bpy.context.scene, shown)
    assert copies.hide_render is not shown
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "baked.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "baked.blend"))
    restore.remove_bake()
    bpy.data.batch_remove([bpy.data.objects["Array"], bpy.data.meshes["Array"]])
    assert differences(before, dump()) == []


def add_array():
    source = add_object("Array", make_quads("Array"))
    source.modifiers.new("Array", "ARRAY")
    return source


def copy_of_array(source):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    copy = baked_copies.make_copy(bpy.context.scene, source, source.evaluated_get(depsgraph), source.matrix_world)
    baked_copies.set_copies_visible(bpy.context.scene, True)
    return copy


def test_user_edits_between_are_kept_and_nothing_of_ours_stays(names, tmp_path):
    bake(names, tmp_path)
    data = bpy.data
    duplicate = add_copy(data.objects["MultiA"])
    duplicate.data = duplicate.data.copy()
    data.materials["Red"].name = "Renamed"
    data.meshes["Two"].uv_layers["Leaflight"].name = "Mine"
    data.objects["BareA"].name = "Other"
    data.objects.remove(data.objects["MultiB"])
    data.materials.remove(data.materials["Blue"])
    green = make_material("Green")
    data.objects["EmptySlot"].material_slots[0].material = green
    stray = add_object("Stray", make_quads("Stray"))  # the user put our copy on another mesh
    stray.data.materials.append(data.objects["MultiA"].material_slots[0].material)
    private = data.objects["MultiA"].material_slots[1].material.copy()  # "make single user"
    data.objects["MultiA"].material_slots[1].material = private
    restore.remove_bake()
    for obj in (data.objects["MultiA"], duplicate):
        assert [(slot.link, slot.material.name) for slot in obj.material_slots] == [("DATA", "Renamed"), ("DATA", "Textured")]
        assert [layer.name for layer in obj.data.uv_layers] == ["First", "Second"]
    assert data.objects["EmptySlot"].material_slots[0].material == green
    assert data.objects["ObjectLinked"].material_slots[0].material is None
    assert data.objects["ObjectLinked"].material_slots[0].link == "OBJECT"
    assert stray.data.materials[0].name == "Renamed"
    assert len(data.objects["Other"].material_slots) == 0
    assert_nothing_of_ours()


def test_slots_added_and_removed_between(names, tmp_path):
    obj = bpy.data.objects["MultiA"]
    obj.material_slots[1].link = "OBJECT"
    obj.material_slots[1].material = bpy.data.materials["Blue"]
    bake(names, tmp_path)
    with bpy.context.temp_override(object=obj, active_object=obj):
        obj.active_material_index = 0
        bpy.ops.object.material_slot_remove()
    bpy.data.meshes["Linked"].materials.append(make_material("New"))
    restore.remove_bake()
    assert [(slot.link, slot.material.name) for slot in obj.material_slots] == [("OBJECT", "Blue")]
    assert [slot.material.name for slot in bpy.data.objects["MultiB"].material_slots] == ["Textured"]
    assert [slot.material.name for slot in bpy.data.objects["ObjectLinked"].material_slots] == ["Blue", "New"]
    assert_nothing_of_ours()


def test_joined_objects_get_their_own_materials_back(names, tmp_path):
    """Join lays the materials that objects wear into the mesh."""
    bake(names, tmp_path)
    joined = bpy.data.objects["MultiA"]
    both = [joined, bpy.data.objects["ObjectLinked"]]
    with bpy.context.temp_override(active_object=joined, object=joined, selected_editable_objects=both):
        bpy.ops.object.join()
    assert restore.toggle_preview(bpy.context.scene, False) == []
    own = [slot.material.name for slot in joined.material_slots]
    assert set(own) == {"Red", "Textured", "Blue"}
    assert restore.toggle_preview(bpy.context.scene, True) == []
    assert all(slot.material.name.endswith(".Leaflight") for slot in joined.material_slots)
    restore.remove_bake(bpy.context.scene)
    assert [slot.material.name for slot in joined.material_slots] == own
    assert_nothing_of_ours()


def assert_nothing_of_ours():
    left = [key for key, entry in dump().items() if "leaflight" in json.dumps(entry).lower()]
    assert left == []


def test_one_undo_step_takes_a_bake_back(names, tmp_path):
    before = dump()
    bpy.ops.ed.undo_push(message="before")
    bake(names, tmp_path)
    shown = dump()
    bpy.ops.ed.undo_push(message="bake")
    bpy.ops.ed.undo()
    assert differences(before, dump()) == []
    bpy.ops.ed.redo()
    assert differences(shown, dump()) == []
    restore.remove_bake()
    assert differences(before, dump()) == []
    bpy.ops.ed.undo_push(message="removed")
    bpy.ops.ed.undo()
    assert differences(shown, dump()) == []


def test_added_slot_stays_while_another_object_shows_a_bake_in_it(names, tmp_path):
    bake(names, tmp_path)
    first, second = bpy.data.objects["BareA"], bpy.data.objects["BareB"]
    materials_write.hide([first])
    assert materials_write.is_shown(second)
    assert second.material_slots[0].material
    assert first.material_slots[0].material is None
    materials_write.hide([second])
    assert len(first.material_slots) == len(second.material_slots) == 0


def test_edit_mode_neither_crashes_nor_loses_the_bake(names, tmp_path):
    before = dump()
    bake(names, tmp_path)
    obj = bpy.data.objects["MultiA"]
    restore.toggle_preview(bpy.context.scene, False)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.mode_set(mode="EDIT")
    warnings = dict(restore.toggle_preview(bpy.context.scene, True))
    assert "leave Edit Mode" in warnings["MultiA"]
    bpy.ops.object.mode_set(mode="OBJECT")
    assert restore.toggle_preview(bpy.context.scene, True) == []
    bpy.ops.object.mode_set(mode="EDIT")
    restore.remove_bake()
    bpy.ops.object.mode_set(mode="OBJECT")
    obj.select_set(False)
    bpy.context.view_layer.objects.active = None
    assert [key for key in differences(before, dump()) if ".select" not in key] == []


@pytest.mark.parametrize(("count", "subject", "start"), [(1, "MultiA", "MultiA: the"), (3, "", "MultiA and 2 more: the")])
def test_who_lost_an_image_is_said_once(names, tmp_path, count, subject, start):
    bake(names[:count], tmp_path)
    restore.toggle_preview(bpy.context.scene, False)
    (tmp_path / "page_a.png").unlink()
    ((found, sentence),) = restore.toggle_preview(bpy.context.scene, True)
    assert found == subject
    assert sentence.startswith(f"{start} baked image")


def test_another_files_bake_is_left_to_that_file(names, tmp_path):
    bake(names, tmp_path)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, target):
        target.objects = ["MultiA", "ObjectLinked"]
    for obj in target.objects:
        bpy.context.scene.collection.objects.link(obj)
    local = add_object("Local", make_quads("Local"))
    local.data.materials.append(target.objects[0].material_slots[0].material)
    before = dump()
    assert not restore.has_bake(bpy.context.scene)
    restore.toggle_preview(bpy.context.scene, False)
    restore.remove_bake()
    assert differences(before, dump()) == []
    bake(["Local"], tmp_path, "b")
    restore.remove_bake()
    assert differences(before, dump()) == []
