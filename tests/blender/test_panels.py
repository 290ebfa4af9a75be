"""What the panel draws, on a layout that only takes notes."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import PanelContext, add_mesh, make_material
from leaflight.addon.app import properties
from leaflight.addon.app.bake_state import BakeState
from leaflight.addon.app.estimate import Estimate
from leaflight.addon.show import layout, view_shading
from leaflight.addon.show.bake_text import Worn
from leaflight.addon.ui import panel_parts, panels
from leaflight.core.util.messages import Progress, Status


class Layout:
    """Notes labels, operators and properties of itself and of all its parts; an operator is (name, its properties)."""

    def __init__(self, labels, operators, props):
        self.labels, self.operators, self.props = labels, operators, props

    def label(self, text="", icon="NONE"):
        self.labels.append(text)

    def operator(self, name, **_):
        self.operators.append((name, SimpleNamespace()))
        return self.operators[-1][1]

    def panel(self, *_, **__):
        return self, self

    def prop(self, _, name, **__):
        self.props.append(name)

    def separator(self):
        pass

    def prop_enum(self, _, name, *__):
        self.props.append(name)

    def progress(self, **_):
        pass

    def row(self, **_):
        return Layout(self.labels, self.operators, self.props)

    column = box = split = grid_flow = row


@pytest.fixture(autouse=True)
def _warned(addon_room):
    """A bake has a warning: an object has no faces."""
    add_mesh("Nothing", [], [])


def draw(context=None):
    """Labels and operators of the panel, in their order."""
    layout = Layout([], [], [])
    panels.LEAFLIGHT_PT_main.draw(SimpleNamespace(layout=layout), context or PanelContext())
    return layout.labels, layout.operators


def draw_group(name):
    """Properties that the panel of a group of settings draws."""
    cls = next(cls for cls in panels.CLASSES if cls.bl_label == name)
    layout = Layout([], [], [])
    cls.draw(type("Drawn", (cls.__mro__[1],), {"special": cls.special, "group": name, "layout": layout})(), PanelContext())
    return layout.props


def tells(words):
    return any(words in label for label in draw()[0])


def test_warnings_go_with_the_bake_that_they_are_of():
    assert not tells("has no faces")
    bpy.ops.leaflight.bake()
    assert tells("has no faces")
    assert tells("1 page of 32 x 32")
    for obj in bpy.data.objects:
        obj.pop("leaflight_bake", None)  # as an undo step leaves it
    assert not tells("has no faces")
    assert not tells("1 page of 32 x 32")


def test_an_error_stands_where_it_came_from():
    first, other = bpy.context.scene, bpy.data.scenes.new("Other")
    bpy.data.objects["Lamp"].hide_render = True
    with pytest.raises(RuntimeError, match="the scene has no light"):
        bpy.ops.leaflight.bake()
    assert tells("The scene has no light")
    bpy.context.window.scene = other
    assert not tells("The scene has no light")
    bpy.data.scenes.remove(first)
    assert tells("The scene has no light"), "else nobody would tell of it"


def test_lines_begin_with_a_capital_letter_but_for_names(state):
    bpy.data.objects["Floor"].name = "floor"
    bpy.context.window_manager.leaflight_meter.measure(bpy.context)
    for error, line in (("floor: is odd", "floor: is odd"), ("the floor is odd", "The floor is odd")):
        state.fail(error, bpy.context.scene.session_uid)
        labels = [label for label in draw()[0] if label]
        assert line in labels
        assert not [label for label in labels if label[0].islower() and not label.startswith("floor")]


def test_what_is_urgent_stands_above_the_result_and_the_plan(state):
    """A low window shows the first lines only."""
    bpy.ops.leaflight.bake()
    meter, changes = bpy.context.window_manager.leaflight_meter, bpy.context.window_manager.leaflight_changes
    meter.measure(bpy.context)
    bpy.data.objects["Lamp"].data.energy = 50.0
    bpy.context.view_layer.update()
    changes.watch(bpy.context)
    changes.look(bpy.context)

    def find_places(*words):
        labels = draw()[0]
        return [next(i for i, label in enumerate(labels) if word in label) for word in words]

    places = find_places("Lamp. The light that you see is out of date", "has no faces", "Baked in", " texels, ")
    assert places == sorted(places)
    state.begin(Lasting(), 0.0, [("Nothing", "Nothing: has no faces")], scene=bpy.context.scene.session_uid)
    places = find_places("Starting", "has no faces", "Baked in")
    assert places == sorted(places), "Stop, which stands with the progress, stays where it is"
    state.end()
    bpy.data.objects["Lamp"].hide_render = True
    with pytest.raises(RuntimeError, match="the scene has no light"):
        bpy.ops.leaflight.bake()
    meter.measure(bpy.context)
    places = find_places("The scene has no light", "has no faces", "Baked in", " texels, ")
    assert places == sorted(places)
    bpy.context.scene.leaflight.output = "//maps"  # of a file that is not saved, which is said with a button
    assert [name for name, _ in draw()[1]][:2] == ["leaflight.bake", "wm.save_as_mainfile"]


def test_every_button_has_a_tooltip():
    buttons = [getattr(bpy.ops.leaflight, name).get_rna_type() for name in dir(bpy.ops.leaflight)]
    assert len(buttons) >= 10
    assert not [one.identifier for one in buttons if len(one.description.split()) < 3 or one.description.startswith("(")]


def test_what_may_not_fit_a_page_is_told_before_the_bake():
    chosen, meter = bpy.context.scene.leaflight, bpy.context.window_manager.leaflight_meter
    told = []
    for density in (1.0, 15.0, 150.0):
        chosen.size, chosen.padding, chosen.density = 64, 1, density
        meter.measure(bpy.context)
        told.append([label for label in draw()[0] if "baked less finely" in label])
    assert told == [
        [],
        ["Floor: about as large as a page at this density: may be baked less finely"],
        ["Cube, Floor: larger than a page at this density: baked less finely"],
    ]


def test_what_is_evened_out_is_told():
    chosen, meter = bpy.context.scene.leaflight, bpy.context.window_manager.leaflight_meter
    chosen.size = 512
    bpy.data.objects["Floor"].scale = (50.0, 50.0, 1.0)
    told = []
    for chosen.even_out in (True, False):
        meter.measure(bpy.context)
        told.append([label for label in draw()[0] if "Even Out:" in label])
    assert told == [["Even Out: 1 object finer"], []]


def test_who_takes_the_page_is_named_with_a_button():
    meter = bpy.context.window_manager.leaflight_meter
    bpy.context.scene.leaflight.density = 0.5  # nobody evens that out
    bpy.data.objects["Floor"].scale = (3.0, 3.0, 1.0)
    meter.measure(bpy.context)
    labels, buttons = draw()
    assert [label for label in labels if " of the texels" in label] == ["Floor takes 96 % of the texels"]
    assert [one.names for name, one in buttons if name == "leaflight.select"] == ["Floor"]


def test_the_folder_that_is_opened_is_that_of_the_bake(tmp_path):
    """Not the one that the next bake will make."""
    bpy.ops.leaflight.bake()
    bpy.context.scene.leaflight.output = str(tmp_path / "not there yet")
    opened = [one.filepath for name, one in draw()[1] if name == "wm.path_open"]
    assert opened == [str(tmp_path / "maps")]


def test_a_bake_that_failed_takes_no_numbers_from_the_one_before(state):
    bpy.ops.leaflight.bake()
    bpy.data.lights[0].energy = 0.0
    with pytest.raises(RuntimeError, match="light"):
        bpy.ops.leaflight.bake()
    assert tells(state.error[1:].split(": ")[0])
    assert tells("1 page of 32 x 32")


def test_the_view_that_does_not_show_the_bake_is_switched_by_a_button():
    def is_offered(shading):
        context = PanelContext()
        context.space_data = SimpleNamespace(shading=SimpleNamespace(**shading))
        return "leaflight.show_it" in [name for name, _ in draw(context)[1]]

    default = {"type": "SOLID", "color_type": "MATERIAL"}
    assert not is_offered(default), "nothing is baked yet"
    bpy.ops.leaflight.bake()
    assert is_offered(default)
    assert is_offered({"type": "WIREFRAME", "color_type": "MATERIAL"})
    assert not is_offered({"type": "SOLID", "color_type": "TEXTURE"})
    assert not is_offered({"type": "MATERIAL", "color_type": "MATERIAL"})
    bpy.ops.leaflight.toggle_preview()
    assert not is_offered(default), "it is hidden at the user's wish"


def test_a_view_is_switched_and_switched_back():
    screen = bpy.context.screen
    area = next(area for area in screen.areas if area.type == "VIEW_3D")
    shading, scene = area.spaces.active.shading, bpy.context.scene
    shading.type, shading.color_type, shading.light = "WIREFRAME", "OBJECT", "MATCAP"
    bpy.ops.leaflight.bake()
    view_shading.show_bake(screen, area, scene)
    assert (shading.type, shading.color_type, shading.light) == ("SOLID", "TEXTURE", "FLAT")
    view_shading.restore_views()
    assert shading.color_type == "TEXTURE", "the scene wears its bake still"
    bpy.ops.leaflight.remove()
    assert shading.type == "WIREFRAME"
    shading.type = "SOLID"
    assert (shading.color_type, shading.light) == ("OBJECT", "MATCAP")
    assert not list(screen.keys())


def test_a_view_that_the_user_changed_meanwhile_stays():
    screen = bpy.context.screen
    area = next(area for area in screen.areas if area.type == "VIEW_3D")
    bpy.ops.leaflight.bake()
    view_shading.show_bake(screen, area, bpy.context.scene)
    area.spaces.active.shading.type = "WIREFRAME"
    bpy.ops.leaflight.remove()
    assert area.spaces.active.shading.type == "WIREFRAME"


def add_duplicate():
    again = bpy.data.objects["Floor"].copy()
    again.location.z = 3.0
    bpy.context.collection.objects.link(again)


def add_leaf():
    material = make_material("Leaf")
    tree = material.node_tree
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("Leaf", 2, 2)
    tree.links.new(texture.outputs["Alpha"], tree.nodes["Principled BSDF"].inputs["Alpha"])
    bpy.data.objects["Cube"].data.materials.append(material)


def light_up():
    bpy.data.objects["Lamp"].data.energy *= 1000.0


@pytest.mark.parametrize(("change", "kind"), [(None, "SOLID"), (add_duplicate, "MATERIAL"), (add_leaf, "MATERIAL"), (light_up, "MATERIAL")])
def test_what_solid_view_cannot_show_is_shown_in_material_preview(change, kind):
    """Objects' own parts of a page, gaps, and light that is brighter than white nearly everywhere."""
    screen = bpy.context.screen
    if change:
        change()
    area = next(area for area in screen.areas if area.type == "VIEW_3D")
    bpy.ops.leaflight.bake()
    view_shading.show_bake(screen, area, bpy.context.scene)
    assert area.spaces.active.shading.type == kind


def test_a_reopened_file_says_what_it_wears(tmp_path):
    bpy.ops.leaflight.bake()
    before = draw()[0]
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    after = draw()[0]
    assert tells("1 page of 32 x 32 texels")
    assert tells("has no faces")
    assert [line for line in before if "Baked in" in line] == [line for line in after if "Baked in" in line] != []


def test_the_worst_object_is_selected_by_a_button(state):
    bpy.ops.leaflight.bake()
    lines = ("Baked in 9 s", "Error 4.8 %", "Worst object: Floor, 38 %")
    layout.mark_result(bpy.context.scene, Worn(lines, worst="Floor", details=("12 leaves",)))
    assert [one.names for name, one in draw()[1] if name == "leaflight.select"][:1] == ["Floor"]
    assert tells("12 leaves")


def test_no_button_moves_when_the_scene_changes():
    """What says that it is measured takes the place of a line."""
    bpy.ops.leaflight.bake()
    meter = bpy.context.window_manager.leaflight_meter
    meter.measure(bpy.context)
    calm = draw()
    meter.note(set())
    stale = draw()
    assert tells("The scene changed: measuring...")
    assert len(stale[0]) == len(calm[0])
    assert [name for name, _ in stale[1]] == [name for name, _ in calm[1]]


def test_edit_mode_is_left_by_a_button():
    assert "object.mode_set" not in [name for name, _ in draw()[1]]
    bpy.context.view_layer.objects.active = bpy.data.objects["Floor"]
    bpy.ops.object.mode_set(mode="EDIT")
    (button,) = [properties for name, properties in draw()[1] if name == "object.mode_set"]
    bpy.ops.object.mode_set(mode=button.mode)
    assert bpy.context.mode == "OBJECT"


class Lasting:
    """A bake that unwraps until it is ended."""

    def messages(self):
        yield Status("charts", "Unwrapping")

    def cancel(self):
        pass

    def kill(self):
        pass


def test_no_second_click_stops_or_discards_a_bake(state):
    """What a press of Bake shows there is no button, and Discard does not come in the place of Stop."""

    def names():
        return [name for name, _ in draw()[1] if name.startswith("leaflight.")]

    assert names()[0] == "leaflight.bake"
    state.begin(Lasting(), 0.0, [], scene=bpy.context.scene.session_uid)
    assert names() == ["leaflight.stop"]
    bpy.ops.leaflight.stop()
    assert names() == ["leaflight.discard", "leaflight.stop"]
    assert not bpy.ops.leaflight.stop.poll(), "it stands there still, and does nothing more"
    assert not state.discarded
    bpy.ops.leaflight.discard()
    assert state.discarded
    state.end()


def test_the_progress_of_another_scene_says_whose_it_is(state):
    state.begin(Lasting(), 0.0, [], scene=bpy.context.scene.session_uid)
    assert not tells("Baking the scene")
    bpy.context.window.scene = bpy.data.scenes.new("Other")
    assert tells("Baking the scene Scene")
    state.end()


def test_the_papers_settings_are_shown_to_those_who_ask():
    research = next(cls for cls in panels.CLASSES if cls.bl_label == "Research")
    assert not research.poll(bpy.context)
    bpy.context.scene.leaflight.basis = "quadratic"
    assert research.poll(bpy.context), "a bake would heed it"
    bpy.context.scene.leaflight.basis = "linear"
    assert not research.poll(bpy.context)
    context = PanelContext()
    asked = SimpleNamespace(preferences=SimpleNamespace(research=True))
    context.preferences = SimpleNamespace(addons={"leaflight": asked})
    assert research.poll(context)


def test_artists_find_no_settings_of_the_paper_elsewhere():
    shown = {name for group in ("Quality", "Lightmap", "Output", "Advanced") for name in draw_group(group)}
    assert not shown & {
        "oracle",
        "basis",
        "stability",
        "threshold",
        "preview_depth",
        "min_level",
        "hierarchical",
        "finest_texels",
    }
    assert {"error_of", "max_photons_text", "time_limit_text", "denoise", "seams", "seed", "workers_text"} <= shown


def test_numbers_are_written_as_people_write_them():
    chosen = bpy.context.scene.leaflight
    assert (chosen.max_photons_text, chosen.time_limit_text) == ("64 M", "")
    chosen.max_photons_text, chosen.time_limit_text = "2.5 M", "5 min"
    assert (chosen.max_photons, chosen.time_limit) == (2_500_000, 300.0)
    chosen.max_photons_text, chosen.time_limit_text = "lots", "soon"
    assert (chosen.max_photons, chosen.time_limit) == (2_500_000, 300.0), "what is no number changes nothing"
    chosen.max_photons_text, chosen.time_limit_text = "1", ""
    assert (chosen.max_photons, chosen.time_limit) == (1000, 0.0), "the least that there may be, and no limit"


def test_the_error_is_a_percentage():
    chosen = bpy.context.scene.leaflight
    assert chosen.error_percent == pytest.approx(50.0)
    chosen.error_percent = 7.5
    assert properties.make_settings(chosen).error == 0.075
    chosen.error_percent = 0.0
    assert properties.make_settings(chosen).error == pytest.approx(1e-4), "the least that there may be"


def test_presets_keep_the_settings(monkeypatch, tmp_path):
    written = {}
    monkeypatch.setattr(bpy.utils, "user_resource", lambda *_, **__: str(tmp_path))
    chosen = bpy.context.scene.leaflight
    chosen.size, chosen.main_pass, chosen.passes, chosen.formats = 128, "lighting", {"albedo"}, {"exr", "png"}
    assert bpy.ops.leaflight.preset_add(name="Small") == {"FINISHED"}
    chosen.size, chosen.main_pass, chosen.passes, chosen.formats = 512, "combined", set(), {"exr"}
    exec(next(tmp_path.rglob("Small.py")).read_text(), written)
    assert (chosen.size, chosen.main_pass, chosen.passes, chosen.formats) == (128, "lighting", {"albedo"}, {"exr", "png"})


def test_no_line_is_cut_at_the_sidebars_own_width():
    """Blender's sidebar is 280 pixels wide by itself: behind an icon in a box there is room for 182 of text, before it for 205."""
    import blf

    blf.size(0, 11)
    small = tuple((f"Pot {number}", 31.6) for number in range(1999))
    many = {"objects": 20_000, "area_m2": 123_456.0, "density": 1234.0, "texels": 16_777_216, "pages": 14, "page_size": 8192}
    estimate = Estimate(**many, memory_mb=12_345.0, seconds=(150.0, 750.0), evened=small)
    known = replace(estimate, seconds=(45_000.0, 45_000.0))
    lines = [*panel_parts.describe_estimate(estimate), *panel_parts.describe_evened(estimate), *panel_parts.describe_estimate(known)]
    cut = [line for line in [*lines, "The scene changed: measuring..."] if blf.dimensions(0, line)[0] > 182]
    for stage in ("Tracing photons", "Indirect light", "Direct light"):
        state = BakeState(stage=stage, progress=Progress(0.5, 64_000_000, 1e6, 0.123, 60.0, 1000))
        cut += [line for line in state.describe() if blf.dimensions(0, line)[0] > 205]
    assert not cut


def test_what_was_planned_is_said_while_it_is_baked(state):
    """Although reading a scene that has something hidden in the viewport changes it for a moment."""
    bpy.data.objects["Cube"].hide_viewport = True
    bpy.context.view_layer.update()
    meter = bpy.context.window_manager.leaflight_meter
    meter.measure(bpy.context)
    planned = panel_parts.describe_estimate(meter.estimate)
    bpy.ops.leaflight.bake()
    assert list(state.plan) == planned
