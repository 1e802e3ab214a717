"""The equations of motion for other programs, z' = f(t, z, u; p), with their Jacobians, as assignments of expressions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from linkwise.display import identifiers
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.uncertainty import Posterior
from linkwise.export.answer import ExportedAnswer, ExportFormat, written
from linkwise.expression import (
    Expression,
    Number,
    Symbol,
    add,
    differentiate,
    kinks,
    multiply,
    power,
    substitute,
    symbols,
    to_text,
)
from linkwise.expression.program import cached_program
from linkwise.expression.tree import ONE, ZERO, Call, CodeStyle, Power, Product, Sum, children, to_code
from linkwise.model.coefficient import MASS
from linkwise.model.link import BASE, Link
from linkwise.model.structure import Structure, Weights, refuse_rig

COMMON = "common:"
"""What the names of common subexpressions begin with; no name of a law does."""


def with_common_subexpressions(assignments: Mapping[str, Expression]) -> dict[str, Expression]:
    """The assignments in their order, each after those of the parts that occur more than once, ``common:1`` and on.

    An expression may contain the names that are assigned before it.

    >>> from linkwise.expression import parse, to_text
    >>> shared = with_common_subexpressions({"f": parse("k*exp(d)"), "g": parse("v + exp(d)")})
    >>> {name: to_text(part) for name, part in shared.items()}
    {'common:1': 'exp(d)', 'f': 'k*common:1', 'g': 'v + common:1'}
    """
    times: Counter[Expression] = Counter()

    def count(node: Expression) -> None:
        times[node] += 1
        for below in children(node) if times[node] == 1 else ():
            count(below)

    for expression in assignments.values():
        count(expression)
    result: dict[str, Expression] = {}
    names: dict[Expression, Symbol] = {}

    def written(node: Expression) -> Expression:
        if node in names:
            return names[node]
        inner = _rebuilt(node, [written(below) for below in children(node)])
        if times[node] == 1 or isinstance(node, Number | Symbol):
            return inner
        names[node] = Symbol(f"{COMMON}{len(names) + 1}")
        result[names[node].name] = inner
        return names[node]

    for name, expression in assignments.items():
        result[name] = written(expression)
    return result


def _rebuilt(node: Expression, below: list[Expression]) -> Expression:
    """The node over other children, as it is and not in canonical form, which would take sums apart."""
    match node:
        case Sum() | Product():
            return type(node)(tuple(below))
        case Call(function, _):
            return Call(function, tuple(below))
        case Power(_, exponent):
            return Power(below[0], below[1] if len(below) > 1 else exponent)
    return node


Place = tuple[int, ...]
"""Where an entry stands in what is computed, from 0: (row,) or (row, column)."""


@dataclass(frozen=True)
class Assignments:
    """What a function of exported equations computes: `entries` of an array, 0 elsewhere, after `values` that these need.

    Names of values are those of the symbols; `notes` says of some what they are.
    """

    values: Mapping[str, Expression]
    entries: Mapping[Place, Expression]
    notes: Mapping[str, str]

    @classmethod
    def of(
        cls, values: Mapping[str, Expression], entries: Mapping[Place, Expression], notes: Mapping[str, str]
    ) -> Assignments:
        """With only the values that the entries need, and every common subexpression computed once."""
        wanted = [name for entry in entries.values() for name in symbols(entry)]
        needed = set(wanted)
        while wanted:
            if (name := wanted.pop()) in values:
                wanted += [inner for inner in symbols(values[name]) if inner not in needed]
                needed.update(symbols(values[name]))
        places = {f"entry:{number}": place for number, place in enumerate(entries)}
        kept = {name: value for name, value in values.items() if name in needed}
        kept |= zip(places, entries.values(), strict=True)
        shared = with_common_subexpressions(kept)
        return cls(
            {name: value for name, value in shared.items() if name not in places},
            {place: shared[name] for name, place in places.items()},
            notes,
        )

    @cached_property
    def inputs(self) -> frozenset[str]:
        """The names that are needed and not assigned."""
        trees = (*self.values.values(), *self.entries.values())
        return frozenset(name for tree in trees for name in symbols(tree)) - set(self.values)

    def evaluated(self, given: Mapping[str, float]) -> dict[Place, float]:
        """The entries for numbers by name."""
        numbers = dict(given)

        def number(tree: Expression) -> float:
            names = symbols(tree)
            return float(cached_program((tree,), names)(*(numbers[name] for name in names))[0])

        for name, tree in self.values.items():
            numbers[name] = number(tree)
        return {place: number(tree) for place, tree in self.entries.items()}


@dataclass(frozen=True, eq=False)
class EquationsOfMotion:
    """The equations of a structure of numbers: z holds displacements, velocities and states of links, u the inputs.

    Names of states and inputs are those of channels, such as ``"x:m1"`` and ``"force:m1"``; a moving base is two inputs, its
    displacement and its velocity, and a signal of laws one, ``"signal:u"``. Names of parameters are those of coefficients,
    such as ``"nes1.alpha"``.
    """

    answer: ExportedAnswer

    def __post_init__(self) -> None:
        refuse_rig(self.structure, "an export of equations of motion")

    @property
    def structure(self) -> Structure:
        """The structure, every coefficient of which is a number."""
        return self.answer.structure

    @cached_property
    def states(self) -> dict[str, str]:
        """The SI unit of each state (D,), by name."""
        structure = self.structure
        units = {f"x:{mass.name}": mass.unit for mass in structure.masses}
        units |= {f"v:{mass.name}": f"{mass.unit}/s" for mass in structure.masses}
        for number, name in structure.topology.states:
            link = structure.links[number]
            units[f"state:{link.name}.{name}"] = link.law.state_units[name]
        return units

    @cached_property
    def initial(self) -> list[float]:
        """The states (D,) at which a simulation begins without a release."""
        states = [link.states for link in self.structure.links]
        inside = [states[number][name].initial or 0.0 for number, name in self.structure.topology.states]
        return [0.0] * (2 * self.structure.size) + inside

    @cached_property
    def inputs(self) -> dict[str, str]:
        """The SI unit of each input (U,), by name."""
        structure, turning = self.structure, self.structure.rotations
        units = {f"force:{place}": "N m" if place in turning else "N" for place in structure.places}
        units |= {f"x:{BASE}": "m", f"v:{BASE}": "m/s"} if structure.base_incidence.any() else {}
        return units | {f"signal:{name}": unit for name, unit in structure.signals.items()}

    @cached_property
    def parameters(self) -> dict[str, float]:
        """The value of each mass and coefficient (P,), those once that are shared."""
        every = {f"{entry.owner}.{entry.name}": entry.value for entry in self.answer.coefficients}
        left_out = {f"{name}.{MASS}" for name in self.structure.modes} | set(self.structure.leaders)
        return {name: value for name, value in every.items() if name not in left_out}

    @cached_property
    def units(self) -> dict[str, str]:
        """The SI unit of each parameter, by name; "" where there is none."""
        every = {f"{entry.owner}.{entry.name}": entry.unit for entry in self.answer.coefficients}
        return {name: "" if every[name] == "?" else every[name] for name in self.parameters}

    @cached_property
    def shown(self) -> dict[str, Expression]:
        """Displacement and velocity of each mass and point (Y,), by name, in states."""
        places = [(name.removeprefix("force:"), weights) for name, weights in self._driven.items()]
        return {f"{kind}:{place}": self._moved(kind, parts) for kind in "xv" for place, parts in places}

    @cached_property
    def rates(self) -> Assignments:
        """The rates of the states (D,)."""
        return Assignments.of(
            self._values, {(row,): rate for row, rate in enumerate(self._rates)}, self._notes
        )

    @cached_property
    def jacobian(self) -> Assignments:
        """Its derivatives by the states (D, D)."""
        return self._derivatives(list(self.states))

    @cached_property
    def input_jacobian(self) -> Assignments:
        """Its derivatives by the inputs (D, U)."""
        return self._derivatives(list(self.inputs))

    @property
    def functions(self) -> tuple[tuple[str, Assignments, int], ...]:
        """The functions of an export: name, what it computes, and the number of columns of that."""
        size, inputs = len(self.states), len(self.inputs)
        jacobians = ("jacobian", self.jacobian, size), ("input_jacobian", self.input_jacobian, inputs)
        return ("rhs", self.rates, 1), *jacobians

    @property
    def arrays(self) -> dict[str, Sequence[str]]:
        """The names of the entries of each array that the functions take."""
        return {"z": list(self.states), "u": list(self.inputs), "p": list(self.parameters)}

    @cached_property
    def _rates(self) -> list[Expression]:
        """The rates of the states (D,) in velocities, forces on masses, and rates that links give."""
        structure = self.structure
        columns = zip(structure.links, structure.topology.columns, strict=True)
        onto = [(f"f:{link.name}", -1.0, parts) for link, parts in columns]
        onto += [(name, 1.0, parts) for name, parts in self._driven.items()]
        forces: list[list[Expression]] = [[] for _ in structure.masses]
        for name, sign, parts in onto:
            for mass, part in parts:
                forces[mass].append(multiply(Number(sign * part), Symbol(name)))
        rates: list[Expression] = [Symbol(f"v:{mass}") for mass in structure.mass_names]
        pairs = zip(forces, self._masses, strict=True)
        rates += [multiply(add(*parts), power(mass, -1)) for parts, mass in pairs]
        return rates + [Symbol(f"rate of {name}") for name in list(self.states)[2 * structure.size :]]

    def _derivatives(self, columns: Sequence[str]) -> Assignments:
        """Those of the rates by the symbols of `columns`, by the chain rule over what links give and how they move."""
        entries: dict[Place, list[Expression]] = {}
        for row, rate in enumerate(self._rates):
            for given in symbols(rate):
                outer = differentiate(rate, given)
                for variable, (slope, _) in self._slopes.get(given, {given: (ONE, ONE)}).items():
                    moved = self._values.get(variable, Symbol(variable))
                    for name in set(columns).intersection(symbols(moved)):
                        product = multiply(outer, slope, differentiate(moved, name))
                        entries.setdefault((row, columns.index(name)), []).append(product)
        slopes = {slope.name: tree for own in self._slopes.values() for slope, tree in own.values()}
        sums = ((place, add(*parts)) for place, parts in sorted(entries.items()))
        values = {place: tree for place, tree in sums if tree != ZERO}
        return Assignments.of(self._values | slopes, values, self._notes)

    def _leader(self, name: str) -> str:
        """The name of the parameter that has the value of a coefficient, itself unless it is shared."""
        return self.structure.leaders.get(name, name)

    @cached_property
    def _masses(self) -> list[Expression]:
        """The symbol of each mass (n,); of a mode the number 1."""
        names, modes = self.structure.mass_names, self.structure.modes
        return [Number(1.0) if name in modes else Symbol(self._leader(f"{name}.{MASS}")) for name in names]

    @cached_property
    def _driven(self) -> dict[str, Weights]:
        """The parts of the masses in each applied force, by name of the input."""
        topology = self.structure.topology
        return {f"force:{place}": topology.weights(topology.index[place]) for place in self.structure.places}

    @cached_property
    def _values(self) -> dict[str, Expression]:
        """Elongation, rate of elongation, force and rates of states of each link, by name."""
        values = {}
        for number, link in enumerate(self.structure.links):
            base = float(self.structure.base_incidence[number])
            for kind, name in (("x", f"d:{link.name}"), ("v", f"dv:{link.name}")):
                moved = self._moved(kind, self.structure.topology.columns[number])
                values[name] = add(moved, multiply(Number(base), Symbol(f"{kind}:{BASE}")))
            values |= {name: substitute(tree, self._renamed(link)) for name, tree in _laws(link).items()}
        return values

    @cached_property
    def _slopes(self) -> dict[str, dict[str, tuple[Symbol, Expression]]]:
        """The derivatives that are not zero of the force and the rates of each link, by what they depend on, with symbols."""
        slopes = {}
        for link in self.structure.links:
            names = self._renamed(link)
            variables = {"d": "d", "v": "v", **_inner(link)}
            for of, tree in _laws(link).items():
                slopes[of] = {
                    names[variable].name: (Symbol(f"slope:{by}:{of}"), substitute(slope, names))
                    for variable, by in variables.items()
                    if (slope := differentiate(tree, variable)) != ZERO
                }
        return slopes

    def _moved(self, kind: str, weights: Weights) -> Expression:
        names = self.structure.mass_names
        return add(*(multiply(Number(part), Symbol(f"{kind}:{names[mass]}")) for mass, part in weights))

    def _renamed(self, link: Link) -> dict[str, Symbol]:
        """What the symbols of the laws of a link are called in those of the structure."""
        names = {"d": f"d:{link.name}", "v": f"dv:{link.name}", **_inner(link)}
        names |= {key: self._leader(f"{link.name}.{key}") for key in link.law.coefficients}
        return {key: Symbol(name) for key, name in names.items()}

    @cached_property
    def _notes(self) -> dict[str, str]:
        """The law of each force and rate, and where it is not smooth."""
        notes = {}
        for link in self.structure.links:
            for name, tree in _laws(link).items():
                corners = " and ".join(f"{to_text(kink)} = 0" for kink in kinks(tree))
                kinked = f" (kinks: not smooth where {corners})" if corners else ""
                notes[name] = f"{link.name}: {to_text(tree)}{kinked}"
        return notes

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What there is to know beside the equations: trust, and laws that are not smooth."""
        kinked = [link.name for link in self.structure.links if any(map(kinks, _laws(link).values()))]
        notes = [self.answer.basis.remark] if self.answer.basis.remark else []
        if kinked:
            notes.append(
                f"Not smooth: the laws of {', '.join(kinked)} have kinks, which are marked; keep steps short there, or let "
                "events of the solver stop it at them."
            )
        return tuple(notes)

    def identifiers(self, reserved: Sequence[str]) -> dict[str, str]:
        """A name for every symbol, in a language with these reserved words."""
        # a kind in front of every name, so that none is that of a macro or function of some library
        kinds = {name: name for name in self.states}
        kinds |= {name: f"p_{name}" for name in self.parameters} | {name: f"u_{name}" for name in self.inputs}
        kinds |= {name: kinds.get(name, name) for _, block, _ in self.functions for name in block.values}
        chosen = identifiers(kinds.values(), reserved)
        return {name: chosen[kind] for name, kind in kinds.items()}


def _inner(link: Link) -> dict[str, str]:
    """The states and signals in the laws of a link, and what they are called in those of the structure."""
    names = {state: f"state:{link.name}.{state}" for state in link.law.states}
    return names | {signal: f"signal:{signal}" for signal in link.law.signals}


def _laws(link: Link) -> dict[str, Expression]:
    """The force of a link and the rates of its states, by the names that they have in equations."""
    rates = {f"rate of state:{link.name}.{name}": tree for name, tree in link.law.named_rates}
    return {f"f:{link.name}": link.law.expression, **rates}


@dataclass(frozen=True)
class Notation:
    """How a language writes an assignment, an entry of an array, and a comment on a line of its own."""

    style: CodeStyle
    value: str
    entry: Callable[[str, Place], str]
    comment: Callable[[str], str]
    end: str = ""

    def lines(
        self,
        assignments: Assignments,
        arrays: Mapping[str, Sequence[str]],
        names: Mapping[str, str],
        result: str,
    ) -> list[str]:
        """The statements that read what is needed of `arrays`, name of the array to names of its entries, into `result`."""
        lines = [
            self._assigned(names[entry], self.entry(array, (number,)))
            for array, entries in arrays.items()
            for number, entry in enumerate(entries)
            if entry in assignments.inputs
        ]
        for name, value in assignments.values.items():
            if name in assignments.notes:
                lines.append(self.comment(assignments.notes[name]))
            lines.append(self._assigned(names[name], to_code(value, self.style, names)))
        for place, value in assignments.entries.items():
            lines.append(f"{self.entry(result, place)} = {to_code(value, self.style, names)}{self.end}")
        return lines

    def _assigned(self, name: str, value: str) -> str:
        return f"{self.value.format(name)} = {value}{self.end}"


EQUATIONS = {
    ".py": ExportFormat(
        "a Python module for NumPy: rhs(t, z, u) and jacobian(t, z, u), as solve_ivp takes them",
        "linkwise.export.python:write_equations",
    ),
    ".m": ExportFormat(
        "a function for MATLAB and Octave, as ode45 and Simulink take it",
        "linkwise.export.matlab:write_equations",
    ),
    ".c": ExportFormat("functions in C99 without dependencies", "linkwise.export.c:write_equations"),
    ".fmu": ExportFormat(
        "a unit for co-simulation (FMI 2.0), with C sources and a binary of this machine where it has a C compiler",
        "linkwise.export.fmu:write_equations",
    ),
}


def export_equations(answer: Structure | Estimate | Posterior | str | Path, path: str | Path) -> Path:
    """Write the equations of motion z' = f(t, z, u) of a structure, and their Jacobians, for another program.

    States z are the displacements of all masses and modes, their velocities, and the states of links with memory; inputs u are
    the forces on masses and points of hosts, then displacement and velocity of the base where a link has it as an end, and the
    signals that laws name.

    Parameters
    ----------
    answer : Structure, Estimate, Posterior, str or Path
        As of `export_answer`.
    path : str or Path
        The file, in the language of its suffix: ``.py``, a module for NumPy with ``rhs`` and ``jacobian`` for ``solve_ivp``;
        ``.m``, a function for ``ode45`` and Simulink; ``.c``, functions in C99; ``.fmu``, a unit for co-simulation.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    StructureError
        If a coefficient has no value, or there is no mass.
    OutputError
        If the suffix is another one, the name of the file is not one that its language takes, or the file cannot be written.

    Examples
    --------
    >>> import linkwise as lw
    >>> from linkwise.export import export_equations
    >>> from pathlib import Path
    >>> from runpy import run_path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     module = run_path(str(export_equations(lw.bnes_chain(2), f"{folder}/chain.py")))
    >>> module["STATES"], module["INPUTS"]
    (['x:m1', 'x:m2', 'v:m1', 'v:m2'], ['force:m1', 'force:m2'])
    >>> module["rhs"](0.0, [0.001, 0.0, 0.0, 0.0], [2.0, 0.0]).tolist()
    [0.0, 0.0, -27.901, -9.9]
    """
    return written(answer, path, EQUATIONS, "equations", EquationsOfMotion)
