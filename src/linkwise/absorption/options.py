"""The options of an absorption: one frozen object, and the keywords that it is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import NoneType
from typing import Any, Unpack, final

from linkwise.errors import SimulationError, StructureError, expect
from linkwise.model.excitation import Excitation
from linkwise.simulation.simulate import ExcitationKeywords

BASELINES = ("removed", "locked")


class AbsorptionKeywords(ExcitationKeywords, total=False):
    """The keywords of `AbsorptionOptions.of`: its fields, and those of `Excitation.of`."""

    duration: float | None
    rate: float | None
    sinks: Sequence[str]
    without: str
    settle: float
    harvesters: Mapping[str, float | str] | None


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class AbsorptionOptions:
    """The options of `absorb`, `absorption_intervals` and `absorption_map`.

    Those functions take the same as keywords; an object serves for several structures.

    Parameters
    ----------
    duration : float, optional
        Time to simulate, in s; by default three decay times of the least damped mode without sinks, or 300 of its periods.
    rate : float, optional
        Samples per second in Hz; by default at least 20 in a period of the fastest mode.
    sinks : sequence of str
        The links that are sinks; without names, every link with more than one stable well is one.
    without : {"removed", "locked"}
        How the sinks are taken out for comparison: their masses and all links to these are removed, as in the paper, or
        the sinks are locked at their initial elongation. Removed by default.
    settle : float
        A mass has settled when its excursion stays below this part of its peak without sinks, for the last 5 % of the run
        at least; 0.05 by default. Excursions are counted from the stable equilibrium where it ends.
    harvesters : mapping of str to float or str, optional
        Harvesters by link: the damping in N s/m of a damper in parallel, or the power in W that the link itself delivers, an
        expression in d, v, its states and its coefficients such as ``"V**2/R"``.
    excitation : Excitation
        What sets the structure in motion.

    Raises
    ------
    SimulationError
        If `settle` is not between 0 and 1.
    StructureError
        If `without` is neither "removed" nor "locked".

    Examples
    --------
    >>> import linkwise as lw
    >>> options = lw.absorption.AbsorptionOptions.of(duration=2.0, release={"v:m1": 1.0})
    >>> [lw.absorb(lw.bnes_chain(2, alpha=alpha), options).trusted for alpha in (-100.0, -50.0)]
    [True, True]
    """

    duration: float | None = field(default=None, metadata={"typed": "S"})
    rate: float | None = field(default=None, metadata={"typed": "HZ"})
    sinks: Sequence[str] = field(default=(), metadata={"typed": "LINK"})
    without: str = field(
        default="removed", metadata={"typed": "BASELINE", "choices": {name: name for name in BASELINES}}
    )
    settle: float = field(default=0.05, metadata={"typed": "PART"})
    harvesters: Mapping[str, float | str] | None = field(
        default=None, metadata={"typed": "LINK=NS/M|POWER", "example": "nes1=0.01"}
    )
    excitation: Excitation = field(default_factory=Excitation)

    def __post_init__(self) -> None:
        expect("AbsorptionOptions: duration", self.duration, float, NoneType)
        expect("AbsorptionOptions: settle", self.settle, float)
        if not 0.0 < self.settle < 1.0:
            message = f"settle is a part of the peak and must be between 0 and 1, got {self.settle!r}"
            raise SimulationError(message)
        if self.without not in BASELINES:
            known = ", ".join(map(repr, BASELINES))
            raise StructureError(f"unknown way to take out sinks, {self.without!r}; choose from {known}")

    @classmethod
    def of(cls, **keywords: Unpack[AbsorptionKeywords]) -> AbsorptionOptions:
        """Make options from keywords.

        Parameters
        ----------
        **keywords
            The fields but `excitation`, and those of `Excitation.of`: `release`, `impulses`, `forces`, `base`.

        Returns
        -------
        AbsorptionOptions
            The options.

        Raises
        ------
        SimulationError, StructureError
            If an option or the excitation is invalid.
        TypeError
            If a keyword is unknown.
        """
        names = {option.name for option in fields(cls)}
        own: dict[str, Any] = {name: value for name, value in keywords.items() if name in names}
        drives: dict[str, Any] = {name: value for name, value in keywords.items() if name not in names}
        return cls(**own, excitation=Excitation(**drives))
