"""What has changed since a bake: said of every kind of change, of nothing else, and before Refine works in vain."""

import json
from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import PanelContext, add_twin, make_material, open_room, save_baked, use_addon
from leaflight.addon.app.changes import ChangeWatch
from leaflight.addon.show import restore
from leaflight.addon.show.scene_prints import PRINTS, describe_changes, list_changes, print_scene, read_marked
from leaflight.addon.ui import panels

pytestmark = pytest.mark.usefixtures("baked_room")


@pytest.fixture(scope="module")
def baked(tmp_path_factory):
    """A folder with a file that wears a bake: a mirrored cube shown by a copy, twins of one mesh, materials by node trees, and a world."""
    with use_addon():
        open_room()
        scene, cube = bpy.context.scene, bpy.data.objects["Cube"]
        cube.modifiers.new("Mirror", "MIRROR").use_axis = (False, False, True)
        add_twin()
        material = make_material("Wall")
        ramp = material.node_tree.nodes.new("ShaderNodeValToRGB")
        material.node_tree.links.new(material.node_tree.nodes["Principled BSDF"].inputs["Base Color"], ramp.outputs[0])
        cube.data.materials.append(material)
        scene.world = bpy.data.worlds.new("Sky")
        scene.world.use_nodes = True
        return save_baked(tmp_path_factory.mktemp("baked"), size=32)


def find_changes():
    bpy.context.view_layer.update()
    return list_changes(read_marked(bpy.context.scene).prints, print_scene(bpy.context.scene, bpy.context.view_layer))


def test_nothing_has_changed_whatever_is_shown(tmp_path):
    assert find_changes() == []
    bpy.ops.leaflight.toggle_preview()
    assert find_changes() == []
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other.blend"))
    assert find_changes() == []
    bpy.data.objects["Floor"].select_set(True)
    bpy.data.materials["Wall"].node_tree.nodes[0].location.x += 100.0
    bpy.data.objects["Cube"].modifiers[0].show_viewport = False
    assert find_changes() == []


def move_vertex():
    bpy.data.objects["Floor"].data.vertices[0].co.z = 0.5


def add_lamp():
    bpy.ops.object.light_add(type="SUN")


def delete_lamp():
    bpy.data.objects.remove(bpy.data.objects["Lamp"])


def set_ramp():
    bpy.data.materials["Wall"].node_tree.nodes["Color Ramp"].color_ramp.elements[0].color = (1.0, 0.0, 0.0, 1.0)


def unlink():
    tree = bpy.data.materials["Wall"].node_tree
    tree.links.remove(next(link for link in tree.links if link.to_socket.name == "Base Color"))


def set_world():
    next(node for node in bpy.data.worlds["Sky"].node_tree.nodes if node.type == "BACKGROUND").inputs["Strength"].default_value = 3.0


def hide_floor():
    bpy.data.objects["Floor"].hide_render = True


def set_user_uv():
    bpy.data.objects["Cube"].data.uv_layers["UVMap"].uv[0].vector = (0.9, 0.9)


@pytest.mark.parametrize(
    ("change", "names"),
    [
        (lambda: setattr(bpy.data.objects["Lamp"].data, "energy", 7.0), ["Lamp"]),
        (lambda: setattr(bpy.data.objects["Lamp"].data, "shadow_soft_size", 0.7), ["Lamp"]),
        (lambda: setattr(bpy.data.objects["Twin"].location, "y", 1.0), ["Twin"]),
        (lambda: setattr(bpy.data.objects["Cube"].modifiers[0], "use_axis", (True, False, True)), ["Cube"]),
        (lambda: setattr(bpy.data.objects["Twin"].leaflight, "role", "CAST"), ["Twin"]),
        (move_vertex, ["Floor", "Twin"]),
        (set_user_uv, ["Cube"]),
        (add_lamp, ["Sun (new)"]),
        (delete_lamp, ["Lamp (gone)"]),
        (hide_floor, ["Floor (gone)"]),
        (set_ramp, ["Wall"]),
        (unlink, ["Wall"]),
        (set_world, ["Sky"]),
    ],
)
def test_a_change_has_a_name(change, names):
    change()
    assert find_changes() == names


def test_a_sun_is_the_same_light_wherever_it_stands():
    add_lamp()
    sun = bpy.data.objects["Sun"]

    def read():
        bpy.context.view_layer.update()
        return print_scene(bpy.context.scene, bpy.context.view_layer)

    before = read()
    sun.location = (3.0, -2.0, 7.0)
    assert read() == before
    sun.rotation_euler.x = 0.5
    assert list_changes(before, read()) == ["Sun"]


def draw():
    """What the panel says."""
    texts = []

    class Layout:
        def __getattr__(self, name):
            def call(*args, **options):
                texts.extend(str(value) for value in (options.get("text"),) if value)
                return Layout() if name != "panel" else (Layout(), None)

            return call

    panels.LEAFLIGHT_PT_main.draw(SimpleNamespace(layout=Layout()), PanelContext())
    return " ".join(texts)


def test_the_panel_says_so_and_forgets_it_when_the_change_is_undone():
    watch = bpy.context.window_manager.leaflight_changes
    bpy.ops.ed.undo_push(message="opened")
    draw()
    assert watch.look(bpy.context)
    assert "out of date" not in draw()
    bpy.data.objects["Lamp"].data.energy = 7.0
    bpy.context.view_layer.update()
    assert watch.stale
    watch.look(bpy.context)
    assert "Changed since this bake: Lamp" in draw()
    assert "Show Old Bake" in draw()
    bpy.ops.ed.undo_push(message="lamp")
    bpy.ops.ed.undo()
    draw()
    assert watch.look(bpy.context)
    assert "out of date" not in draw()


def mark_as_of_another_blender():
    """Another version prints the same scene otherwise."""
    kept = json.loads(bpy.context.scene[PRINTS])
    bpy.context.scene[PRINTS] = json.dumps({**kept, "prints": dict.fromkeys(kept["prints"], "0"), "blender": "4.2"})


def test_of_a_bake_by_another_blender_only_later_changes_are_told():
    mark_as_of_another_blender()
    watch = bpy.context.window_manager.leaflight_changes
    for energy, is_told in ((None, False), (7.0, True)):
        if energy:
            bpy.data.objects["Lamp"].data.energy = energy
            bpy.context.view_layer.update()
        for _ in range(2):  # the second time as after an undo
            draw()
            assert watch.look(bpy.context)
            assert ("Changed since this bake: Lamp." in draw()) == ("out of date" in draw()) == is_told
            watch.clear()


def test_a_bake_of_a_part_calls_no_bake_by_another_blender_out_of_date():
    mark_as_of_another_blender()
    bpy.data.objects["Floor"].select_set(True)
    bpy.context.scene.leaflight.objects = "SELECTED"
    bpy.ops.leaflight.bake()
    assert read_marked(bpy.context.scene).older == ()


def test_a_mesh_is_read_again_when_it_changed_and_little_by_little():
    watch = ChangeWatch()
    watch.watch(bpy.context)
    turns = 1
    while not watch.look(bpy.context, 0.0):
        turns += 1
    assert turns > 3
    assert watch.names == []
    mesh = bpy.data.objects["Floor"].data
    move_vertex()
    watch.note({mesh.session_uid})
    watch.look(bpy.context)
    assert watch.names == ["Floor", "Twin"]


def test_refine_says_so_before_it_works():
    bpy.data.objects["Lamp"].data.energy = 7.0
    with pytest.raises(
        RuntimeError, match=r"Changed since this bake: Lamp\. Refine cannot go on from it: press Bake, or undo the change\."
    ):
        bpy.ops.leaflight.refine()
    assert restore.is_preview_on(bpy.context.scene)


def test_a_bake_of_a_part_after_a_change_leaves_the_others_out_of_date():
    bpy.data.objects["Lamp"].data.energy = 7.0
    bpy.data.objects["Floor"].select_set(True)
    bpy.context.scene.leaflight.objects = "SELECTED"
    bpy.ops.leaflight.bake()
    assert find_changes() == []
    assert read_marked(bpy.context.scene).older == ("Lamp",)
    assert "Changed between two bakes: Lamp. What was not selected shows the older light" in draw()
    bpy.context.scene.leaflight.objects = "ALL"
    bpy.ops.leaflight.bake()
    assert read_marked(bpy.context.scene).older == ()


def test_removing_forgets_it_and_damaged_marks_say_nothing():
    scene = bpy.context.scene
    scene[PRINTS] = "{"
    assert read_marked(scene) is None
    draw()
    bpy.ops.leaflight.remove()
    assert PRINTS not in scene


def test_many_changes_are_one_line():
    assert describe_changes(["A", "B"]) == "Changed since this bake: A, B"
    assert describe_changes("ABCDE") == "Changed since this bake: A, B, C and 2 more"


def test_what_geometry_nodes_are_given_is_noticed():
    """Blender 5.3 keeps it elsewhere than those before."""
    open_room()
    group = bpy.data.node_groups.new("Grow", "GeometryNodeTree")
    for name, way, kind in (("Mesh", "INPUT", "Geometry"), ("Size", "INPUT", "Float"), ("Mesh", "OUTPUT", "Geometry")):
        group.interface.new_socket(name, in_out=way, socket_type=f"NodeSocket{kind}")
    size = next(one.identifier for one in group.interface.items_tree if one.name == "Size")
    modifier = bpy.data.objects["Cube"].modifiers.new("Grow", "NODES")
    scene, layer = bpy.context.scene, bpy.context.view_layer
    bare = print_scene(scene, layer)
    modifier.node_group = group
    before = print_scene(scene, layer)
    assert list_changes(bare, before) == ["Cube"]
    assert print_scene(scene, layer) == before
    if hasattr(modifier, "properties"):
        getattr(modifier.properties.inputs, size).value = 2.0
    else:
        modifier[size] = 2.0
    assert list_changes(before, print_scene(scene, layer)) == ["Cube"]
