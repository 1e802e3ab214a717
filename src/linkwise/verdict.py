"""What can be said of an answer: the one notion of trust that every result, message, exit code and page shares."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from pathlib import Path
from typing import NamedTuple


class Grade(Enum):
    """How far an answer goes, which exit codes follow.

    Attributes
    ----------
    EXPLAINED
        Only noise is left, and the answer can be trusted: exit code 0.
    APPROXIMATE
        The laws leave more than noise. Intervals are of the laws of this form that come closest, and hold the scatter between
        parts of the records; the answer is not trusted: exit code 4.
    REFUSED
        The search did not converge, the records do not determine the values, or they contradict what was stated: no intervals,
        exit code 3.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.Verdict.SYSTEMATIC_MISFIT.grade.value, lw.Verdict.NOT_CONVERGED.grade.value
    ('approximate', 'refused')
    """

    EXPLAINED = "explained"
    APPROXIMATE = "approximate"
    REFUSED = "refused"

    @classmethod
    def worst(cls, grades: Iterable[Grade]) -> Grade:
        """The worst of some grades.

        Parameters
        ----------
        grades : iterable of Grade
            The grades.

        Returns
        -------
        Grade
            The last of them in the order above; explained without any.
        """
        return max(grades, key=list(cls).index, default=cls.EXPLAINED)

    @property
    def exit_code(self) -> int:
        """The exit code of commands that end with such an answer."""
        return {Grade.EXPLAINED: 0, Grade.APPROXIMATE: 4, Grade.REFUSED: 3}[self]

    @property
    def trust(self) -> str:
        """In words, whether such an answer can be trusted."""
        return {
            Grade.EXPLAINED: "can be trusted",
            Grade.APPROXIMATE: "approximate, NOT to be trusted as exact",
            Grade.REFUSED: "NOT to be trusted",
        }[self]


class Verdict(Enum):
    """A finding about an answer as a whole; its value is the advice that goes with it.

    A result carries all that apply, the most important first, and can be trusted where the `grade` of all is explained.

    Attributes
    ----------
    value : str
        What it means, and what to do about it.
    forbids : bool
        Whether the model of an answer with this verdict gives no intervals.
    grade : Grade
        The best grade of an answer with it.
    status : str
        The verdict in lower-case words, "not converged".

    Examples
    --------
    >>> from linkwise import Verdict
    >>> Verdict.NOT_CONVERGED.forbids, Verdict.CONVERGED.forbids
    (True, False)
    >>> Verdict.NOISE_MISMATCH.status
    'chi-square off'
    """

    _value_: str
    grade: Grade
    _status: str

    def __new__(cls, advice: str, grade: Grade = Grade.REFUSED, status: str = "") -> Verdict:
        """A verdict, with the status that result.json has always had where it is not its name."""
        verdict = object.__new__(cls)
        verdict._value_, verdict.grade, verdict._status = advice, grade, status
        return verdict

    CONVERGED = ("The search converged, and noise explains the residuals.", Grade.EXPLAINED)
    NO_INTERVALS = (
        "The method gives no intervals: its standard errors take samples as independent and regressors as exact. "
        'Use method "weak" or "ml" for intervals.',
        Grade.EXPLAINED,
        "converged",
    )
    MODEL_ERROR_NEEDED = (
        "The laws explain the record only with a model error, which all intervals count as a random force.",
        Grade.APPROXIMATE,
        "converged",
    )
    NOT_CONVERGED = (
        "The search did not converge: the values are the best so far. Identify a shorter part of the record, and give "
        "its values as starts for the whole."
    )
    NOISE_MISMATCH = (
        "The residuals do not match the noise that was stated or estimated: the noise has another level, a term is missing "
        "from a law, or a link from the structure.",
        Grade.APPROXIMATE,
        "chi-square off",
    )
    UNEXPLAINED_FORCES = (
        "The laws leave too much of the forces unexplained: a term or a link is missing, or noise hides them.",
        Grade.APPROXIMATE,
        "forces unexplained",
    )
    SYSTEMATIC_MISFIT = (
        "The residuals follow the motion: a term or a link is missing, or a sensor has an error. Intervals would count "
        "them as noise.",
        Grade.APPROXIMATE,
    )
    MEASUREMENT_ERROR = (
        "An error of a sensor, of an applied force or of a stated mass would explain the residuals better than any missing "
        "term. Correct it, or estimate it with the other unknowns.",
        Grade.APPROXIMATE,
    )
    COEFFICIENT_CHANGES = (
        "A coefficient is not the same in all of the record: something slipped, loosened or warmed up. Identify the parts "
        "before and after the change by themselves.",
        Grade.APPROXIMATE,
    )
    COLOURED_RESIDUALS = (
        "The residuals are not white, as the noise is taken to be, so intervals would be too narrow. Check the sensors for "
        "a filter or a drift, and the laws for a missing term.",
        Grade.APPROXIMATE,
    )
    SEVERAL_OPTIMA = (
        "Around the estimates the likelihood has other optima, or is not quadratic, as intervals assume. Give closer starting "
        "values, a shorter part of the record, or less noise."
    )
    HARDLY_DETERMINED = (
        "The record contains hardly more information on some coefficients than noise, so intervals would be too narrow. Hold "
        'some at known values, record a motion that stands farther above the noise, or use method "ml".'
    )
    BIASED = (
        "The likelihood is largest at values that the standard errors of the method do not allow: it is biased here. Use "
        'method "ml".'
    )
    COVARIANCE_NOT_POSITIVE = (
        "The covariance of the coefficients is not positive definite: the record hardly determines some of them above its "
        "noise. Hold some at known values, or record a motion with a higher signal-to-noise ratio."
    )
    ENERGY_FED = (
        "A link feeds energy into the motion, which no spring or damper does: an applied force that is not in the record, or "
        "a missing term, has this effect."
    )
    OUTLIERS = (
        "The noise has outliers, which the method does not allow for: remove them, or use maximum likelihood with a robust "
        "loss."
    )
    SEARCH_UNSETTLED = (
        "The search for terms did not settle: this is the best model so far, and another may be better."
    )
    LINKS_IN_DOUBT = (
        "No link is certain, or the noise of sensors is not white and links are in doubt, so that it may be what a wrong link "
        "leaves. Excite the masses one at a time, record for longer or with less noise, or state links that are known."
    )
    DISPLACEMENTS_INTEGRATED = (
        "Displacements were integrated from velocities or accelerations, and the laws found leave more than noise: links or "
        "terms may be false. Measure the displacements too, or offer more terms."
    )
    TERMS_MAY_BE_MISSING = (
        "The terms found may stand in for terms that were not offered, as the remarks say. Offer more terms.",
        Grade.APPROXIMATE,
    )
    ENERGY_BALANCE_CLOSED = ("The energy balance of every simulation closes.", Grade.EXPLAINED)
    ENERGY_BALANCE_OPEN = (
        "The energy balance of a simulation does not close: do not trust its shares of energy."
    )

    PREDICTION_AGREES = (
        "The prediction agrees with the record: noise and the errors of the answer explain what is left.",
        Grade.EXPLAINED,
    )
    PREDICTION_DISAGREES = (
        "The prediction differs from the record by more than noise and the errors of the answer explain: a law, a link or the "
        "conditions of the test are not those of the answer, or its intervals are too narrow."
    )
    LAWS_REFUTED = (
        "The error of the prediction is within what noise and the errors of the answer allow, but the laws leave more than "
        "noise of this record with any coefficients: a sensor, a mass or another condition of this test is not that of the "
        "answer, or a term is missing."
    )
    PREDICTION_NOT_TESTED = (
        "The record tests nothing: in every channel noise and the errors of the answer would explain an error as large as the "
        "motion, and the coefficients are not determined by this record alone. Check the units of its channels and of the "
        "time, or record with less noise or at an amplitude nearer to that of the answer."
    )

    UNKNOWNS_DETERMINED = ("The sensors of this test determine every unknown.", Grade.EXPLAINED)
    UNKNOWNS_NOT_DETERMINED = (
        "This test does not determine every unknown: give some as known, or add a sensor or a force that moves them "
        "differently."
    )

    NOTHING_WRONG_SEEN = ("No check saw anything wrong with a channel.", Grade.EXPLAINED)
    CHANNELS_IN_DOUBT = (
        "Something is wrong with a channel, and would make answers wrong unless it is mended or estimated: see the alerts for "
        "what and how."
    )

    LINEAR_IN_RANGE = (
        "Linear modes explain every level alike: none moves by more than its errors.",
        Grade.EXPLAINED,
    )
    MODES_MOVE = (
        "Modes move with the level or amplitude by more than their errors: the structure is not linear in this range.",
        Grade.EXPLAINED,
    )
    MODES_NOT_DETERMINED = (
        "The records determine some modes too poorly to tell whether they move with the level. Record for longer or with less "
        "noise, excite more strongly, or follow fewer modes."
    )
    RESIDUALS_GROW_WITH_LEVEL = (
        "Linear modes explain a higher level less well than the lowest, though none moves: the structure is hardly linear "
        "over these levels. Look at the distortion under a periodic force."
    )

    MOTIONS_FOLLOWED = ("Every motion was followed to the end that was asked for.", Grade.EXPLAINED)
    MOTIONS_CUT_SHORT = (
        "Some motions were not followed to the end that was asked for: what is shown of the others is exact.",
        Grade.EXPLAINED,
    )

    STUDY_COMPLETE = ("Every case of the study was run and has an answer.", Grade.EXPLAINED)
    STUDY_INCOMPLETE = (
        "Some cases were not run yet, so that the statistics may change. Run the study again: it resumes where it was "
        "interrupted."
    )
    CASES_WITHOUT_ANSWER = (
        "Some cases have no answer: medians and quantiles count them as worse than any answer.",
        Grade.EXPLAINED,
    )
    CELLS_WITHOUT_ANSWER = (
        "A method has no answer at all for some structure and noise, so that nothing can be compared there."
    )

    @property
    def forbids(self) -> bool:
        """Whether the model of an answer with this verdict gives no intervals."""
        return self.grade is not Grade.EXPLAINED and self is not Verdict.MODEL_ERROR_NEEDED

    @property
    def status(self) -> str:
        """The verdict in lower-case words."""
        return self._status or self.name.replace("_", " ").lower()


STATUSES = frozenset(verdict.status for verdict in Verdict)  # all that a file may state


_COMMENTS = {
    Grade.APPROXIMATE: "# approximate ({}): numbers of laws that leave more than noise of their record.\n",
    Grade.REFUSED: "# NOT to be trusted ({}): numbers of an answer that does not explain its record.\n",
}
_REMARKS = {
    Grade.EXPLAINED: "",
    Grade.APPROXIMATE: (
        "The answer is approximate{}: its laws leave more than noise, and so does what follows from its numbers."
    ),
    Grade.REFUSED: "The answer is NOT to be trusted{}, and neither is what follows from its numbers.",
}


class Basis(NamedTuple):
    """The answer that a result was computed from: its grade, beyond which the result does not go.

    Attributes
    ----------
    grade : Grade
        The grade; explained of a structure that states none.
    status : str
        The status, empty where it is not known.

    Examples
    --------
    >>> from linkwise.verdict import Basis, Grade
    >>> Basis(Grade.REFUSED, "not converged").remark
    'The answer is NOT to be trusted (not converged), and neither is what follows from its numbers.'
    """

    grade: Grade = Grade.EXPLAINED
    status: str = ""

    @property
    def remark(self) -> str:
        """A sentence on what follows from the numbers of the answer; empty where it is explained."""
        return _REMARKS[self.grade].format(f" ({self.status})" if self.status else "")

    @property
    def comment(self) -> str:
        """The first line of the structure file of the answer; empty where it is explained."""
        return _COMMENTS.get(self.grade, "").format(self.status)

    @classmethod
    def stated_in(cls, path: Path) -> Basis:
        """Read what a structure file, or that of a result folder, states in its first line.

        Parameters
        ----------
        path : Path
            The file or folder.

        Returns
        -------
        Basis
            The basis; explained where nothing is stated, or the file cannot be read.
        """
        try:
            with (path / "structure.toml" if path.is_dir() else path).open(encoding="utf-8") as file:
                line = file.readline()
        except (OSError, UnicodeDecodeError):
            return cls()
        for grade, comment in _COMMENTS.items():
            if line.startswith(mark := comment.partition(" (")[0]):
                status = line.removeprefix(mark).partition(":")[0].strip(" ()\n")
                return cls(grade, status if status in STATUSES else "")
        return cls()


UNGRADED = Basis()
"""That of a structure that states no grade."""


def admit_intervals(verdicts: Iterable[Verdict]) -> bool:
    """Whether the model of the answer gives intervals, be they with a model error."""
    return not any(verdict.forbids for verdict in verdicts)


def status_of(verdicts: Iterable[Verdict]) -> str:
    """The status of the first verdict that forbids trust, "converged" where none does."""
    return next((verdict.status for verdict in verdicts if verdict.forbids), Verdict.CONVERGED.status)


class Decision(Enum):
    """How firm a decision on a term or a link is by a record.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.discovery.Decision("doubtful")
    <Decision.DOUBTFUL: 'doubtful'>
    >>> [decision.value for decision in lw.discovery.Decision]
    ['certain', 'doubtful', 'not identifiable']
    """

    CERTAIN = "certain"
    DOUBTFUL = "doubtful"
    NOT_IDENTIFIABLE = "not identifiable"
