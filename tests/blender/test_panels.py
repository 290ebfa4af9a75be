"""What the panel draws, on a layout that only takes notes."""

from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

import leaflight
from blend_rooms import ask_quick_bake, open_room
from leaflight.addon.ui import panels


class Layout:
    """Notes labels and operators of itself and of all its parts; an operator is (name, its properties)."""

    def __init__(self, labels, operators):
        self.labels, self.operators = labels, operators

    def label(self, text="", icon="NONE"):
        self.labels.append(text)

    def operator(self, name, **_):
        self.operators.append((name, SimpleNamespace()))
        return self.operators[-1][1]

    def panel(self, _):
        return self, self

    def prop(self, *_, **__):
        pass

    def progress(self, **_):
        pass

    def row(self, **_):
        return Layout(self.labels, self.operators)

    column = box = split = row


class Context:
    """Blender's, with a region and its scale, which it has with a window only."""

    region = SimpleNamespace(width=10_000)
    preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0))

    def __getattr__(self, name):
        return getattr(bpy.context, name)


@pytest.fixture(autouse=True)
def _room(tmp_path):
    """A small quick bake that has a warning: the cube casts no shadow."""
    leaflight.register()
    open_room()
    bpy.data.objects["Cube"].visible_shadow = False
    ask_quick_bake(tmp_path / "maps")
    yield
    leaflight.unregister()


@pytest.fixture
def state():
    return bpy.context.window_manager.leaflight_state


def draw():
    """Labels and operators of the panel, in their order."""
    layout = Layout([], [])
    panels.LEAFLIGHT_PT_main.draw(SimpleNamespace(layout=layout), Context())
    return layout.labels, layout.operators


def tells(words):
    return any(words in label for label in draw()[0])


def test_warnings_go_with_the_bake_that_they_are_of():
    assert not tells("casts no shadow")
    bpy.ops.leaflight.bake()
    assert tells("casts no shadow")
    assert tells("1 page of 32 x 32")
    for obj in bpy.data.objects:
        obj.pop("leaflight_bake", None)  # as an undo step leaves it
    assert not tells("casts no shadow")
    assert not tells("1 page of 32 x 32")


def test_another_scene_is_told_nothing():
    bpy.ops.leaflight.bake()
    other = bpy.data.scenes.new("Other")
    obj = bpy.data.objects["Floor"].copy()
    other.collection.objects.link(obj)
    bpy.context.window.scene = other
    assert "leaflight_bake" in obj
    assert not tells("casts no shadow")
    assert not tells("1 page of 32 x 32")


def test_an_error_stands_where_it_came_from():
    first, other = bpy.context.scene, bpy.data.scenes.new("Other")
    bpy.data.objects["Lamp"].hide_render = True
    with pytest.raises(RuntimeError, match="the scene has no light"):
        bpy.ops.leaflight.bake()
    assert tells("the scene has no light")
    bpy.context.window.scene = other
    assert not tells("the scene has no light")
    bpy.data.scenes.remove(first)
    assert tells("the scene has no light"), "else nobody would tell of it"


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
    assert tells(state.error.split(": ")[0])
    assert tells("1 page of 32 x 32")
