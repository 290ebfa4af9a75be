"""All light of texels, by which errors are made relative."""

import numpy as np
import pytest
from leaflight.core.filter.filtered_field import FilteredField
from leaflight.core.filter.reference_light import ReferenceLight
from leaflight.core.texels.error_metric import DARK_FLOOR, ErrorMetric
from trees import current, even, throw


def light_of(bake, direct, judged):
    irradiance = np.full((bake.n_texel, 3), direct, np.float32)
    return ReferenceLight.of(bake.tree, bake.solution(), current(bake), FilteredField.plain(irradiance, np.zeros_like(irradiance)), judged)


@pytest.fixture(scope="module")
def bake():
    return throw(even, 50_000, 1, degree=0, level=1)


def test_errors_are_relative_to_the_light_and_to_a_share_of_the_mean(bake):
    light = light_of(bake, 2.0, ErrorMetric.whole(bake.texels))
    rows = np.arange(bake.n_texel)
    brightness = light.at(rows)
    dark = DARK_FLOOR * brightness.mean()
    assert light.dark == pytest.approx(dark, rel=1e-5)
    assert light.weigh(rows) == pytest.approx(1.0 / (brightness**2 + dark**2), rel=1e-5)
    variance = np.full((bake.n_texel, 3), 0.5, np.float32)
    assert light.relate(lambda asked: variance[asked], rows[:9]) == pytest.approx((light.weigh(rows[:9]) * 0.5).mean(1))
    assert light.relate_all(lambda asked: variance[asked]) == pytest.approx((light.weigh(rows) * 0.5).mean(1))


def test_of_objects_the_share_is_of_their_own_mean(bake):
    """The left half is one, in the dark, the right half the other."""
    left = bake.texels.texel_xy[:, 0] < bake.texels.page_size // 2
    thing = np.where(left, 0, 1)
    entry = np.arange(bake.n_texel)
    judged = ErrorMetric(entry, np.ones(len(entry)), {}, [np.flatnonzero(left), np.flatnonzero(~left)], thing.astype(np.int32))
    irradiance = np.where(left, 0.0, 4.0)[:, None].repeat(3, axis=1).astype(np.float32)
    light = ReferenceLight.of(bake.tree, bake.solution(), current(bake), FilteredField.plain(irradiance, 0.0 * irradiance), judged)
    own = np.array([light.at(entry)[thing == one].mean() for one in (0, 1)])
    assert light.parts.dark2 == pytest.approx((DARK_FLOOR * own) ** 2, rel=1e-4)
    assert light.weigh(entry) == pytest.approx(1.0 / (light.at(entry) ** 2 + light.parts.dark2[thing][:, None]), rel=1e-5)
