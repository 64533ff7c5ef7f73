"""What the report advises where plans do not keep pace: smoothing does not get faster with fewer samples."""

from types import SimpleNamespace

import pytest

from planners.app.config import PlanConfig
from planners.app.report import Report


@pytest.mark.parametrize(
    ("plan_ms", "smoothing_ms", "words"),
    [
        (30.0, 0.0, "within the control period of 40 ms"),
        (160.0, 0.0, "--samples 16 would about keep pace"),
        (100.0, 20.0, "--samples 16 would about keep pace"),
        (184.0, 85.0, "smoothing alone takes 85.0 ms: leave out --smooth"),
        (4000.0, 0.0, "try --model.kind coarse"),
    ],
)
def test_advice_keeps_the_period(plan_ms, smoothing_ms, words, tmp_path):
    session = SimpleNamespace(config=PlanConfig.of("mppi", {"search.samples": 64}))
    assert words in Report(tmp_path, session)._about_the_pace(plan_ms, smoothing_ms, 40.0)


def test_a_planner_that_draws_no_samples_is_told_of_none(tmp_path):
    session = SimpleNamespace(config=PlanConfig.of("smooth"))
    for smoothing_ms in (39.0, 180.0):
        said = Report(tmp_path, session)._about_the_pace(184.0, smoothing_ms, 40.0)
        assert "shorter --horizon" in said and "--samples" not in said and "--smooth" not in said
