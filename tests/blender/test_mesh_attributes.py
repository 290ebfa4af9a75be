"""Attributes of meshes that materials show: as a render with Cycles shows them."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_nodes import add_glow, render_from_above
from blend_rooms import add_object
from leaflight.addon.nodes.socket_bake import SocketBaker
from leaflight.addon.read.export_mesh import read_mesh
from leaflight.addon.read.export_scene import export_scene
from leaflight.addon.read.mesh_attributes import list_wanted_attributes
from leaflight.core.scene.materials import SurfaceMaterials

pytestmark = pytest.mark.usefixtures("empty_file")

SIDE = 8  # pixels
FIELD = {"FLOAT_VECTOR": "vector", "FLOAT2": "vector", "FLOAT_COLOR": "color", "BYTE_COLOR": "color_srgb"}
FIRST = {"FLOAT": 0.125, "FLOAT2": (0.125, 0.5), "FLOAT_VECTOR": (0.125, 0.5, 1.0), "FLOAT_COLOR": (0.125, 0.5, 1.0, 0.75)}
FIRST |= {"BYTE_COLOR": (0.125, 0.5, 0.9, 0.75), "INT": 1, "INT8": 1, "BOOLEAN": True}


def make_values(kind, count):
    """Of each element another, so that the means of edges are no whole numbers."""
    first = FIRST[kind]
    if kind == "BOOLEAN":
        return [k % 4 == 0 for k in range(count)]
    if kind in ("INT", "INT8"):
        return [first + k * k % 5 for k in range(count)]
    return [tuple(np.multiply(first, (1 + k) / count)) if isinstance(first, tuple) else first * (1 + k) for k in range(count)]


def show_attribute(kind, domain, output="Color", node_type="ShaderNodeAttribute"):
    """Two triangles that shine with an attribute; an edge without a face hangs on one of their corners."""
    mesh = bpy.data.meshes.new("Square")
    mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (-1, 1, 0), (1, 1, 0), (0, 0, -3)], [(0, 4)], [(0, 1, 2), (1, 3, 2)])
    add_object("Square", mesh)
    tree, color = add_glow(mesh)
    node = tree.nodes.new(node_type)
    setattr(node, "attribute_name" if node_type == "ShaderNodeAttribute" else "layer_name", "x")
    source = node.outputs[2] if output == "Fac" else node.outputs[output]  # its name differs between versions
    tree.links.new(source, color)
    attribute = mesh.attributes.new("x", kind, domain)
    for element, value in zip(attribute.data, make_values(kind, len(attribute.data)), strict=True):
        setattr(element, FIELD.get(kind, "value"), value)
    return mesh


def read_glow():
    """(SIDE, SIDE, 3) what it shines with, seen from above, row 0 at the bottom; and what is told of the material."""
    result = export_scene(bpy.context)
    y, x = ((np.mgrid[:SIDE, :SIDE] + 0.5) / SIDE).astype(np.float32)
    tri = np.where(x + y < 1.0, 0, 1)
    corner = {0: (1.0 - x - y, x), 1: (1.0 - y, x + y - 1.0)}  # weights of the first two corners
    weight = [np.where(tri == 0, corner[0][k], corner[1][k]).ravel() for k in (0, 1)]
    glow = SurfaceMaterials(result.snapshot).emission.at(tri.ravel(), weight[1], 1.0 - weight[0] - weight[1])
    return glow.reshape(SIDE, SIDE, 3), dict(result.warnings).get("Glow", "")


def check_against_cycles(folder):
    glow, told = read_glow()
    assert told == ""
    rendered = render_from_above(folder, SIDE)
    off_diagonal = ~np.fliplr(np.eye(SIDE, dtype=bool))
    np.testing.assert_allclose(glow[off_diagonal], rendered[off_diagonal], atol=2e-3 * max(1.0, rendered.max()))
    return rendered


@pytest.mark.parametrize("kind", FIRST)
@pytest.mark.parametrize("domain", ["EDGE", "POINT", "CORNER", "FACE"])
def test_attributes_are_shown_as_cycles_shows_them(kind, domain, tmp_path):
    show_attribute(kind, domain)
    assert np.ptp(check_against_cycles(tmp_path), axis=(0, 1)).max() > 0.05


@pytest.mark.parametrize("output", ["Fac", "Alpha", "Vector"])
@pytest.mark.parametrize("kind", FIRST)
def test_outputs_of_edges_are_those_of_cycles(kind, output, tmp_path):
    show_attribute(kind, "EDGE", output)
    assert check_against_cycles(tmp_path).any()


@pytest.mark.parametrize("kind", ["FLOAT_COLOR", "BYTE_COLOR"])  # Blender 5.0 crashes where it is no colour
@pytest.mark.parametrize("output", ["Color", "Alpha"])
def test_a_color_attribute_node_shows_edges_too(kind, output, tmp_path):
    show_attribute(kind, "EDGE", output, "ShaderNodeVertexColor")
    check_against_cycles(tmp_path)


@pytest.mark.parametrize("kind", ["INT", "INT8"])
@pytest.mark.parametrize(("edges", "expected"), [((2, 3), 3.0), ((4, 5), 5.0), ((0, 1), 1.0), ((2, 2), 2.0)])
def test_whole_numbers_of_edges_stay_whole(kind, edges, expected):
    mesh = show_attribute(kind, "EDGE")
    for element, edge in zip(mesh.attributes["x"].data, mesh.edges, strict=True):
        element.value = edges[edge.vertices[0] == 1] if 3 in edge.vertices else 0
    rgba = read_mesh(mesh, frozenset("x")).colors["x"]
    assert rgba[[loop.vertex_index == 3 for loop in mesh.loops]].tolist() == [[expected] * 3 + [1.0]]


def test_only_what_is_asked_for_is_read_besides_colours():
    mesh = show_attribute("FLOAT", "POINT")
    mesh.attributes.new("Col", "FLOAT_COLOR", "CORNER")
    mesh.attributes.new("edges", "FLOAT_COLOR", "EDGE")
    assert list_wanted_attributes() == {"x"}
    assert set(read_mesh(mesh).colors) == {"Col", ""}
    assert set(read_mesh(mesh, list_wanted_attributes()).colors) == {"Col", "", "x"}


def test_a_node_within_a_group_asks_too():
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    node = group.nodes.new("ShaderNodeAttribute")
    node.attribute_name = "inner"
    other = group.nodes.new("ShaderNodeAttribute")
    other.attribute_type, other.attribute_name = "OBJECT", "outer"
    group.nodes.new("ShaderNodeVertexColor").layer_name = "color"
    assert list_wanted_attributes() == {"inner", "color"}


def test_what_is_not_read_is_told(monkeypatch):
    monkeypatch.setattr(SocketBaker, "bake", lambda *_, **__: None)
    mesh = show_attribute("FLOAT", "EDGE")
    mesh.attributes.remove(mesh.attributes["x"])
    mesh.attributes.new("x", "QUATERNION", "EDGE")
    glow, told = read_glow()
    assert glow == pytest.approx(0.5)
    assert "replaced by a grey of 0.5, for attribute x is of a kind that is not read" in told
