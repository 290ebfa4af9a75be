"""What the panel tells before a bake, from areas."""

import pytest
from leaflight.addon.app.estimate import Measured, estimate_bake
from leaflight.addon.show.bake_pace import Pace
from leaflight.core.util.settings import Settings

RESULT = {
    "estimated_error": 0.1,
    "error_of": "bake",
    "photons": 1,
    "objects": [{"texels": 9}],
    "seconds": {},
    "resumed": False,
    "skipped": {"bake": 0},
}
ROOM = [Measured("Floor", 20.0, 1.0), Measured("Walls", 60.0, 1.0), Measured("Lamp", 1.0, 1.0)]


def estimate(objects=ROOM, own_layers=0, pace=None, **chosen):
    return estimate_bake(objects, Settings(**chosen), own_layers, 2, pace)


def test_a_page_holds_what_it_can():
    found = estimate()
    assert (found.objects, found.pages, found.page_size) == (3, 1, 512)
    assert found.area_m2 == 81.0
    assert 0.4 * 512**2 < found.texels < 0.9 * 512**2
    assert found.density == pytest.approx((found.texels / 81.0) ** 0.5, rel=1e-4)
    assert estimate(size=1024).density > 2.0 * found.density
    assert estimate(padding=16).texels < found.texels


def test_density_decides_texels_and_pages():
    found = estimate(density=50.0)
    assert found.texels == pytest.approx(81.0 * 50.0**2, rel=1e-6)
    assert found.density == 50.0
    assert found.pages == 2
    assert found.too_large == ()
    assert estimate(density=100.0).too_large == ("Walls",)


def test_what_is_longer_than_a_page_does_not_fit_it():
    rail = Measured("Rail", 1.0, 2.0, 20.0)
    found = [estimate([*ROOM, rail], density=density) for density in (17.5, 20.0)]
    assert [one.too_large for one in found] == [(), ("Rail",)]
    assert found[1].fitting == pytest.approx((2**0.5 * 504 / (20.0 * 2.0 * 20.0),))


@pytest.mark.parametrize(("density", "padding"), [(400.0, 4), (100.0, 16)])
def test_what_does_not_fit_is_as_coarse_as_it_fills_a_page_alone(density, padding):
    found, alone = estimate(density=density, padding=padding), estimate(ROOM[1:2], padding=padding)
    assert density * dict(zip(found.too_large, found.fitting, strict=True))["Walls"] == pytest.approx(alone.density)


def test_each_object_may_be_finer_or_have_its_own_page():
    finer = [Measured("Floor", 20.0, 2.0), *ROOM[1:]]
    assert estimate(finer, density=40.0).texels == pytest.approx((81.0 + 3 * 20.0) * 40.0**2, rel=1e-6)
    assert estimate(finer).density < estimate().density
    assert estimate(atlas=False).pages == 3
    assert estimate(own_layers=1).pages == 2
    assert estimate(own_layers=3).pages == 3


def test_who_takes_the_page_is_named():
    level = [Measured("Ground", 900.0, 1.0, n_chart=1), *(Measured(f"Prop {k}", 2.0, 1.0, n_chart=6) for k in range(50))]
    assert estimate(level, density=3.0).takers == (("Ground", pytest.approx(0.9)),)
    assert estimate(level[1:]).takers == ()
    assert estimate(level[:1]).takers == (), "all of it is its own"
    assert estimate(level, atlas=False).takers == ()


def test_small_things_are_finer_and_named():
    level = [Measured("Ground", 40_000.0, 1.0, n_chart=1), *(Measured(f"Prop {k}", 24.0, 1.0, n_chart=6) for k in range(60))]
    even, plain = estimate(level), estimate(level, even_out=False)
    assert [name for name, _ in even.evened] == [one.name for one in level[1:]]
    assert even.evened[0][1] == pytest.approx(4.0, rel=0.1)
    assert [found.takers[0][1] for found in (plain, even)] == pytest.approx([0.965, 0.64], abs=0.01)
    assert plain.evened == estimate(level, density=1.0).evened == ()
    assert even.density < plain.density


def test_pages_are_told_as_they_are_made():
    """In the figures of bakes: 2,000 boxes have five pages of 512 and one of 1024."""
    boxes = [Measured(f"Box {k}", 6.0, 1.0, n_chart=6) for k in range(2000)]
    found = estimate(boxes)
    assert (found.pages, found.page_size) == (5, 512)
    assert found.density == pytest.approx(5.0, rel=0.1)
    assert estimate(boxes, size=1024).pages == 1
    assert estimate(boxes, max_pages=4).pages == 4
    assert estimate(boxes, density=10.0).pages == pytest.approx(2000 * 6 * 14.5**2 / 512**2 / 0.9, rel=0.25)
    assert estimate(boxes[:200]).pages == 1


def test_finer_bakes_take_more():
    coarse, fine = estimate(error=0.2), estimate(error=0.05)
    assert coarse.seconds[1] < fine.seconds[1]
    assert fine.seconds[0] < fine.seconds[1]
    assert estimate(size=2048).memory_mb > 2.0 * estimate().memory_mb
    assert estimate(time_limit=1.0).seconds == (1.0, 1.0)


def test_the_last_bake_tells_the_pace_of_the_next():
    texels = estimate().texels
    result = RESULT | {
        "estimated_error": 0.1,
        "photons": 10**6,
        "objects": [{"texels": texels}],
        "seconds": {"direct": 6.0, "write": 1.0, "photons": 3.0},
    }
    pace = Pace.of_result(result)
    assert estimate(error=0.1, pace=pace).seconds == (pytest.approx(10.0, rel=1e-4),) * 2
    assert estimate(error=0.05, pace=pace).seconds[0] == pytest.approx(7.0 + 2 * 3.0, rel=1e-4)
    assert estimate(error=0.05, direct="photons", pace=pace).seconds[0] == pytest.approx(7.0 + 4 * 3.0, rel=1e-4)
    waited = Pace.of_result(result, 14.0)
    assert estimate(error=0.1, pace=waited).seconds[0] == pytest.approx(14.0, rel=1e-4), "as long as the user waited"


def test_where_each_object_is_to_be_right_it_takes_more_and_no_other_bake_tells_how_much():
    assert estimate(error_of="objects").seconds[1] > 2 * estimate().seconds[1]
    pace = Pace.of_result(RESULT | {"objects": [{"texels": estimate().texels}], "seconds": {"photons": 3.0}})
    assert estimate(pace=pace).seconds != estimate().seconds
    assert estimate(pace=pace, error_of="objects").seconds == estimate(error_of="objects").seconds


@pytest.mark.parametrize(
    "changes", [{"estimated_error": float("nan")}, {"estimated_error": 0.0}, {"objects": []}, {"resumed": True}, {"skipped": {"bake": 1}}]
)
def test_a_bake_that_tells_too_little_has_no_pace(changes):
    assert Pace.of_result(RESULT) is not None
    assert Pace.of_result(RESULT | changes) is None


@pytest.mark.parametrize("area", [0.0, float("inf"), float("nan")])
def test_nothing_to_bake_has_no_estimate(area):
    assert estimate([]) is None
    assert estimate([Measured("Point", area, 1.0)]) is None
