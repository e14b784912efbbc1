"""Defects of this program behind verdicts that could not be made: logged once, reported by verdicts."""

from __future__ import annotations

from dataclasses import dataclass

from twinmatch.defects import Defect, defect_of, log_once
from twinmatch.errors import TwinmatchError

__all__ = ["DefectReports"]


@dataclass
class _Run:
    """A defect that was raised at consecutive samples."""

    place: str
    newest: int
    """The newest of these samples."""
    reported: int
    """Sample of the newest verdict that reported it."""

    def continues(self, defect: Defect, sample: int) -> bool:
        """Whether it was raised again at the sample behind the newest."""
        return self.place == defect.place and self.newest == sample - 1


class DefectReports:
    """Which defects have been logged, and at which samples a verdict reports one."""

    def __init__(self, stride: int) -> None:
        """Begin without defects; one that is raised at every sample is reported every `stride` samples."""
        self.logged: dict[str, Defect] = {}
        """Defects that prevented verdicts, by their places."""
        self._stride = stride
        self._run: _Run | None = None

    def log(self, error: Exception) -> Defect:
        """The defect behind an error, logged.

        Raises:
            TwinmatchError: the user can fix that error, so it is not a defect.
        """
        if isinstance(error, TwinmatchError):
            raise error
        defect = defect_of(error)
        log_once("no verdict could be made", defect, self.logged)
        return defect

    def is_due(self, defect: Defect, sample: int) -> bool:
        """Whether a verdict at this sample reports a defect that was raised at it."""
        run = self._run
        if run is None or not run.continues(defect, sample):
            self._run = _Run(defect.place, newest=sample, reported=sample)
            return True
        run.newest = sample
        is_due = sample - run.reported >= self._stride
        if is_due:
            run.reported = sample
        return is_due
