"""Changes of a plant with several signals that were named, and stand until something undoes them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from twinmatch.health.evidence import Competition, ExpectedEnd
from twinmatch.health.faults import EVERY, Fault
from twinmatch.health.hypotheses import LESS, ChangeRow
from twinmatch.health.suspects import Suspect
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray


class _Undoing(Rule):
    """When a named change counts as undone."""

    remainder: float = 0.4
    """Share of a change that may remain when it counts as over."""
    settles: float = 600.0
    """Time after the end of a change in which what remains of it may still show, s."""
    learned: float = 60.0
    """Time for which the plant is believed to be as before, without an end that was seen, until the change is
    over, s."""


UNDOING = _Undoing()

OF_A_DRIVE = (Fault.DRIVE_LOST, Fault.DRIVE_WEAK)
"""Faults of a drive."""


@dataclass(eq=False)
class NamedChange:
    """A change that was named, and that the plant is known by since."""

    fault: Fault
    row: ChangeRow
    before: FloatArray
    """What was believed of the plant before it."""
    shift: float
    """Its size when it was named, in the unit of its row."""
    samples_as_before: int = 0
    """For how many samples the plant has been believed to be as before it."""


class _Return(NamedTuple):
    """A number of the plant that is again as it was before a change."""

    at: int
    """Sample at which that was said."""
    size: float
    """The largest size that the change was known to have, without its sign."""


def is_of_sensor(row: ChangeRow) -> bool:
    """Whether a change is of a reading, and not of the plant."""
    return row.cause[0] is Fault.SENSOR_DRIFT


class StandingChanges:
    """Named changes of one plant that have not been undone, in the order in which they were named."""

    def __init__(self, competition: Competition) -> None:
        """Begin without any; what is believed of the plant is asked of the competition."""
        self._competition = competition
        self._standing: list[NamedChange] = []
        self._returned: dict[str, _Return] = {}
        """When numbers of the plant were last said to be as before."""

    def note(self, changes: Iterable[NamedChange]) -> None:
        """Have changes stand from now on."""
        self._standing += changes

    def note_suspect(self, fault: Fault, best: Suspect) -> None:
        """Have a change stand that a suspect says, and note what was believed before it."""
        before = self._competition.believed_before(best.born)
        self.note([NamedChange(fault, best.row, before, best.shift)])

    def expect_back(self) -> None:
        """Have every change compete that may be undone."""
        self._competition.expect_back(
            [ExpectedEnd(named.row, named.before) for named in self._standing]
        )

    @property
    def jumped(self) -> list[NamedChange]:
        """Readings that have jumped together with others, and have not come back."""
        return [named for named in self._standing if named.fault is Fault.DRIFT]

    def has_come_back(self, named: NamedChange, jump: float) -> bool:
        """Whether a jump of a reading, in its unit, undoes a change of that reading."""
        shift = self._competition.change_since(named.row, named.before)
        return abs(shift + jump) <= UNDOING.remainder * abs(shift)

    def is_off(self, output: int) -> bool:
        """Whether the readings of an output are known to be off."""
        cause = (Fault.SENSOR_DRIFT, output)
        return any(named.row.cause == cause for named in self._standing)

    def undone_by(self, suspect: Suspect) -> list[NamedChange]:
        """The named changes that a suspect undoes: one whose number it brings nearly back to what it was before,
        and those that the plant has had since, as all is then as it was before the first of them."""
        for place, named in enumerate(self._standing):
            if self._undoes(suspect, named):
                if is_of_sensor(named.row):
                    return [named]
                since = self._standing[place:]
                return [later for later in since if not is_of_sensor(later.row)]
        return []

    def _undoes(self, suspect: Suspect, named: NamedChange) -> bool:
        """Whether a suspect brings the number of a named change nearly back to what it was before."""
        if (named.row.number, named.row.also) != (suspect.row.number, suspect.row.also):
            return False
        shift = self._competition.change_since(named.row, named.before)
        may_remain = max(UNDOING.remainder * abs(shift), suspect.row.least)
        if suspect.row.is_end:
            left = self._competition.left_after(suspect, named.row, named.before)
            is_gone = suspect.returned >= 1.0 - UNDOING.remainder
            return is_gone and abs(left) <= may_remain
        return abs(named.row.remaining(shift, suspect.shift)) <= may_remain

    def remove(self, undone: list[NamedChange], index: int) -> None:
        """Have changes no longer stand from a sample on."""
        self._standing = [
            named
            for named in self._standing
            if not any(named is other for other in undone)
        ]
        for named in undone:
            shift = self._competition.change_since(named.row, named.before)
            size = max(abs(named.shift), abs(shift))
            self._returned[named.row.number] = _Return(index, size)

    def learned_back(self) -> list[NamedChange]:
        """Changes of drives that the filters have unlearned by themselves: an end that comes slowly, or beside
        another one, need not be seen. Ask once at every sample."""
        enough = UNDOING.learned * self._competition.second
        learned_back = []
        for named in self._standing:
            if named.fault not in OF_A_DRIVE:
                continue
            named.samples_as_before += 1
            if not self._has_share_of_before(named):
                named.samples_as_before = 0
            elif named.samples_as_before > enough:
                named.samples_as_before = 0
                if self._acts_as_before(named):
                    learned_back.append(named)
        return learned_back

    def _has_share_of_before(self, named: NamedChange) -> bool:
        """Whether the share that is believed to arrive of a drive is nearly that of before its change."""
        left = self._competition.change_since(named.row, named.before)
        return abs(left) <= _may_be_left(named)

    def _acts_as_before(self, named: NamedChange) -> bool:
        """Whether the drives of a change do nearly what they did before."""
        drive = named.row.cause[1]
        drives = range(self._competition.drives) if drive == EVERY else (drive,)
        changes = (self._competition.effect_since(j, named.before) for j in drives)
        return all(abs(change) <= _may_be_left(named) for change in changes)

    def may_remain(self, number: str, onset: int) -> float:
        """How much of a change of a number that was over shortly before a sample may be left, in its unit; 0 if
        there was none."""
        returned = self._returned.get(number)
        lately = UNDOING.settles * self._competition.second
        if returned is None or onset - returned.at >= lately:
            return 0.0
        return UNDOING.remainder * returned.size

    def share_left(self, suspect: Suspect) -> float:
        """What is left of a drive's effect, as a share of what it was before any change that stands; 1 for anything
        else."""
        number = suspect.row.number
        if not number.startswith("share "):
            return 1.0
        now = 1.0 + suspect.shift + self._competition.believed(number)
        before = self._competition.believed_before(suspect.born)
        of_drive = (named for named in self._standing if named.row.number == number)
        first = next(of_drive, None)
        usual = self._competition.number_in(
            before if first is None else first.before, number
        )
        return max(now / max(1.0 + usual, LESS), 0.0)


def _may_be_left(named: NamedChange) -> float:
    """How much of a change of a drive may be left when it is over without an end that was seen."""
    return min(UNDOING.remainder * abs(named.shift), named.row.least)
