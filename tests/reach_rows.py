"""A small study of methods that look for terms, and rows of it that nobody had to compute."""

from dataclasses import replace
from pathlib import Path

from linkwise.study.definition import Study, parse_study
from linkwise.study.subject import Case, Row
from linkwise.study.summary import StudySummary, SuccessMap, maps_of

TEXT = """
name = "small reach"
snr_db = [40, 20, 8]
cycles = 4
quick = 1

[[structure]]
name = "chain"
bnes = 2
release = { "v:m1" = 1.0 }
frequency = 20.0
duration = [1.0, 2.0]
rate = [500.0, 100.0]

[[method]]
kind = "discover"

[[method]]
kind = "sindy"
"""
EXACT = [[0, 1, 2], [1, 3, 4]]  # of four cycles, at 100 and 500 Hz and 8, 20 and 40 dB


def reach_study() -> Study:
    """Two lengths at two rates, three noise levels, two methods and four cycles."""
    return parse_study(TEXT, "reach.toml", Path())


def reach_rows(study: Study) -> list[Row]:
    """`discover` is exact in as many cycles as `EXACT` says, and trusted in one more; the other never, and always trusted."""
    return [_row(study, case) for case in study.cases()]


def _row(study: Study, case: Case) -> Row:
    if case.method != "discover":
        return _judged(case, "converged", missing=2, extra=3)
    rate, cycle = study.subject(case.structure).rate, study.cycle(case)
    exact = EXACT[[100.0, 500.0].index(rate)][[8.0, 20.0, 40.0].index(case.snr_db)]
    if cycle < exact:
        return _judged(case, "converged")
    return _judged(case, "converged" if cycle == exact else "not converged", missing=1)


def _judged(case: Case, status: str, *, missing: int = 0, extra: int = 0) -> Row:
    terms = {"right": 5 - missing, "missing": missing, "extra": extra}
    row = Row(case.structure, 2, case.snr_db, case.method, case.seed, status=status, seconds=0.1)
    return replace(row, links={"nes1": 0.01 + missing}, terms=terms)


def reach_maps() -> tuple[SuccessMap, ...]:
    """What `success_maps` counts in these rows."""
    study = reach_study()
    return maps_of(study, StudySummary.of(study, reach_rows(study)))
