"""The modules of the four packages and what each imports, read from their code.

A module that is *used* runs its functions, so their lazy imports count; one that is merely
*loaded*, as a package is on the way to its modules, runs no more than its top level.
"""

import ast
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from tests.conftest import ROOT

FOLDERS = {
    "racines_data": ROOT / "racines_data",
    "racines_models": ROOT / "models/racines_models",
    "racines_envs": ROOT / "envs/racines_envs",
    "racines_leaderboard": ROOT / "leaderboard/racines_leaderboard",
}


@cache
def modules() -> dict[str, Path]:
    """Return every module's file by its name."""
    found = {}
    for package, folder in FOLDERS.items():
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            found[".".join((package, *parts)).removesuffix(".__init__")] = path
    return found


def parents(module: str) -> list[str]:
    """Return the packages that a module lies in, outermost first."""
    parts = module.split(".")
    return [".".join(parts[:count]) for count in range(1, len(parts))]


@cache
def imports(module: str, lazy: bool = True) -> frozenset[str]:
    """Return our modules that one imports by name; `lazy`: inside functions as well."""
    tree = ast.parse(modules()[module].read_text())
    found = {name for node in _statements(tree, lazy) for name in _imported(node)}
    return frozenset(found - {module})


def _statements(tree: ast.AST, lazy: bool) -> Iterator[ast.AST]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        if not lazy and isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        yield node
        yield from _statements(node, lazy)


def _imported(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names if alias.name in modules())
    elif isinstance(node, ast.ImportFrom) and node.module in modules():
        for alias in node.names:
            name = f"{node.module}.{alias.name}"
            yield name if name in modules() else _home(node.module, alias.name)


def _home(package: str, name: str) -> str:
    """Return the module that a package takes a name from, itself if it says nothing."""
    stub = modules()[package].with_name("__init__.pyi")
    if modules()[package].name == "__init__.py" and stub.is_file():
        for node in ast.parse(stub.read_text()).body:
            if isinstance(node, ast.ImportFrom) and name in {each.name for each in node.names}:
                return f"{package}.{node.module}"
    return package


def closure(starts: Iterable[str]) -> set[str]:
    """Return all modules whose code runs where those given are used, themselves included."""
    used: set[str] = set()
    loaded: set[str] = set()
    todo = [(module, True) for module in starts]
    while todo:
        module, uses = todo.pop()
        seen = used if uses else loaded
        if module in seen:
            continue
        seen.add(module)
        todo.extend((name, uses) for name in imports(module, lazy=uses))
        todo.extend((package, False) for package in parents(module))
    return used | loaded


def circles() -> list[set[str]]:
    """Return the groups of modules that import one another, lazily or not."""
    import networkx

    graph = networkx.DiGraph()
    for module in modules():
        graph.add_edges_from((module, name) for name in imports(module))
    return [group for group in networkx.strongly_connected_components(graph) if len(group) > 1]


def says_only_what_it_offers(path: Path) -> bool:
    """Return whether a package's file holds no more than its text and lazily loaded names."""
    if path.name != "__init__.py":
        return False
    body = ast.parse(path.read_text(encoding="utf-8")).body
    allowed = ("lazy_loader", "renamed.install", "from racines_data import renamed")
    return all(
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        or any(text in ast.unparse(node) for text in allowed)
        for node in body
    )
