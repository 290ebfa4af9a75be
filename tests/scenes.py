"""Small scenes for tests: meshes of polygons, made into a SceneSnapshot."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from leaflight.core.scene.scene import Light, Material, SceneObject, SceneSnapshot

HINGE_LEFT = np.array([[0.1, 0.1], [0.3, 0.1], [0.3, 0.5], [0.1, 0.5]])  # a square's UVs, pages
HINGE_RIGHT = np.array([[0.9, 0.6], [0.9, 0.8], [0.5, 0.8], [0.5, 0.6]])  # turned by a quarter, and the shared edge elsewhere


@dataclass(frozen=True)
class Mesh:
    """An object made of polygons, each fanned from its first corner.

    vertex    (n, 3) float, m
    polygons  lists of vertex indices, counterclockwise seen from the front
    uv        one (n_corner, 2) per polygon, pages, or None for no layer
    shares    number of the mesh that it shares with others, -1 none; a mirrored one lists the same polygons and walks each fan backwards
    """

    name: str
    vertex: np.ndarray
    polygons: list[list[int]]
    uv: list[np.ndarray] | None = None
    receives: bool = True
    shares: int = -1
    mirrored: bool = False


def make_scene(meshes: Sequence[Mesh], lights: Sequence[Light] = (), materials: Sequence[Material] = (Material("Grey"),)) -> SceneSnapshot:
    """A snapshot of the meshes; all triangles have material 0."""
    tri_vertex, tri_object, tri_polygon, tri_corner, tri_uv = [], [], [], [], []
    vertex_start = 0
    for index, mesh in enumerate(meshes):
        corner_start = 0
        for number, polygon in enumerate(mesh.polygons):
            for k in range(1, len(polygon) - 1):
                fan = [0, k + 1, k] if mesh.mirrored else [0, k, k + 1]
                tri_vertex.append([vertex_start + polygon[j] for j in fan])
                tri_corner.append([corner_start + j for j in fan])
                tri_uv.append(mesh.uv[number][fan] if mesh.uv else np.zeros((3, 2)))
                tri_object.append(index)
                tri_polygon.append(number)
            corner_start += len(polygon)
        vertex_start += len(mesh.vertex)
    position = np.concatenate([np.zeros((0, 3)), *(np.asarray(mesh.vertex, np.float64) for mesh in meshes)])
    tri = np.array(tri_vertex, np.int32).reshape(-1, 3)
    edge = position[tri[:, 1:]] - position[tri[:, :1]]
    normal = np.cross(edge[:, 0], edge[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    return SceneSnapshot(
        vertex_position=position,
        tri_vertex=tri,
        tri_object=np.array(tri_object, np.int32),
        tri_material=np.zeros(len(tri), np.int32),
        tri_polygon=np.array(tri_polygon, np.int32),
        tri_corner=np.array(tri_corner, np.int32).reshape(-1, 3),
        tri_normal=np.repeat(normal[:, None], 3, axis=1).astype(np.float32),
        tri_uv=np.array(tri_uv, np.float64).reshape(-1, 3, 2),
        tri_albedo_uv=np.zeros((len(tri), 3, 2), np.float32),
        tri_emission_uv=np.zeros((len(tri), 3, 2), np.float32),
        objects=tuple(SceneObject(mesh.name, receives=mesh.receives, has_layer=mesh.uv is not None, mesh=mesh.shares) for mesh in meshes),
        materials=tuple(materials),
        lights=tuple(lights),
    )


def quad_mesh(name: str = "Quad", width_m: float = 1.0, depth_m: float = 1.0, uv: np.ndarray | None = None) -> Mesh:
    """A level quad that faces up; `uv` (4, 2) makes a layer."""
    vertex = np.array([[0, 0, 0], [width_m, 0, 0], [width_m, depth_m, 0], [0, depth_m, 0]], float)
    return Mesh(name, vertex, [[0, 1, 2, 3]], None if uv is None else [np.asarray(uv, float)])


def box_mesh(name: str = "Box", size_m: Sequence[float] = (1.0, 1.0, 1.0), centre_m: Sequence[float] = (0.0, 0.0, 0.0)) -> Mesh:
    """A box of six quads that face outwards."""
    corner = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    polygons = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    return Mesh(name, corner * np.asarray(size_m, float) + np.asarray(centre_m, float), polygons)


def grid_mesh(name: str = "Grid", cells: int = 16, noise: float = 0.0, seed: int = 1, edge_m: float = 1.0) -> Mesh:
    """Quads whose vertices are raised by normal noise of `noise` edges, which bends them."""
    x, y = np.meshgrid(np.arange(cells + 1.0), np.arange(cells + 1.0))
    height = noise * np.random.default_rng(seed).normal(size=x.shape)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    polygons = np.stack([corner, corner + 1, corner + cells + 2, corner + cells + 1], axis=1)
    return Mesh(name, edge_m * np.stack([x, y, height], axis=2).reshape(-1, 3), polygons.tolist())


def sphere_mesh(name: str = "Sphere", rings: int = 16, segments: int = 32, radius_m: float = 1.0) -> Mesh:
    """A UV sphere: quads, and triangles at its poles."""
    theta = np.pi * np.arange(1, rings) / rings
    phi = 2 * np.pi * np.arange(segments) / segments
    ring = np.stack([np.outer(np.sin(theta), np.cos(phi)), np.outer(np.sin(theta), np.sin(phi)), np.outer(np.cos(theta), 0 * phi + 1)], 2)
    vertex = np.concatenate([ring.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]]) * radius_m
    top, bottom, after = len(vertex) - 2, len(vertex) - 1, (np.arange(segments) + 1) % segments
    polygons = [[top, k, int(after[k])] for k in range(segments)]
    for row in range(rings - 2):
        start = row * segments
        polygons += [[start + k, start + segments + k, start + segments + int(after[k]), start + int(after[k])] for k in range(segments)]
    start = (rings - 2) * segments
    polygons += [[start + k, bottom, start + int(after[k])] for k in range(segments)]
    return Mesh(name, vertex, polygons)


def hinge_mesh(angle_deg: float = 0.0, uv: Sequence[np.ndarray] = (HINGE_LEFT, HINGE_RIGHT), name: str = "Hinge") -> Mesh:
    """Two unit squares that share the edge x = 1, the second turned down by an angle; each is a chart of its own."""
    x, z = 1 + np.cos(np.radians(angle_deg)), -np.sin(np.radians(angle_deg))
    vertex = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [x, 0, z], [x, 1, z]])
    return Mesh(name, vertex, [[0, 1, 2, 3], [1, 4, 5, 2]], list(uv))


def moved(mesh: Mesh, offset_m: Sequence[float] = (0.0, 0.0, 0.0), scale: float = 1.0, name: str = "") -> Mesh:
    """A scaled and moved copy."""
    return dataclasses.replace(mesh, vertex=np.asarray(mesh.vertex, float) * scale + np.asarray(offset_m, float), name=name or mesh.name)


def join_meshes(name: str, *meshes: Mesh) -> Mesh:
    """One object of the polygons of several, as Blender's Join makes it; it has a layer if all of them have one."""
    first = np.cumsum([0, *(len(mesh.vertex) for mesh in meshes)])
    polygons = [[int(start) + k for k in face] for mesh, start in zip(meshes, first, strict=False) for face in mesh.polygons]
    uv = [page for mesh in meshes for page in mesh.uv or ()]
    return Mesh(name, np.concatenate([mesh.vertex for mesh in meshes]), polygons, uv if len(uv) == len(polygons) else None)


def split_faces(mesh: Mesh) -> Mesh:
    """The same with vertices of its own for each face, as many files hold it."""
    ends = np.cumsum([0, *(len(face) for face in mesh.polygons)])
    polygons = [list(range(end - len(face), end)) for end, face in zip(ends[1:].tolist(), mesh.polygons, strict=True)]
    return dataclasses.replace(mesh, vertex=np.concatenate([np.asarray(mesh.vertex)[face] for face in mesh.polygons]), polygons=polygons)


def shared_mesh(name: str, mesh: Mesh, scale_xyz: Sequence[float] = (1.0, 1.0, 1.0), offset_m: Sequence[float] = (0.0, 0.0, 0.0)) -> Mesh:
    """A linked duplicate, scaled along the axes; a negative scale mirrors it."""
    scale = np.asarray(scale_xyz, float)
    vertex = np.asarray(mesh.vertex, float) * scale + np.asarray(offset_m, float)
    return dataclasses.replace(mesh, name=name, vertex=vertex, shares=max(mesh.shares, 0), mirrored=bool(scale.prod() < 0))


def shade_smooth(scene: SceneSnapshot) -> SceneSnapshot:
    """The scene with every vertex's corners shaded by the mean normal of its faces."""
    corner = scene.tri_position
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros_like(scene.vertex_position)
    np.add.at(total, scene.tri_vertex, normal[:, None])
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
    return dataclasses.replace(scene, tri_normal=total[scene.tri_vertex].astype(np.float32))


def quad_scene(**options: object) -> SceneSnapshot:
    """One quad_mesh."""
    return make_scene([quad_mesh(**options)])


def box_scene(**options: object) -> SceneSnapshot:
    """One box_mesh."""
    return make_scene([box_mesh(**options)])
