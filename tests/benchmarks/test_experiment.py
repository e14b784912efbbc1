"""The benchmark of proposed courses: twins are fitted again to what a course brought."""

from __future__ import annotations

import pytest

from tests.support.places import PROJECT


def test_parameters_fitted_after_a_course_err_as_finitely_as_predicted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(PROJECT))
    import benchmarks.experiment

    benchmarks.experiment.main(["1", "--only", "parameters"])
    said = capsys.readouterr().out
    assert "peltier, RMS error / predicted, 1 plants: seebeck " in said
    assert "nan" not in said
