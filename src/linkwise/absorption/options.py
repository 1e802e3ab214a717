"""What an absorption is asked: one frozen object, and the keywords that it is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Unpack, final

from linkwise.errors import SimulationError, StructureError
from linkwise.model.excitation import Excitation
from linkwise.simulation.simulate import ExcitationKeywords

BASELINES = ("removed", "locked")


class AbsorptionKeywords(ExcitationKeywords, total=False):
    """The keywords of `AbsorptionOptions.of`: its fields, and those of `Excitation.of`."""

    duration: float
    rate: float | None
    sinks: Sequence[str]
    without: str
    settle: float
    harvesters: Mapping[str, float] | None


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class AbsorptionOptions:
    """What `absorb`, `absorption_intervals` and `absorption_map` are asked.

    Those functions take the same things as keywords; an object is for asking the same of several structures.

    Parameters
    ----------
    duration : float
        How long to look, in s.
    rate : float, optional
        Output samples per second. By default 20 or more in a period of the fastest mode.
    sinks : sequence of str
        The links that are sinks; without names, every link with more than one stable well.
    without : {"removed", "locked"}
        How the structure is without its sinks: with their masses removed, as in the paper, or held where they start.
    settle : float
        A mass has settled when it stays below this part of its peak without sinks until the end, and has done so for the
        last 5 % of the run at least.
    harvesters : mapping of str to float, optional
        Dampers in N s/m in parallel to links, by link.
    excitation : Excitation
        What sets the structure in motion.

    Raises
    ------
    SimulationError
        If `settle` is not between 0 and 1.
    StructureError
        If `without` is neither of its two words.

    Examples
    --------
    >>> import linkwise as lw
    >>> options = lw.AbsorptionOptions.of(duration=2.0, release={"v:m1": 1.0})
    >>> [lw.absorb(lw.bnes_chain(2, alpha=alpha), options).trusted for alpha in (-100.0, -50.0)]
    [True, True]
    """

    duration: float
    rate: float | None = None
    sinks: Sequence[str] = ()
    without: str = "removed"
    settle: float = 0.05
    harvesters: Mapping[str, float] | None = None
    excitation: Excitation = field(default_factory=Excitation)

    def __post_init__(self) -> None:
        if not 0.0 < self.settle < 1.0:
            raise SimulationError(
                f"a mass settles when it stays below a part of its peak between 0 and 1, which {self.settle!r} is not"
            )
        if self.without not in BASELINES:
            raise StructureError(
                f"sinks can be compared with sinks {' or '.join(BASELINES)}, not with sinks {self.without!r}"
            )

    @classmethod
    def of(cls, **keywords: Unpack[AbsorptionKeywords]) -> AbsorptionOptions:
        """The options from keywords, those of `Excitation.of` among them.

        Raises SimulationError and StructureError for what cannot be asked, TypeError for a keyword that does not exist.
        """
        names = {each.name for each in fields(cls)}
        own: dict[str, Any] = {name: value for name, value in keywords.items() if name in names}
        drives: dict[str, Any] = {name: value for name, value in keywords.items() if name not in names}
        return cls(**own, excitation=Excitation.of(**drives))

    @classmethod
    def given(cls, options: AbsorptionOptions | None, keywords: AbsorptionKeywords) -> AbsorptionOptions:
        """The options of a call that may have either; TypeError for both."""
        if options is not None and keywords:
            raise TypeError(f"got options and also {', '.join(keywords)}; give one of the two")
        return cls.of(**keywords) if options is None else options
