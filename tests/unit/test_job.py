"""A job on disk is the job that was saved."""

import dataclasses

import pytest
from leaflight.core.util.job import JOB_FILE, Job
from leaflight.core.util.settings import Settings


def another_value(knob):
    """A value of the knob that is allowed and not its default."""
    if knob.metadata["choices"]:
        last = knob.metadata["choices"][-2:]
        return last if isinstance(knob.default, tuple) else next(one for one in last if one != knob.default)
    if isinstance(knob.default, bool):
        return not knob.default
    if isinstance(knob.default, str):
        return knob.default + "_"
    return next(type(knob.default)(knob.metadata[end]) for end in ("high", "low") if knob.metadata[end] != knob.default)


def test_all_knobs_come_back_from_disk(tmp_path):
    changed = Settings(**{knob.name: another_value(knob) for knob in dataclasses.fields(Settings)})
    assert all(getattr(changed, knob.name) != knob.default for knob in dataclasses.fields(Settings))
    job = Job(changed, output="/some where/\u00e4", atlas_name="caf\u00e9", preview=True, resume="a", keep="b", keep_mb=3)
    job.save(tmp_path)
    assert Job.load(tmp_path) == job


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"settings": {"sise": 4}, "output": "", "atlas_name": ""}', '{"settings": {}}', "\xff"])
def test_a_damaged_job_is_a_sentence(tmp_path, text):
    (tmp_path / JOB_FILE).write_text(text)
    with pytest.raises(ValueError, match=r"job\.json: is no Leaflight job or is damaged \(.+\); start the bake again"):
        Job.load(tmp_path)


def test_a_knob_out_of_range_is_named(tmp_path):
    (tmp_path / JOB_FILE).write_text('{"settings": {"size": 1}, "output": "", "atlas_name": ""}')
    with pytest.raises(ValueError, match=r"job\.json: .+size: expected 4 to 16384 texels, got 1"):
        Job.load(tmp_path)
