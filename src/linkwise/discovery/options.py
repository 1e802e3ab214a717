"""The options of a discovery: one frozen object, and the keywords that it is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypedDict, Unpack, final

from linkwise.discovery.terms import DEFAULT, parse_terms
from linkwise.errors import expect
from linkwise.likelihood.options import ADMIT, AMBIENT, CALIBRATION, INPUT_NOISE
from linkwise.likelihood.random_forces import Deviations


def _copied(stated: Deviations) -> Deviations:
    """What was stated of random forces, so that it stays as it is; what is neither is refused where it is used."""
    if isinstance(stated, Mapping):
        return dict(stated)
    return tuple(stated) if isinstance(stated, Sequence) and not isinstance(stated, str) else stated


class DiscoveryKeywords(TypedDict, total=False):
    """The keywords of `DiscoveryOptions.of`: its fields."""

    terms: str | Sequence[str]
    offsets: str | Sequence[str]
    gains: str | Sequence[str]
    calibration: Mapping[str, float]
    delays: str | Sequence[str]
    admit: str | Sequence[str]
    ambient: Deviations
    input_noise: Deviations
    tested: str | Sequence[str]


@final
@dataclass(frozen=True, kw_only=True)
class DiscoveryOptions:
    """The options of `discover` and `check_discovery`.

    Those functions take the same as keywords; an object serves for several records.

    Parameters
    ----------
    terms : str or sequence of str
        The candidate terms of every link, functions of d and v, or families of them;
        "v, d, d**2, d**3" by default.
    offsets, gains : sequence of str
        Channels with an unknown constant error or factor, which every fit of the search finds with the terms; of factors also
        those of applied forces.
    calibration : mapping of str to float
        Relative standard deviations to which the gains of sensors and of applied forces are known, by channel: 0.01, or 1 %;
        ``"all"`` and ``"common"`` as of `MaximumLikelihood`.
    delays : sequence of str
        Channels with an unknown delay, which every fit finds likewise.
    admit : sequence of {"gain", "offset", "delay"}
        Errors of sensors that are taken into the model where they are significant: the search is repeated with those that its
        diagnosis names.
    ambient : sequence of str or mapping of str to float or None
        Masses on which a random force acts that no channel shows, as of `MaximumLikelihood`: every fit of the search counts
        them in.
    input_noise : sequence of str or mapping of str to float or None
        Inputs whose channel has noise, likewise.
    tested : str or sequence of str
        Links, by their ends as in "m3-m1", whose terms are all tested by likelihood; "all" for every link, which takes memory
        with the square of the candidates. By default, of more than 12 masses those are tested that are significant in the
        equation of one of their masses.

    Raises
    ------
    IdentificationError
        If the terms are not a list of candidates, as `parse_terms` raises it.
    LawError
        If a term is not a valid expression.

    Examples
    --------
    >>> import linkwise as lw
    >>> options = lw.discovery.DiscoveryOptions(terms="linear, d**3")
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> found = lw.discover(record, {"m1": 1.0, "m2": 0.01}, options)
    >>> [link.law.text for link in found.structure.links]
    ['k*d + c*v', 'k*d + k3*d**3 + c*v']
    """

    terms: str | Sequence[str] = field(default=DEFAULT, metadata={"typed": "LIST"})
    offsets: str | Sequence[str] = ()
    gains: str | Sequence[str] = ()
    calibration: Mapping[str, float] = field(default_factory=dict, hash=False, metadata=CALIBRATION)
    delays: str | Sequence[str] = ()
    admit: str | Sequence[str] = field(default=(), metadata=ADMIT)
    ambient: Deviations = field(default=(), hash=False, metadata=AMBIENT)
    input_noise: Deviations = field(default=(), hash=False, metadata=INPUT_NOISE)
    tested: str | Sequence[str] = field(default=(), metadata={"typed": "LIST"})

    def __post_init__(self) -> None:
        terms = self.terms if isinstance(self.terms, str) else tuple(self.terms)
        object.__setattr__(self, "terms", terms)
        for name in ("offsets", "gains", "delays", "admit", "tested"):
            given = getattr(self, name) or ()
            expect(f"DiscoveryOptions: {name}", given, str, tuple, list)
            object.__setattr__(self, name, (given,) if isinstance(given, str) else tuple(given))
        object.__setattr__(self, "calibration", dict(self.calibration or {}))
        for name in ("ambient", "input_noise"):
            object.__setattr__(self, name, _copied(getattr(self, name) or ()))
        parse_terms(terms)  # raises what is wrong with them

    @classmethod
    def of(cls, **keywords: Unpack[DiscoveryKeywords]) -> DiscoveryOptions:
        """Make options from keywords.

        Parameters
        ----------
        **keywords
            The fields.

        Returns
        -------
        DiscoveryOptions
            The options.

        Raises
        ------
        TypeError
            If a keyword is unknown.
        """
        return cls(**keywords)

    @classmethod
    def given(cls, options: DiscoveryOptions | None, keywords: DiscoveryKeywords) -> DiscoveryOptions:
        """The options of a call that takes either an object or keywords.

        Parameters
        ----------
        options : DiscoveryOptions or None
            The object, where the call has one.
        keywords : mapping
            The keywords of the call, as `of` takes them.

        Returns
        -------
        DiscoveryOptions
            `options`, or those made from the keywords.

        Raises
        ------
        TypeError
            If both are given, or a keyword is unknown.
        """
        if options is not None and keywords:
            raise TypeError(f"got options and also {', '.join(keywords)}; give one of the two")
        return cls.of(**keywords) if options is None else options
