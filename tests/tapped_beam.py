"""A slender cantilever by three modes, and what accelerometers show of a hammer on it."""

from __future__ import annotations

from functools import cache

import linkwise as lw

number = lw.Coefficient.number
FREQUENCIES = (3.3, 20.6, 57.7)  # Hz, of a slender cantilever
SHAPES = {"tip": (3.2, -3.2, 3.2), "mid": (1.1, 2.3, 0.06)}
DAMPING = 0.01
TAP = "8*exp(-((t - 0.05)/0.004)**2)"  # N, of a hammer


def beam() -> lw.Host:
    return lw.Host(
        "beam",
        tuple(
            lw.HostMode(
                number(frequency), number(DAMPING), {point: shape[r] for point, shape in SHAPES.items()}
            )
            for r, frequency in enumerate(FREQUENCIES)
        ),
    )


@cache
def tapped(point: str = "tip", *, release: float = 0.0, cubic: float = 0.0, level: float = 1.0) -> lw.Record:
    """A tap at a point, and two accelerometers; `release` in sqrt(kg) m/s of the first mode, a spring in N/m^3 at the tip."""
    links: tuple[lw.Link, ...] = ()
    if cubic:
        links = (lw.Link("stop", ("beam.tip", lw.GROUND), lw.Law.parse("k3*d**3"), {"k3": number(cubic)}),)
    return lw.simulate(
        lw.Structure("test", (), links, (beam(),)),
        forces={f"beam.{point}": f"{level}*{TAP}"},
        release={"v:beam.mode1": release} if release else {},
        duration=1.5,
        rate=400.0,
        sensors=["a:beam.tip", "a:beam.mid"],
    )
