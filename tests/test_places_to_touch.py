"""What it takes to add one of each kind of thing: how many new files, and how many lines elsewhere.

Each test adds something from outside the package, in modules of its own and through the registry of its kind, counts both, and
then uses the new thing as any user would. Nothing else is patched, so nothing else needed touching. CONTRIBUTING.md promises
these counts; those of what is read, shown and repeated are in test_places_of_results.py.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import Places, command
from problems import chain_record

import linkwise as lw
from linkwise.discovery.term_families import FAMILIES, TermFamily
from linkwise.estimates.cause import CAUSE_KINDS, CauseKind
from linkwise.estimates.findings import FINDINGS
from linkwise.expression.functions import FUNCTIONS, LawFunction
from linkwise.inspection.checks import CHECKS
from linkwise.likelihood.shooting.sensor_errors import ADDED
from linkwise.sindy.regression import REGRESSORS

pytestmark = pytest.mark.usefixtures("unrendered")


SPRING = """
[[mass]]
name = "m1"
mass = 1.0

[[link]]
name = "spring"
between = ["m1", "ground"]
law = "F*atan(d/s) + c*v"
coefficients = {coefficients}
"""


def test_a_function_of_laws_is_one_entry(places: Places) -> None:
    arctangent = LawFunction(
        value=np.arctan, derivatives=("1/(1 + x**2)",), antiderivative="x*atan(x) - 0.5*log(1 + x**2)"
    )
    places.line(FUNCTIONS, "atan", arctangent)
    assert (places.files, places.lines) == (0, 1)

    true = lw.parse_structure(SPRING.format(coefficients="{ F = 20.0, s = 0.02, c = 0.5 }"))
    assert true.link("spring").law.units == {"F": "N", "s": "m", "c": "N s/m"}
    record = lw.simulate(true, release={"v:m1": 1.0}, duration=2.0, rate=500.0)
    truth = record.simulated
    assert truth is not None
    put_in = truth.energy.supplied.max()
    assert abs(truth.energy.residual).max() < 1e-12 * put_in  # energies are those of the antiderivative
    subject = lw.parse_structure(
        SPRING.format(coefficients='{ F = { start = 10.0 }, s = 0.02, c = "unknown" }')
    )
    fit = lw.identify(record.with_noise(40.0, seed=1), subject)
    assert fit.trusted
    estimate = fit.coefficient("spring.F")
    assert estimate.standard_error is not None
    assert abs(estimate.value - 20.0) < 4.0 * estimate.standard_error  # 1 of 16 000 is further off


RIDGE = '''
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from linkwise.arrays import Floats
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.regressor import SupportCandidate, Regressor


@final
@dataclass(frozen=True)
class Ridge(Regressor):
    """Least squares with an L2 penalty on contributions."""

    title: ClassVar[str] = "least squares with an L2 penalty"

    penalty: float = 1e-12

    def solve(self, gram: Gram, target: int) -> tuple[Floats, float, tuple[SupportCandidate, ...]]:
        shrunk = gram.matrix + self.penalty * np.eye(len(gram.names))
        return np.linalg.solve(shrunk, gram.moments[:, target]), self.penalty, ()
'''

RIDGE_STUDY = """
snr_db = [40]
cycles = 1

[[structure]]
bnes = 2
release = { "v:m1" = 1.0 }
duration = 6.0
rate = 1000.0

[[method]]
kind = "classical"
convention = "states"
regressor = "ridge"

[[method]]
kind = "physics-informed"
regressor = "ridge"
"""


RIDGE_SCRIPT = """
import linkwise as lw
from linkwise.sindy.regression import REGRESSORS

REGRESSORS.register("ridge", "extra_ridge:Ridge")  # the workers of the study come by here too

if __name__ == "__main__":
    lw.run_study(lw.read_study("ridge.toml"), "study", workers=1)
"""


def test_a_regressor_is_a_file_and_a_line(places: Places, tmp_path: Path) -> None:
    places.file("extra_ridge", RIDGE)
    places.line(REGRESSORS, "ridge", "extra_ridge:Ridge")
    assert (places.files, places.lines) == (1, 1)

    chain = lw.bnes_chain(2)
    record = chain_record(2, duration=2.0, sensors=("x", "v", "a"))
    unknown = chain.unknown("all")
    ridge = lw.identify(record, unknown, method=lw.PhysicsInformedSindy(regressor="ridge"))
    plain = lw.identify(record, unknown, method=lw.PhysicsInformedSindy(regressor="least-squares"))
    assert np.all(ridge.values != plain.values)
    assert ridge.values == pytest.approx(
        plain.values, rel=1e-6
    )  # the penalty times the condition of the Gram matrix

    lw.write_record(record, tmp_path / "run.csv")
    lw.write_structure(unknown, tmp_path / "unknown.toml")
    assert "stlsq|l1|least-squares|ridge" in command("identify", "--help").output
    arguments = (
        "identify",
        str(tmp_path / "run.csv"),
        str(tmp_path / "unknown.toml"),
        "--method",
        "sindy",
        "--json",
    )
    document = json.loads(command(*arguments, "--regressor", "ridge").output)
    assert document["links"][0]["coefficients"]["k"]["value"] == ridge.coefficient("spring1.k").value

    (tmp_path / "ridge.toml").write_text(RIDGE_STUDY, encoding="utf-8")
    places.script(RIDGE_SCRIPT, tmp_path)
    assert [row.status for row in lw.read_rows(tmp_path / "study")] == ["converged", "converged"]
    page = lw.write_study_report(tmp_path / "study").read_text(encoding="utf-8")
    assert "least squares with an L2 penalty" in page


LABEL = """
import linkwise as lw
from linkwise.absorption import absorb
from linkwise.cli import run

compare = absorb.compare
absorb.compare = lambda comparison, progress: (print("label:", comparison.options.label), compare(comparison, progress))[1]
lw.absorb(lw.bnes_chain(2), duration=0.5, release={"v:m1": 1.0}, label="by keyword")
lw.absorb(lw.bnes_chain(2), lw.AbsorptionOptions.of(duration=0.5, release={"v:m1": 1.0}, label="by object"))
lw.write_structure(lw.bnes_chain(2), "chain.toml")
run(["absorb", "chain.toml", "--duration", "0.5", "--release", "v:m1=1.0", "--label", "by command"])
"""


def test_an_option_of_absorb_is_a_field_and_a_line(places: Places, tmp_path: Path) -> None:
    """In a copy of the package, since a frozen object has all of its fields from the start."""
    options = places.copy() / "absorption" / "options.py"
    places.insert(options, "    settle: float = 0.05\n", '    label: str = ""\n')
    places.insert(options, "    settle: float\n", "    label: str\n")  # its type, for those who check them
    command = options.parents[1] / "cli" / "absorb.py"
    places.insert(
        command, '    "options",\n', '    click.option("--label", help="What the answer is called."),\n'
    )
    assert (places.files, places.lines) == (0, 3)
    printed = places.script(LABEL, tmp_path)
    labels = [line for line in printed.splitlines() if line.startswith("label:")]
    assert labels == ["label: by keyword", "label: by object", "label: by command"]


TOO_LOUD = """
from linkwise.inspection.alert import Alert


def too_loud(signals):
    for each in signals.responses:
        if each.rms > 1e-3:
            yield Alert("loud", each.name, "moves by more than a millimetre; excite less", each.rms)
"""


def test_a_check_of_records_is_a_file_and_a_line(places: Places) -> None:
    places.file("extra_loud", TOO_LOUD)
    places.line(CHECKS, "loud", "extra_loud:too_loud")
    assert (places.files, places.lines) == (1, 1)

    inspection = lw.inspect(chain_record(2, duration=2.0).with_noise(30.0, seed=1))
    assert [(alert.kind, alert.channel) for alert in inspection.alerts] == [
        ("loud", "x:m2"),
        ("loud", "x:m1"),
    ]


def test_a_cause_of_misfit_is_two_entries(places: Places) -> None:
    places.line(ADDED, "asymmetry", lambda shown, rate, ramp: shown**2)
    places.line(
        CAUSE_KINDS,
        "asymmetry",
        CauseKind(lambda cause: f"an asymmetry of {cause.where} of {cause.size:.2g} per unit", unit="1/m"),
    )
    assert (places.files, places.lines) == (0, 2)

    record = chain_record(2, duration=2.0).with_noise(50.0, seed=1)
    values = record.values.copy()
    values[:, 0] += 0.5 * values[:, 0] ** 2  # the first sensor reads more on one side
    cause = lw.identify(replace(record, values=values), lw.bnes_chain(2).unknown("nes")).diagnosis[0]
    assert (cause.kind, cause.where, cause.unit) == ("asymmetry", record.channels[0], "1/m")
    # to first order, beside which the states and the coefficients give way
    assert abs(cause.size - 0.5) < 0.1
    assert str(cause.to_dict()["message"]).startswith("an asymmetry of x:m1 of ")


def test_a_family_of_terms_is_an_entry(places: Places) -> None:
    arch = TermFamily("cos(d/{})", "a force that repeats", argument="a length in m", symbol="L")
    places.line(FAMILIES, "periodic", arch)
    assert (places.files, places.lines) == (0, 1)

    assert [term.text for term in lw.parse_terms("linear, periodic(0.1)")] == ["v", "d", "cos(d/0.1)"]
    assert "periodic(L)        cos(d/L), a force that repeats" in command("discover", "--help").output
    with pytest.raises(
        lw.IdentificationError, match="the family periodic takes a length in m, a positive number"
    ):
        lw.parse_terms("periodic")


DAMPER = """
[[mass]]
name = "m1"
mass = 1.0

[[link]]
name = "damper"
between = ["m1", "ground"]
law = "power-damper"
coefficients = { k = 400.0, c = 5.0, p = 1.0 }
"""


def test_a_named_law_is_an_entry(places: Places) -> None:
    damper = lw.NamedLaw(
        title="spring and damper of a power of the velocity",
        source="this test",
        coefficients={"k": "stiffness", "c": "damping", "p": "exponent"},
        formula=lw.LawText("k*d + c*abs(v)**p*sign(v)", {}),
        bounds={"p": (0.0, 3.0)},
    )
    places.line(lw.NAMED_LAWS, "power-damper", damper)
    assert (places.files, places.lines) == (0, 1)

    assert lw.parse_structure(DAMPER).link("damper").law.text == "k*d + c*abs(v)**p*sign(v)"
    assert "spring and damper of a power of the velocity" in command("structure", "laws").output
    free = lw.parse_structure(DAMPER.replace("p = 1.0", 'p = "unknown"'))
    assert free.coefficient("damper.p").upper == 3.0  # the bounds come with the law


TOLD = """
from collections.abc import Iterator

from linkwise.estimates.link_estimate import LinkEstimate


def soft(link: LinkEstimate) -> Iterator[str]:
    if link.link.name == "nes1":
        yield "nes1 is as soft as butter."
"""


def test_a_finding_is_a_function_and_a_line(places: Places) -> None:
    places.file("extra_soft", TOLD)
    places.line(FINDINGS, "soft", "extra_soft:soft")
    assert (places.files, places.lines) == (1, 1)

    fit = lw.identify(chain_record(2, duration=2.0).with_noise(40.0, seed=1), lw.bnes_chain(2).unknown("nes"))
    assert "nes1 is as soft as butter." in fit.findings and "nes1 is as soft as butter." in str(fit)


PERIOD = '''
"""Periods of modes."""

from linkwise.analysis.modes import modes
from linkwise.argument_types import checked
from linkwise.model.structure import Structure


@checked
def longest_period(structure: Structure) -> float:
    """Longest period of a structure in s."""
    return float(1.0 / modes(structure).frequencies.min())
'''

PERIOD_SCRIPT = """
import linkwise as lw

print(lw.longest_period(lw.bnes_chain(2)), "longest_period" in dir(lw), lw.__all__.count("longest_period"))
try:
    lw.longest_period("chain.toml")
except lw.ArgumentTypeError as error:
    print(error)
"""


def test_a_public_function_is_a_file_and_a_line(places: Places, tmp_path: Path) -> None:
    """In a copy of the package; the reference is made of the same list of names (docs/extensions/api_reference.py)."""
    package = places.copy()
    places.file("linkwise/analysis/period", PERIOD)
    line = "from linkwise.analysis.period import longest_period as longest_period\n"
    places.insert(package / "__init__.pyi", "from linkwise.analysis.modes import modes as modes\n", line)
    assert (places.files, places.lines) == (1, 1)

    printed = places.script(PERIOD_SCRIPT, tmp_path).splitlines()
    assert printed[0] == f"{1.0 / lw.modes(lw.bnes_chain(2)).frequencies.min()} True 1"
    assert printed[1].startswith(
        "longest_period(structure): structure must be of type Structure, got 'chain.toml'"
    )
