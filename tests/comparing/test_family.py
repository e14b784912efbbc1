"""Who is in the family, who leaves, who is nominal."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from twinmatch.comparing import Candidate, CandidateScore, Family, nominal_of
from twinmatch.plants import Peltier

RIG = Peltier.model().parameters()


def candidate(operating_point: float, name: str | None = None) -> Candidate:
    return Candidate(name or f"{operating_point:g} °C", operating_point, RIG, None)


def test_the_newest_match_of_a_regime_replaces_the_older_one() -> None:
    family = Family()
    assert family.admit(candidate(50.0)) is None
    leaving = family.admit(candidate(53.0))
    assert leaving is not None
    assert leaving.operating_point == 50.0
    assert [c.operating_point for c in family.candidates] == [53.0]
    assert family.admit(candidate(60.0)) is None


def test_the_nearest_of_two_regimes_is_replaced() -> None:
    family = Family()
    family.admit(candidate(50.0))
    family.admit(candidate(57.0))
    leaving = family.admit(candidate(54.0))
    assert leaving is not None
    assert leaving.operating_point == 57.0


def test_a_full_family_loses_the_one_matched_longest_ago() -> None:
    family = Family(most=2)
    family.admit(candidate(90.0))
    family.admit(candidate(30.0))
    leaving = family.admit(candidate(60.0))
    assert leaving is not None
    assert leaving.operating_point == 90.0


def test_names_are_unique() -> None:
    family = Family()
    family.admit(candidate(30.0, "twin"))
    leaving = family.admit(candidate(90.0, "twin"))
    assert leaving is not None
    assert len(family) == 1


@given(st.lists(st.floats(0, 110), max_size=40), st.integers(1, 8))
def test_regimes_never_overlap_and_the_newest_is_always_in(points: list[float], most: int) -> None:
    family = Family(most=most)
    for k, point in enumerate(points):
        family.admit(candidate(point, f"{k}"))
        held = family.candidates
        assert len(held) <= most
        assert f"{k}" in {c.name for c in held}
        assert [c.operating_point for c in held] == sorted(c.operating_point for c in held)
        standing = family.standing_at(point)
        assert standing is not None
        assert abs(standing.operating_point - point) < family.regime_width / 2


def scored(name: str, total: float, to_plant: float | None) -> CandidateScore:
    return CandidateScore(name, 50.0, RIG, 0, 100, (), "22221", total, None, to_plant)


def test_the_smallest_sum_is_nominal() -> None:
    """The paper's four sums: 70 °C."""
    sums = {"30 °C": 2.93, "50 °C": 2.74, "70 °C": 2.22, "90 °C": 2.28}
    assert nominal_of(tuple(scored(n, s, None) for n, s in sums.items())) == "70 °C"
    assert nominal_of(()) is None


def test_of_equal_sums_the_one_nearer_to_the_plant_is_nominal() -> None:
    assert nominal_of((scored("a", 0.3, 0.5), scored("b", 0.3, 0.1))) == "b"
    assert nominal_of((scored("a", 0.3, None), scored("b", 0.3, 0.9))) == "b"
    assert nominal_of((scored("b", 0.3, None), scored("a", 0.3, None))) == "a"
