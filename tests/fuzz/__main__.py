"""`python -m fuzz --inputs 10000`: the numbers of all that ran, and every input of which something came that must not."""

import argparse
import sys
from collections import Counter
from pathlib import Path

from fuzz.case import complaints
from fuzz.cases import make_case
from fuzz.pool import outcomes
from linkwise.runtime import processors


def main() -> int:
    parser = argparse.ArgumentParser(prog="fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000, help="how many (default %(default)s)")
    parser.add_argument("--first", type=int, default=0, help="the first seed (default %(default)s)")
    parser.add_argument(
        "--processes", type=int, default=processors(), help="how many (default: one for each processor)"
    )
    parser.add_argument("--keep", type=Path, help="a folder for the files of inputs that failed")
    arguments = parser.parse_args()
    families: Counter[str] = Counter()
    codes: Counter[str] = Counter()
    failed = 0
    for seed, outcome in outcomes(
        range(arguments.first, arguments.first + arguments.inputs), arguments.processes
    ):
        case = make_case(seed)
        families[case.family] += 1
        codes["-" if outcome.code is None else str(outcome.code)] += 1
        wrong = complaints(case, outcome)
        if wrong:
            failed += 1
            print(
                f"seed {seed} ({case.family}): {'; '.join(wrong)}\n    {' '.join(case.arguments)[:200]!r}",
                flush=True,
            )
            for name, content in case.files.items() if arguments.keep else ():
                path = arguments.keep / str(seed) / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
    counts = ", ".join(f"{count} of {family}" for family, count in sorted(families.items()))
    ends = ", ".join(f"{count} with {code}" for code, count in sorted(codes.items()))
    print(f"{families.total()} inputs: {counts}\nended: {ends}\n{failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
