"""The result of a modal test: a host whose modes are known to within their standard errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from linkwise.display import JudgedView, as_text
from linkwise.model.host import Host
from linkwise.verdict import Verdict


@dataclass(frozen=True)
class HostEstimate(JudgedView):
    """A host that was identified from the records of a modal test.

    Attributes
    ----------
    host : Host
        Its modes; frequencies, damping, also between modes, and shapes are known to within their standard errors.
    faint : tuple of str
        Modes that hardly stand above the noise, such as ``"beam.mode7"``: each may stand for several, or for what modes above
        the band give, and its values are stated as known to within wide bounds.
    chi_square_per_sample : float
        Power of the residuals over that of the noise.
    samples : int
        Number of samples.
    verdicts : tuple of Verdict
        What can be said of it.
    remarks : tuple of str
        Sentences on what the records do not determine.
    seconds : float
        Computing time in s.

    See Also
    --------
    identify_host : Identifies it.

    Examples
    --------
    >>> import linkwise as lw
    >>> known = lw.Coefficient.number
    >>> wing = lw.Host("wing", (lw.HostMode(known(5.2), known(0.01), {"tip": 1.0, "joint": 0.62}),))
    >>> record = lw.simulate(
    ...     lw.Structure("test", (), (), (wing,)),
    ...     forces={"wing.tip": "5*exp(-((t - 0.1)/0.02)**2)"},
    ...     duration=2.0,
    ...     rate=200.0,
    ...     sensors=["a:wing.tip", "a:wing.joint"],
    ... )
    >>> found = lw.identify_host(record.with_noise(30.0, seed=1))
    >>> found.trusted, len(found.host.modes)
    (True, 1)
    """

    host: Host
    faint: tuple[str, ...]
    chi_square_per_sample: float
    samples: int
    verdicts: tuple[Verdict, ...]
    remarks: tuple[str, ...]
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data.

        Returns
        -------
        dict
            "modes" with frequencies in Hz, damping as a part of the critical one and shapes in 1/sqrt(kg), each with its
            standard error; where damping couples modes, "damping" with the entry of each pair in N s/m; the fit, verdicts and
            remarks.
        """
        names = self.host.coordinates
        between = [
            {
                "modes": [names[first - 1], names[second - 1]],
                "value": entry.value,
                "standard_error": entry.sigma,
            }
            for (first, second), entry in self.host.entries.items()
        ]
        return {
            "method": "identify_host",
            **self._judgement(),
            "message": " ".join(verdict.value for verdict in self.verdicts),
            "seconds": self.seconds,
            "fit": {"chi_square_per_sample": self.chi_square_per_sample, "samples": self.samples},
            "host": self.host.name,
            "modes": [
                {
                    "name": name,
                    "faint": name in self.faint,
                    "frequency": {"value": mode.frequency.value, "standard_error": mode.frequency.sigma},
                    "damping": {"value": mode.damping.value, "standard_error": mode.damping.sigma},
                    "shape": {
                        point: {"value": size, "standard_error": mode.shape_sigma.get(point, 0.0)}
                        for point, size in mode.shape.items()
                    },
                }
                for name, mode in zip(self.host.coordinates, self.host.modes, strict=True)
            ],
            **({"damping": between} if between else {}),
            "remarks": list(self.remarks),
        }

    def __str__(self) -> str:
        return as_text(self)
