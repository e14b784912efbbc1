"""Learning from sessions: each is judged by itself, without a memory, so that none counts twice."""

from __future__ import annotations

from twinmatch.memory import Lesson, SessionEvidence, digest_of, lessons_of
from twinmatch.offline.judging import Judgement, Terms, Watch, judge
from twinmatch.sessions import Session


def learn(
    session: Session, terms: Terms, rig: str = "", watch: Watch | None = None
) -> list[Lesson]:
    """Judge a session, and return its lessons on the rig of this name; see `lessons_of`."""
    return learn_from(judge(session, terms, watch=watch), rig)


def learn_from(judgement: Judgement, rig: str = "") -> list[Lesson]:
    """The lessons of a session that was judged without a memory."""
    settings = judgement.settings
    return lessons_of(
        SessionEvidence(
            session=digest_of(judgement.samples),
            name=judgement.name,
            rig=rig,
            plant=settings.plant,
            began=judgement.samples[0].stamp,
            stretches=judgement.stretches,
            verdicts=judgement.verdicts,
            horizons=settings.forecasts.horizons,
            noise=settings.noise,
            law=settings.law,
        )
    )
