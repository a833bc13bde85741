"""The mutants: those of `hand.yaml`, and those that a library's operators make, drawn by a seed."""

import ast
import hashlib
import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
HAND = Path(__file__).with_name("hand.yaml")
NEEDS_ARGUMENTS = {"VariableInserter", "VariableReplacer"}
"""Operators of cosmic-ray that change nothing until they are told a variable."""


@dataclass(frozen=True)
class Mutant:
    """One module with one change."""

    name: str
    group: str
    kind: str
    """`hand` or `random`."""
    file: str
    """The module, from the repository's root."""
    source: str
    """The module's text with the change."""
    tests: tuple[str, ...]
    """What could tell: files or tests, cheap ones first."""
    change: str
    reason: str = ""
    """Why it is let live, where it is."""

    @property
    def key(self) -> str:
        """A hash of what was changed to what: a result holds for this text only."""
        return hashlib.sha256(f"{self.name}\0{self.source}".encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Group:
    """Modules that one kind of number rests on."""

    name: str
    tests: dict[str, tuple[str, ...]]
    """By module."""
    mutations: list[dict[str, Any]]


def groups() -> list[Group]:
    """Read `hand.yaml`."""
    content = yaml.safe_load(HAND.read_text())
    return [
        Group(
            name,
            {file: tuple(tests) for file, tests in group["modules"].items()},
            group["mutations"],
        )
        for name, group in content.items()
    ]


def by_hand(group: Group) -> Iterator[Mutant]:
    """Yield a group's mutants in the order of the list.

    Raises:
        ValueError: the text to change does not stand exactly once in its module.
    """
    for entry in group.mutations:
        source = (ROOT / entry["file"]).read_text()
        found = source.count(entry["old"])
        if found != 1:
            raise ValueError(f"{entry['name']}: its text stands {found} times in {entry['file']}")
        yield Mutant(
            entry["name"],
            group.name,
            "hand",
            entry["file"],
            source.replace(entry["old"], entry["new"]),
            group.tests[entry["file"]],
            entry["why"],
            entry.get("survives", ""),
        )


def at_random(group: Group, count: int, seed: int) -> list[Mutant]:
    """Draw places of a group's modules without replacement, and one mutation of each.

    A place is a token that an operator can change. Drawing places first keeps operators with many
    replacements (`+` has ten) from crowding out the others.
    """
    rng = random.Random(f"{seed}/{group.name}")
    places = [(file, *place) for file in sorted(group.tests) for place in _places(file)]
    rng.shuffle(places)
    drawn: list[Mutant] = []
    for file, (line, column), choices in places:
        if len(drawn) == count:
            break
        operator, occurrence = rng.choice(choices)
        source = (ROOT / file).read_text()
        mutated = _mutate(source, operator, occurrence)
        if mutated is None or _behaviour(mutated) in (None, _behaviour(source)):
            continue
        name = f"{file}:{line}:{column} {operator}"
        change = mutated.splitlines()[line - 1].strip()
        drawn.append(Mutant(name, group.name, "random", file, mutated, group.tests[file], change))
    return drawn


def _places(file: str) -> list[tuple[tuple[int, int], list[tuple[str, int]]]]:
    """Return each (line, column) that can change, with the (operator, occurrence) that do it."""
    from cosmic_ray.ast import get_ast

    tree = get_ast((ROOT / file).read_text())
    places: dict[tuple[int, int], list[tuple[str, int]]] = {}
    for name, operator in _operators():
        positions = (start for node in _nodes(tree) for start, *_ in _positions(operator, node))
        for occurrence, start in enumerate(positions):
            places.setdefault(start, []).append((name, occurrence))
    return sorted(places.items())


def _positions(operator: Any, node: Any) -> list[Any]:
    return list(operator.mutation_positions(node))


def _nodes(node: Any) -> Iterator[Any]:
    """Walk a tree in the order in which cosmic-ray counts occurrences."""
    yield node
    for child in getattr(node, "children", ()):
        yield from _nodes(child)


def _operators() -> Iterator[tuple[str, Any]]:
    from cosmic_ray.operators.provider import OperatorProvider

    provider: Any = OperatorProvider()
    for name in sorted(provider):
        if name not in NEEDS_ARGUMENTS:
            yield name, provider[name]()


def _mutate(source: str, operator: str, occurrence: int) -> str | None:
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.operators.provider import OperatorProvider

    provider: Any = OperatorProvider()
    return mutate_code(source, provider[operator](), occurrence)


def _behaviour(source: str) -> str | None:
    """Return the program without its annotations; None where it is none."""
    try:
        tree = ast.parse(source)
    except SyntaxError:
        return None
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            node.returns = None
        elif isinstance(node, ast.arg):
            node.annotation = None
        elif isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(None)
    return ast.dump(tree)
