"""Colours and transmittance of surfaces at hits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..util.arrays import BoolArray, Float32, FloatArray, Int32, IntArray
from ..util.geometry import gather, locate_hits, triangle_frames, triangle_normals_areas
from .scene import DIFFUSE, GLOSSY, MAX_ALBEDO, RAY_KINDS, SEEN_BY_ALL, SHADOW, TRANSMISSION, Material, Rgb, SceneSnapshot
from .textures import Textures, clamp_colours, sample_texture

# A quantity has the fields <name>_rgb and <name>_image of a material and the coordinates tri_<name>_uv. Its greatest value, and its name
# in warnings:
_QUANTITIES = {
    "albedo": (MAX_ALBEDO, "albedo"),
    "emission": (float(np.finfo(np.float32).max), "emission"),
    "metal": (MAX_ALBEDO, "metal"),
    "glass": (1.0, "glass"),
    "through": (MAX_ALBEDO, "translucency"),
    "passing": (1.0, "transmittance"),
}
_PASSINGS = ("passing", "glossy_passing", "transmission_passing", "shadow_passing")  # by the kind of ray
_LEAST_TOLD = 2.0 - MAX_ALBEDO  # in place of MAX_ALBEDO: the clamp of white is invisible
_PIXELS_OF_ROW = 64


@dataclass(frozen=True)
class Layer:
    """One quantity of all surfaces: a colour per triangle times an optional image.

    tri_rgb      (3, n_tri) float32, already clamped where there is no image
    tri_image    (n_tri,) int32, -1 for none; None if no triangle has one
    tri_uv       (3, 2, n_tri) float32: from triangle_frames; empty without images
    highest      upper limit of the product
    """

    tri_rgb: Float32
    tri_image: Int32 | None
    tri_uv: Float32
    textures: Textures
    highest: float

    @classmethod
    def of(cls, scene: SceneSnapshot, rgb: Iterable[Rgb], image: Iterable[int], tri_uv: Float32, highest: float) -> Layer:
        """The layer of each material's colour and image."""
        material_image = np.array([*image], np.int32)
        plain = material_image < 0
        with np.errstate(over="ignore", invalid="ignore"):  # as in `at`
            material_rgb = np.array([*rgb], np.float64).reshape(-1, 3).astype(np.float32)
            material_rgb[plain] = clamp_colours(material_rgb[plain], highest)
            tri_rgb = np.ascontiguousarray(material_rgb[scene.tri_material].T)
            tri_image = material_image[scene.tri_material]
            if not (tri_image >= 0).any():
                return cls(tri_rgb, None, np.zeros((3, 2, 0), np.float32), Textures([]), highest)
            return cls(tri_rgb, tri_image, triangle_frames(tri_uv), Textures(scene.images), highest)

    @classmethod
    def of_quantity(cls, scene: SceneSnapshot, name: str) -> Layer:
        """The layer of one of _QUANTITIES."""
        rgb, image = ([getattr(one, f"{name}_{field}") for one in scene.materials] for field in ("rgb", "image"))
        return cls.of(scene, rgb, image, getattr(scene, f"tri_{name}_uv"), _QUANTITIES[name][0])

    def fill(self, tri: BoolArray, value: float) -> Layer:
        """The layer with one value on triangles tri (n_tri,)."""
        if not tri.any():
            return self
        image = None if self.tri_image is None else np.where(tri, np.int32(-1), self.tri_image)
        return replace(self, tri_rgb=np.where(tri, np.float32(value), self.tri_rgb), tri_image=image)

    @property
    def has_images(self) -> bool:
        """Whether it varies over any triangle."""
        return self.tri_image is not None

    def at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> Float32:
        """Values at points of triangles.

        tri    (n,) int      u, v   (n,) float, barycentric weights of corners 1 and 2
        out    (n, 3) float32; its transpose is contiguous
        """
        rgb = gather(self.tri_rgb, tri)
        if self.tri_image is not None:
            image = gather(self.tri_image, tri)
            textured = (image >= 0).nonzero()[0]
            if len(textured):
                tri, u, v = gather(tri, textured), gather(u, textured), gather(v, textured)
                with np.errstate(over="ignore", invalid="ignore"):  # overflowing values are not finite, and count as 0
                    shown = self.textures.at(gather(image, textured), locate_hits(self.tri_uv, tri, u, v).T)
                    product = clamp_colours(gather(rgb, textured) * shown.T, self.highest)
                for channel, values in zip(rgb, product, strict=True):  # numpy is three times as fast row by row
                    channel[textured] = values
        return rgb.T


class SurfaceMaterials:
    """The layers of a scene's materials; a value is a single gather where no image is involved.

    albedo        diffuse reflectance, within [0, MAX_ALBEDO]
    reflectance   the same, but 0 on objects that rays between surfaces do not see: the share of light that other surfaces get
    metal         the part of the reflectance that a metal reflects specularly
    through       the part of the reflectance that leaves diffusely on the other side
    emission      emitted radiance, W/m^2/sr, finite and >= 0
    glass         tint of light that glass refracts, times the share of the surface that is glass
    lobes         roughness, and the shares of the surface that are metal and that have a dielectric layer, within [0, 1]
    tri_glass     (n_tri,) bool: glass that rays between surfaces see
    tri_through   (n_tri,) bool: translucent triangles, from which light leaves diffusely on the other side too
    tri_both      (n_tri,) bool: translucent triangles, whose texels show the light of both sides, see share_sides; but on two-sided
                  objects, whose texels have the sum
    tri_seen      (3, 3, n_tri) float32: share of a surface's outgoing light that diffuse, glossy and transmission rays see, by channel;
                  None if all see all
    by_kind       whether these kinds of rays between surfaces differ in any way
    """

    def __init__(self, scene: SceneSnapshot) -> None:
        materials = scene.materials
        kinds = find_ray_kinds(materials)
        seen_by = np.array([[one.seen_by[kind] for one in scene.objects] for kind in kinds], bool)
        unseen = ~seen_by.any(axis=0)[scene.tri_object]
        self.albedo, self.emission, self.glass = (Layer.of_quantity(scene, name) for name in ("albedo", "emission", "glass"))
        self.reflectance = self.albedo.fill(unseen, 0.0)
        self.metal, self.through = (Layer.of_quantity(scene, name).fill(unseen, 0.0) for name in ("metal", "through"))
        lobes = [(one.roughness, one.metal, one.layer) if one.lobe_image < 0 else (1.0, 1.0, 1.0) for one in materials]
        self.lobes = Layer.of(scene, lobes, [one.lobe_image for one in materials], scene.tri_lobe_uv, 1.0)
        of_glass = np.array([any(one.glass_rgb) or any(one.glass_mirror_rgb) for one in materials], bool)
        self.tri_glass: BoolArray = of_glass[scene.tri_material] & ~unseen
        self.tri_through: BoolArray = self.through.tri_rgb.any(axis=0)
        self.has_through = bool(self.tri_through.any())
        self.tri_both: BoolArray = self.tri_through & ~np.array([one.two_sided for one in scene.objects], bool)[scene.tri_object]
        self._passing = _layer_passing(scene, kinds, seen_by)
        self.tri_seen = _find_seen(scene, kinds, seen_by)
        self.by_kind = self.tri_seen is not None or any(layer is not self._passing[DIFFUSE] for layer in self._passing[:SHADOW])
        back_rgb = np.array([one.back_rgb for one in materials], np.float32).reshape(-1, 3)
        self._tri_back = None if (back_rgb == 1).all() else np.ascontiguousarray(back_rgb[scene.tri_material].T)
        self._views = _Views.of(scene)

    @property
    def reflects(self) -> bool:
        """Whether any triangle reflects or refracts light."""
        return bool(self.reflectance.tri_rgb.any() or self.tri_glass.any())

    def diffuse_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> Float32:
        """(n,) float32 >= 0: mean of the albedo's channels, less what a metal reflects; arguments are as of Layer.at."""
        out: Float32 = np.maximum(self.albedo.at(tri, u, v) - self.metal.at(tri, u, v), 0).mean(axis=1)
        return out

    def share_sides(self, tri: IntArray, u: FloatArray, v: FloatArray) -> Float32:
        """(2, 3, n) float32: shares of the light on fronts and on backs in what fronts show; arguments are as of Layer.at.

        A front sends what it reflects of the light before it and what comes through of that behind it. Over the colour of both this is

            ((albedo - through) front + through back) / albedo

        as in Cycles' bake, which divides diffuse light by the colours of all diffuse closures.
        """
        albedo = np.maximum(self.albedo.at(tri, u, v) - self.metal.at(tri, u, v), 0).T
        through = np.minimum(self.through.at(tri, u, v).T, albedo)
        back = np.divide(through, albedo, out=np.zeros_like(albedo), where=albedo > 0)
        return np.stack([1 - back, back])

    def find_patterned(self) -> BoolArray:
        """(n_tri,) bool: triangles over which diffuse_at varies."""
        out = np.zeros(self.albedo.tri_rgb.shape[1], bool)
        for layer in (self.albedo, self.metal):
            if layer.tri_image is not None:
                out |= layer.tri_image >= 0
        return out

    def dim_back(self, tri: IntArray, is_front: BoolArray) -> Float32 | None:
        """(3, n): factors on what triangles (n,) reflect of light on their fronts, is_front (n,), or backs; None where all are 1."""
        return None if self._tri_back is None else np.where(is_front, np.float32(1), gather(self._tri_back, tri))

    def passing_at(self, tri: IntArray, u: FloatArray, v: FloatArray, kind: int, toward: FloatArray) -> Float32:
        """Share of light that goes straight on through a surface, within [0, 1].

        tri      (n,) int      u, v   (n,) float, barycentric weights of corners 1 and 2
        kind     SHADOW for light straight from a lamp; for light between surfaces the kind of ray in Cycles, which starts at the receiver
        toward   (3, n) float, unit: directions in which the light goes on
        out      (n, 3) float32; its transpose is contiguous
        """
        rgb = self._passing[kind].at(tri, u, v)
        return rgb if self._views is None else np.minimum(rgb.T * self._views.look_up(tri, toward), 1).T

    @property
    def has_two_passings(self) -> bool:
        """Whether the transmittance of any surface for light from lamps differs from that for diffuse rays between surfaces."""
        return self._passing[SHADOW] is not self._passing[DIFFUSE]

    def find_passing(self, kind: int) -> tuple[BoolArray, BoolArray]:
        """(n_tri,) bool each: triangles that light may pass through, and those that transmit all light everywhere."""
        layer = self._passing[kind]
        passes, whole = layer.tri_rgb.any(axis=0), (layer.tri_rgb == 1).all(axis=0)
        if self._views is not None:
            whole &= self._views.tri_row < 0
        return passes, whole if layer.tri_image is None else whole & (layer.tri_image < 0)

    def find_void(self) -> BoolArray:
        """(n_tri,) bool: triangles that have no effect on light."""
        void: BoolArray = ~(self.reflectance.tri_rgb.any(axis=0) | self.tri_glass)
        for kind in RAY_KINDS:
            void &= self.find_passing(kind)[1]
        return void


@dataclass(frozen=True)
class _Views:
    """Transmittances that differ by the direction to the viewer: Material.passing_views.

    tri_row   (n_tri,) int32: row of `factor`, -1 for none
    normal    (3, n_tri) float32, unit
    factor    (n_row, 2, k) float32
    """

    tri_row: Int32
    normal: Float32
    factor: Float32

    @classmethod
    def of(cls, scene: SceneSnapshot) -> _Views | None:
        """None if no material has any."""
        has = np.array([bool(one.passing_views) for one in scene.materials], bool)
        if not has[scene.tri_material].any():
            return None
        row = np.where(has, np.cumsum(has) - 1, -1).astype(np.int32)
        factor = np.array([one.passing_views for one in scene.materials if one.passing_views], np.float32)
        normal = np.ascontiguousarray(triangle_normals_areas(scene.tri_position)[0].T, np.float32)
        return cls(row[scene.tri_material], normal, factor)

    def look_up(self, tri: IntArray, toward: FloatArray) -> Float32:
        """(n,): factors of triangles (n,) for light that goes on in directions (3, n), unit."""
        row = gather(self.tri_row, tri)
        cosine = np.einsum("kn,kn->n", gather(self.normal, tri), toward)
        last = self.factor.shape[2] - 1
        place = np.minimum(np.abs(cosine), 1) * last
        low = np.minimum(place.astype(np.intp), last - 1)
        of_side = self.factor[row, (cosine > 0).astype(np.intp)]
        every = np.arange(len(row))
        below, above = of_side[every, low], of_side[every, low + 1]
        return np.where(row < 0, np.float32(1), below + (above - below) * (place - low)).astype(np.float32)


def find_ray_kinds(materials: Sequence[Material]) -> tuple[int, int, int]:
    """DIFFUSE, GLOSSY and TRANSMISSION; DIFFUSE replaces kinds of rays that no material sends."""
    bends = any(any(one.glass_rgb) for one in materials)
    shines = bends or any(
        one.layer > 0 or one.coat > 0 or any(one.metal_rgb) or any(one.sheen_rgb) or any(one.glass_mirror_rgb) for one in materials
    )
    return DIFFUSE, GLOSSY if shines else DIFFUSE, TRANSMISSION if bends else DIFFUSE


def _layer_passing(scene: SceneSnapshot, kinds: tuple[int, int, int], seen_by: BoolArray) -> list[Layer]:
    """Transmittances for the kinds of rays between surfaces, and for shadow rays; equal ones are the same object.

    seen_by   (3, n_object) bool
    """
    plain, layers = Layer.of_quantity(scene, "passing"), list[Layer]()
    opened = [*~seen_by, np.array([not one.casts_shadow for one in scene.objects], bool)]
    for kind, through in zip((*kinds, SHADOW), opened, strict=True):
        own = [_PASSINGS[kind] if getattr(one, f"{_PASSINGS[kind]}_rgb") is not None else "passing" for one in scene.materials]
        differs = any(name != "passing" for name in own)
        if layers and not differs and np.array_equal(through, opened[DIFFUSE]):
            layers.append(layers[DIFFUSE])
            continue
        layer = plain
        if differs:
            named = list(zip(scene.materials, own, strict=True))
            rgb, image = ([getattr(one, f"{name}_{field}") for one, name in named] for field in ("rgb", "image"))
            layer = Layer.of(scene, rgb, image, scene.tri_passing_uv, plain.highest)
        layers.append(layer.fill(through[scene.tri_object], 1.0))
    return layers


def _find_seen(scene: SceneSnapshot, kinds: tuple[int, int, int], seen_by: BoolArray) -> Float32 | None:
    """SurfaceMaterials.tri_seen; 1 for objects that no ray sees, whose reflectance is 0 already."""
    partly = seen_by.any(axis=0) & ~seen_by.all(axis=0)
    if not partly.any() and all(one.seen_rgb == SEEN_BY_ALL for one in scene.materials):
        return None
    of_material = np.array([[one.seen_rgb[kind] for kind in kinds] for one in scene.materials], np.float32).transpose(1, 2, 0)
    seen: Float32 = of_material[..., scene.tri_material]
    seen[:, :, partly[scene.tri_object]] *= seen_by[:, None, scene.tri_object][:, :, partly[scene.tri_object]]
    return None if (seen == 1).all() else np.ascontiguousarray(seen)


def clamp_warnings(scene: SceneSnapshot) -> list[tuple[str, str]]:
    """(material name, sentence) for each value that is clamped."""
    return [(material.name, text) for index, material in enumerate(scene.materials) for text in _material_warnings(scene, index, material)]


def _material_warnings(scene: SceneSnapshot, index: int, material: Material) -> list[str]:
    sentences = []
    for name, (highest, quantity) in _QUANTITIES.items():
        rgb, image, tri_uv = getattr(material, f"{name}_rgb"), getattr(material, f"{name}_image"), getattr(scene, f"tri_{name}_uv")
        low, high = (np.array(rgb, np.float64),) * 2
        where = ""
        if image >= 0:
            picture = scene.images[image]
            shown = sample_texture(picture, tri_uv[scene.tri_material == index].reshape(-1, 2)) if picture.per_triangle else picture.pixels
            with np.errstate(invalid="ignore"):  # 0 times infinity is reported as not finite
                ends = [low * end.astype(np.float64) for end in _find_ends(shown.reshape(-1, 3))] if shown.size else [low * 0]
            low, high = np.min(ends, axis=0), np.max(ends, axis=0)
            where = f" with {'' if picture.per_triangle else 'image '}{picture.name}"
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            sentences.append(f"{material.name}: its {quantity}{where} is not a finite number and counts as 0; correct the value.")
        elif low.min() < 0 or high.max() > (_LEAST_TOLD if highest == MAX_ALBEDO else highest):
            sentences.append(
                f"{material.name}: its {quantity}{where} reaches from {low.min():.4g} to {high.max():.4g} and is clamped to "
                f"0 ... {highest:.4g}; choose values within."
            )
    return sentences


def _find_ends(pixels: Float32) -> tuple[Float32, Float32]:
    """Least and greatest (3,) of pixels (n, 3), n > 0; numpy is ten times as fast on rows of many pixels as on three numbers."""
    whole = len(pixels) // _PIXELS_OF_ROW * _PIXELS_OF_ROW
    parts = [pixels[:whole].reshape(-1, 3 * _PIXELS_OF_ROW), pixels[whole:].reshape(-1, 3)]
    ends = [[find(part, axis=0).reshape(-1, 3) for part in parts if len(part)] for find in (np.min, np.max)]
    return np.concatenate(ends[0]).min(axis=0), np.concatenate(ends[1]).max(axis=0)
