"""SceneSnapshot: everything that the core knows of a scene, as a frozen struct of arrays.

Units are metres and watts; colours are linear Rec.709 RGB; coordinates are in world space, +Z up. An index of -1 means none.
"""

import math
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import BoolArray, Float32, Float64, Int32, Int64

Rgb: TypeAlias = tuple[float, float, float]
# Kinds of rays as in Cycles, which traces from the receiver: by how a ray left the last surface. SHADOW rays go toward lamps.
RAY_KINDS = DIFFUSE, GLOSSY, TRANSMISSION, SHADOW = 0, 1, 2, 3
SEEN_BY_ALL: tuple[Rgb, Rgb, Rgb] = ((1.0, 1.0, 1.0),) * 3
MAX_ALBEDO = 0.999  # photons between whiter surfaces would be reflected for ever
# The texture coordinates of a SceneSnapshot, and the images of a Material that use each.
TEXTURE_UVS = {
    "tri_albedo_uv": ("albedo_image",),
    "tri_emission_uv": ("emission_image",),
    "tri_passing_uv": ("passing_image", "shadow_passing_image", "glossy_passing_image", "transmission_passing_image"),
    "tri_normal_uv": ("normal_image",),
    "tri_metal_uv": ("metal_image",),
    "tri_glass_uv": ("glass_image",),
    "tri_through_uv": ("through_image",),
    "tri_lobe_uv": ("lobe_image",),
}
# The arrays of a SceneSnapshot: shape of a row, one for each triangle, or vertex; and whether its numbers are floats or integers.
ARRAYS: dict[str, tuple[tuple[int, ...], str]] = {
    "vertex_position": ((3,), "f"),
    "tri_vertex": ((3,), "i"),
    "tri_object": ((), "i"),
    "tri_material": ((), "i"),
    "tri_polygon": ((), "i"),
    "tri_corner": ((3,), "i"),
    "tri_normal": ((3, 3), "f"),
    "tri_uv": ((3, 2), "f"),
    **dict.fromkeys(TEXTURE_UVS, ((3, 2), "f")),
    "tri_tangents": ((3, 3, 3), "f"),
}


@dataclass(frozen=True)
class SceneObject:
    """One object; its triangles are tri_object == its index in SceneSnapshot.objects."""

    name: str
    receives: bool = True  # gets a lightmap; other objects only emit, reflect and block light
    two_sided: bool = False  # light on both sides of a face is summed
    has_layer: bool = False  # tri_uv has an existing UV layer, which is used as it is
    casts_shadow: bool = True
    # Whether diffuse, glossy and transmission rays see it; those that do not pass through it.
    seen_by: tuple[bool, bool, bool] = (True, True, True)
    lights: tuple[int, ...] | None = None  # as in Light, for the emission of its materials
    blocked_by: tuple[int, ...] | None = None
    mesh: int = -1  # objects with the same number share a mesh, so they may share UVs; -1 for a mesh of its own
    sides: str = ""  # one of settings.SIDES; "" for that of the settings
    density_factor: float = 1.0  # its texels per metre relative to other objects'; without effect on an object with a layer


@dataclass(frozen=True)
class Material:
    """Diffuse reflectance, emitted radiance and transmittance, each a constant times an optional image.

    Transmittance is the share of the arriving light that goes straight through the surface, albedo the share that is reflected; per channel
    they add up to at most 1.
    """

    name: str
    albedo_rgb: Rgb = (0.8, 0.8, 0.8)
    albedo_image: int = -1
    emission_rgb: Rgb = (0.0, 0.0, 0.0)  # W/m^2/sr, strength included
    emission_image: int = -1
    passing_rgb: Rgb = (0.0, 0.0, 0.0)  # for diffuse rays
    passing_image: int = -1
    shadow_passing_rgb: Rgb | None = None  # for shadow rays; None if it equals passing_rgb
    shadow_passing_image: int = -1  # with shadow_passing_rgb
    glossy_passing_rgb: Rgb | None = None  # for glossy rays, likewise
    glossy_passing_image: int = -1
    transmission_passing_rgb: Rgb | None = None  # for transmission rays, likewise
    transmission_passing_image: int = -1
    # Shares of reflected and refracted light, and of emission, that diffuse, glossy and transmission rays see.
    seen_rgb: tuple[Rgb, Rgb, Rgb] = SEEN_BY_ALL
    glow_rgb: tuple[Rgb, Rgb, Rgb] = SEEN_BY_ALL
    # Factors on the transmittance from behind and in front, each at even steps of the cosine between the normal and the direction to the
    # viewer from 0 to 1; () where it is alike from everywhere.
    passing_views: tuple[tuple[float, ...], ...] = ()
    back_rgb: Rgb = (1.0, 1.0, 1.0)  # factor on what the back reflects, relative to the front
    dark_back: bool = False  # the back emits nothing
    dark_front: bool = False  # nor does the front
    normal_image: int = -1  # unit shading normals in world space instead of those at the corners; with normal_strength a normal map
    normal_strength: float | None = None  # of a normal map in tangent space, with values 0 to 1 as in its file, relative to tri_tangents
    metal_rgb: Rgb = (0.0, 0.0, 0.0)  # the part of the albedo that a metal reflects specularly
    metal_image: int = -1
    metal: float = 1.0  # mean share of the surface that is metal
    metal_edge_rgb: Rgb = (1.0, 1.0, 1.0)  # tint of the metal's reflection at 82 degrees, on Schlick's formula
    metal_flat: bool = False  # the metal reflects equally at all angles, instead of by Schlick's formula
    lobe_image: int = -1  # channels are roughness, share of metal and share with a layer, instead of the three means
    layer: float = 0.0  # share of the surface that has a dielectric layer above the diffuse part
    diffuse: float = 1.0  # share of the surface that is diffuse; the layer and the coat cover as much of it as they can
    roughness: float = 0.5  # of the metal and of the layer; GGX's alpha is its square
    ior: float = 1.5  # of the layer
    multiscatter: bool = True  # metal and layer are compensated for the energy that single scattering loses
    layer_tint: float = 1.0  # factor on the layer's reflection at normal incidence; at grazing angles it reflects all
    coat: float = 0.0  # share of the surface that has a clear coat above everything else
    coat_roughness: float = 0.03
    coat_ior: float = 1.5
    coat_tint_rgb: Rgb = (1.0, 1.0, 1.0)  # of a path of length 1; colours below hold that of the mean path already
    # Share of the surface with sheen, times its tint; the albedo contains its reflection.
    sheen_rgb: Rgb = (0.0, 0.0, 0.0)
    sheen_roughness: float = 0.5
    glass_rgb: Rgb = (0.0, 0.0, 0.0)  # tint of what glass refracts, times the share of the surface that is glass
    glass_image: int = -1
    glass_mirror_rgb: Rgb = (0.0, 0.0, 0.0)  # tint of what glass reflects, times the same share
    glass_fresnel: bool = True  # reflection follows Fresnel's equations; else nothing is reflected
    glass_roughness: float = 0.0  # GGX's alpha is its square; in place of it the roughness of lobe_image, if there is one
    glass_multiscatter: bool = True
    glass_ior: float = 1.5  # index behind the faces over that before them
    through_rgb: Rgb = (0.0, 0.0, 0.0)  # the part of the albedo that leaves diffusely on the other side
    through_image: int = -1

    @property
    def has_sides(self) -> bool:
        """Whether its front and its back differ."""
        return bool(self.passing_views) or self.back_rgb != (1.0, 1.0, 1.0) or self.dark_back or self.dark_front

    @property
    def images(self) -> tuple[int, ...]:
        """All images, -1 for none."""
        return tuple(getattr(self, image) for images in TEXTURE_UVS.values() for image in images)


@dataclass(frozen=True)
class TextureImage:
    """A texture in linear Rec.709.

    pixels   (height, width, 3) float32, row 0 at the bottom
    """

    name: str
    pixels: Float32
    extension: str = "REPEAT"  # REPEAT, EXTEND, CLIP or MIRROR, as in Blender
    closest: bool = False  # no interpolation
    per_triangle: bool = False  # 2 x 2 texels for each triangle: its three corners, and one that makes the colour linear between them


@dataclass(frozen=True)
class Light:
    """A Blender light; units as in Blender (see docs/units.md).

    rotation     rows are the light's world-space unit x, y and z axes; it shines along -z
    power_rgb    W for POINT, SPOT and AREA; W/m^2 facing it for SUN; exposure, colour and diffuse_factor included
    """

    kind: str  # POINT SPOT SUN AREA
    name: str
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[tuple[float, float, float], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    power_rgb: Rgb = (0.0, 0.0, 0.0)
    radius_m: float = 0.0  # POINT and SPOT
    soft_falloff: bool = True  # POINT and SPOT: a disk that faces each receiver, else a sphere
    cone_angle_rad: float = 0.0  # SPOT: full opening angle
    blend: float = 0.0  # SPOT: 0 hard ... 1 soft
    angle_rad: float = 0.0  # SUN: full angle of its disk
    shape: str = "RECTANGLE"  # AREA: RECTANGLE or ELLIPSE; square and disk are their equal-sided cases
    size_m: tuple[float, float] = (1.0, 1.0)  # AREA: full extents along the light's x and y
    spread_rad: float = float(np.pi)  # AREA: pi is Lambertian
    casts_shadow: bool = True
    profile: int = -1  # POINT: index into SceneSnapshot.profiles
    lights: tuple[int, ...] | None = None  # indices of the objects that it lights; None for all
    blocked_by: tuple[int, ...] | None = None  # indices of the objects that block it; None for all
    seen_by: tuple[bool, bool, bool] = (True, True, True)  # by diffuse, glossy and transmission rays


@dataclass(frozen=True)
class SceneSnapshot:
    """Triangles, materials, textures, lights and world of one frame.

    vertex_position   (n_vertex, 3) float64, m
    tri_vertex        (n_tri, 3) int32
    tri_object        (n_tri,) int32       index into objects; triangles of an object are consecutive
    tri_material      (n_tri,) int32       index into materials
    tri_polygon       (n_tri,) int32       polygon of the object's mesh; its triangles are consecutive
    tri_corner        (n_tri, 3) int32     corner (loop) of the object's mesh, to write UVs back
    tri_normal        (n_tri, 3, 3) float32   unit shading normal at each corner
    tri_uv            (n_tri, 3, 2) float64   existing lightmap UV in [0, 1], where the object has_layer; else 0
    tri_albedo_uv     (n_tri, 3, 2) float32   texture UV of the albedo image, mapping applied
    tri_emission_uv   (n_tri, 3, 2) float32   the same for the emission image
    world_rgb         uniform radiance of the world, W/m^2/sr
    world_map         (h, w, 3) float32, W/m^2/sr, or None: radiance of the world by direction, which replaces world_rgb; laid out as in
                      sphere_map. Suns should be taken out of it first (environment_suns)
    profiles          (h, w) float32 each, mean 1 over the sphere: a lamp's intensity by direction relative to the mean; laid out as in
                      sphere_map, in the lamp's own axes
    tri_passing_uv    (n_tri, 3, 2) float32   as tri_albedo_uv, for images of transmittance; zeros if it is left out
    tri_normal_uv     (n_tri, 3, 2) float32   likewise, for images of normals
    tri_metal_uv      (n_tri, 3, 2) float32   likewise, for images of metals' colours
    tri_glass_uv      (n_tri, 3, 2) float32   likewise, for images of glass
    tri_through_uv    (n_tri, 3, 2) float32   likewise, for images of translucency
    tri_lobe_uv       (n_tri, 3, 2) float32   likewise, for images of roughness and shares
    tri_tangents      (n_tri, 3, 3, 3) float32   tangent, bitangent and normal at each corner for normal maps in tangent space, in world
                      space, with a common scale; zeros for triangles without such a map; of length 0 if no triangle has one
    """

    vertex_position: Float64
    tri_vertex: Int32
    tri_object: Int32
    tri_material: Int32
    tri_polygon: Int32
    tri_corner: Int32
    tri_normal: Float32
    tri_uv: Float64
    tri_albedo_uv: Float32
    tri_emission_uv: Float32
    objects: tuple[SceneObject, ...]
    materials: tuple[Material, ...]
    images: tuple[TextureImage, ...] = ()
    lights: tuple[Light, ...] = ()
    world_rgb: Rgb = (0.0, 0.0, 0.0)
    world_map: Float32 | None = None
    profiles: tuple[Float32, ...] = ()
    tri_passing_uv: Float32 = field(default_factory=lambda: np.zeros((0, 3, 2), np.float32))
    tri_normal_uv: Float32 = field(default_factory=lambda: np.zeros((0, 3, 2), np.float32))
    tri_metal_uv: Float32 = field(default_factory=lambda: np.zeros((0, 3, 2), np.float32))
    tri_glass_uv: Float32 = field(default_factory=lambda: np.zeros((0, 3, 2), np.float32))
    tri_through_uv: Float32 = field(default_factory=lambda: np.zeros((0, 3, 2), np.float32))
    tri_lobe_uv: Float32 = field(default_factory=lambda: np.zeros((0, 3, 2), np.float32))
    tri_tangents: Float32 = field(default_factory=lambda: np.zeros((0, 3, 3, 3), np.float32))

    def __post_init__(self) -> None:
        for name in TEXTURE_UVS:
            if name not in ("tri_albedo_uv", "tri_emission_uv") and not len(getattr(self, name)):  # the dataclass is frozen
                object.__setattr__(self, name, np.zeros((len(self.tri_vertex), 3, 2), np.float32))
        error = _first_error(self)
        if error:
            raise ValueError(error)

    @property
    def n_tri(self) -> int:
        return len(self.tri_vertex)

    @property
    def tri_position(self) -> Float64:
        """(n_tri, 3, 3) float64, m: corner positions."""
        return self.vertex_position[self.tri_vertex]

    @property
    def tri_translucent(self) -> BoolArray:
        """(n_tri,) bool: triangles from which light leaves diffusely on the other side too."""
        return np.array([any(one.through_rgb) for one in self.materials], bool)[self.tri_material]

    @property
    def first_tri(self) -> Int64:
        """(n_object + 1,) int64: triangles of object i are first_tri[i]:first_tri[i + 1]."""
        return np.searchsorted(self.tri_object, np.arange(len(self.objects) + 1))


def swap_corners(values: NDArray[Any], tri_turned: BoolArray) -> NDArray[Any]:
    """A copy of values (n_tri, 3, ...) at corners, with corners 1 and 2 of triangles tri_turned (n_tri,) bool exchanged."""
    out = values.copy()
    out[tri_turned] = values[tri_turned][:, [0, 2, 1]]
    return out


def _first_error(scene: SceneSnapshot) -> str:
    n_tri = len(scene.tri_vertex)
    free = ["vertex_position", *(["tri_tangents"] if all(one.normal_strength is None for one in scene.materials) else [])]
    for name, (row, _) in ARRAYS.items():
        found = getattr(scene, name).shape
        expected = (found[0] if name in free and found else n_tri, *row)
        if found != expected:
            return f"{name}: expected shape {expected}, got {found}"
    ranges = (("tri_vertex", len(scene.vertex_position)), ("tri_object", len(scene.objects)), ("tri_material", len(scene.materials)))
    for name, count in ranges:
        values = getattr(scene, name)
        if n_tri and (values.min() < 0 or values.max() >= count):
            return f"{name}: expected indices 0 to {count - 1}, got {values.min()} to {values.max()}"
    if scene.world_map is not None and (scene.world_map.ndim != 3 or scene.world_map.shape[2] != 3 or not scene.world_map.size):
        return f"world_map: expected shape (height, width, 3), got {scene.world_map.shape}"
    for light in scene.lights:
        if light.profile >= len(scene.profiles):
            return f"{light.name}: names a profile that is not in the snapshot"
        if any(not 0 <= number < len(scene.objects) for chosen in (light.lights, light.blocked_by) for number in chosen or ()):
            return f"{light.name}: is linked to an object that is not in the snapshot"
    if not np.isfinite(scene.vertex_position).all():
        return "vertex_position: expected finite coordinates"
    for one in scene.objects:
        if not (math.isfinite(one.density_factor) and one.density_factor > 0.0):
            return f"{one.name}: expected a density factor above 0, got {one.density_factor:g}"
    for material in scene.materials:
        if max(material.images) >= len(scene.images):
            return f"{material.name}: names an image that is not in the snapshot"
    return ""
