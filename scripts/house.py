"""Measure the structure of the package: ``python scripts/house.py [FOLDER ...]`` prints a table.

Several folders stand side by side as columns (for example an older checkout beside this one).
"""

from __future__ import annotations

import ast
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BRANCHES = (ast.If, ast.For, ast.While, ast.Try, ast.IfExp, ast.BoolOp, ast.comprehension)
MOST_LINES, MOST_PARAMETERS, MOST_FILE_LINES, MOST_FILES = 50, 6, 800, 20
SAME_LINES = 6
"""So many equal lines one after the other, in two places, count as said twice."""


@dataclass
class Figures:
    """What one package looks like."""

    files: int = 0
    all_lines: int = 0
    """With docstrings, comments and blank lines; ``lines`` are those of code."""
    lines: int = 0
    classes: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    """The files that define a class or an alias of that name."""
    class_count: int = 0
    tunables: int = 0
    rooms: Counter[str] = field(default_factory=Counter)
    """Files by folder."""
    type_circles: list[list[str]] = field(default_factory=list)
    """Circles of imports if those for types (``TYPE_CHECKING``) and packages count, too."""
    long_files: int = 0
    functions: int = 0
    long_functions: int = 0
    wide_functions: int = 0
    branches: int = 0
    constants: int = 0
    files_with_constants: int = 0
    circles: list[list[str]] = field(default_factory=list)
    said_twice: int = 0
    imports: dict[str, set[str]] = field(default_factory=dict)

    @property
    def shared_names(self) -> list[str]:
        """Names of classes that two files or more define."""
        return sorted(name for name, files in self.classes.items() if len(files) > 1)

    @property
    def big_rooms(self) -> list[str]:
        """Folders with more than ``MOST_FILES`` files."""
        return sorted(room for room, files in self.rooms.items() if files > MOST_FILES)

    def values(self) -> dict[str, float]:
        """Return the figures that ``scripts/figures.py`` keeps."""
        return {
            "lines": self.all_lines,
            "files": self.files,
            "classes": self.class_count,
            "class names in two files or more": len(self.shared_names),
            "import circles, type imports counted": len(self.type_circles),
            f"rooms with more than {MOST_FILES} files": len(self.big_rooms),
            "tunables": self.tunables,
            "branches per 100 lines of code": round(100 * self.branches / max(1, self.lines), 1),
        }

    def rows(self) -> Iterator[tuple[str, str]]:
        """Yield each figure's name and value."""
        yield from ((name, f"{value:g}") for name, value in self.values().items())
        yield "lines of code", str(self.lines)
        yield f"files over {MOST_FILE_LINES} lines", str(self.long_files)
        yield "functions", str(self.functions)
        yield f"functions over {MOST_LINES} lines", str(self.long_functions)
        yield f"functions with over {MOST_PARAMETERS} parameters", str(self.wide_functions)
        yield "numeric module constants", f"{self.constants} in {self.files_with_constants} files"
        yield "import circles, without imports for types", str(len(self.circles))
        yield f"places that share {SAME_LINES} lines with another", str(self.said_twice)


def is_number(node: ast.expr | None) -> bool:
    """Return whether an expression is a number (or arithmetic of numbers)."""
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return is_number(node.left) and is_number(node.right)
    return (
        isinstance(node, ast.Constant)
        and isinstance(node.value, (int, float))
        and not isinstance(node.value, bool)
    )


def code_lines(nodes: list[ast.AST], source: str) -> list[str]:
    """Return the lines that are code: no blank lines, comments or docstrings."""
    said: set[int] = set()
    for node in nodes:
        if not isinstance(node, ast.Expr) or not isinstance(node.value, ast.Constant):
            continue
        if isinstance(node.value.value, str):
            said.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines = enumerate(source.splitlines(), start=1)
    bare = [(n, line.strip()) for n, line in lines if n not in said]
    return [line for _, line in bare if line and not line.startswith("#")]


def tunables(node: ast.ClassDef) -> int:
    """Return how many numbers a class holds that ``tunable`` makes."""
    parts = (n.value for n in node.body if isinstance(n, ast.AnnAssign) and n.value is not None)
    return sum(ast.unparse(value).startswith("tunable(") for value in parts)


def measure_file(figures: Figures, nodes: list[ast.AST], source: str, file: Path) -> list[str]:
    """Add one file to the figures; return its lines of code. ``nodes`` are those of its tree, the
    module first.
    """
    code = code_lines(nodes, source)
    figures.files += 1
    figures.all_lines += len(source.splitlines())
    figures.rooms[str(file.parent)] += 1
    figures.lines += len(code)
    figures.long_files += len(source.splitlines()) > MOST_FILE_LINES
    for node in nodes:
        figures.branches += isinstance(node, BRANCHES)
        if isinstance(node, ast.ClassDef):
            figures.class_count += 1
            figures.classes[node.name].add(str(file))
            figures.tunables += tunables(node)
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            asked = node.args
            names = [*asked.posonlyargs, *asked.args, *asked.kwonlyargs]
            count = len([a for a in names if a.arg not in ("self", "cls")])
            figures.functions += 1
            figures.wide_functions += count > MOST_PARAMETERS
            figures.long_functions += (node.end_lineno or 0) - node.lineno + 1 > MOST_LINES
    body = getattr(nodes[0], "body", [])
    values = [n.value for n in body if isinstance(n, (ast.Assign, ast.AnnAssign))]
    constants = sum(is_number(v) for v in values)
    figures.constants += constants
    figures.files_with_constants += constants > 0
    return code


def imported(nodes: list[ast.AST], known: set[str], types: bool = False) -> set[str]:
    """Return the modules among ``known`` that a module imports, anywhere in it; those that it
    imports for types only if asked for.
    """
    left_out: set[ast.AST] = set()
    for node in nodes:
        if not types and isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            left_out.update(ast.walk(node))
    found = set()
    for node in nodes:
        if node in left_out:
            continue
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                found.add(whole if whole in known else node.module)
        elif isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
    return found & known


def circles(imports: dict[str, set[str]]) -> list[list[str]]:
    """Return the strongly connected groups of two modules or more (Tarjan, 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(module: str) -> None:
        index[module] = low[module] = len(index)
        stack.append(module)
        for other in sorted(imports[module]):
            if other not in index:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in stack:
                low[module] = min(low[module], index[other])
        if low[module] == index[module]:
            group = [stack.pop()]
            while group[-1] != module:
                group.append(stack.pop())
            if len(group) > 1:
                found.append(sorted(group))

    for module in sorted(imports):
        if module not in index:
            visit(module)
    return found


def one_import_each(code: list[str]) -> list[str]:
    """Return lines of code with each import in one line."""
    found: list[str] = []
    for line in code:
        if found and found[-1].startswith("from ") and found[-1].endswith(("(", ",")):
            found[-1] += line
        else:
            found.append(line)
    return found


def repeated(files: list[list[str]]) -> int:
    """Return how many stretches of lines stand somewhere else, too (imports do not count)."""
    seen: dict[tuple[str, ...], list[tuple[int, int]]] = {}
    for number, lines in enumerate(files):
        code = one_import_each(lines)
        for at in range(len(code) - SAME_LINES + 1):
            piece = tuple(code[at : at + SAME_LINES])
            if not any(line.startswith(("import ", "from ")) for line in piece):
                seen.setdefault(piece, []).append((number, at))
    places = {place for where in seen.values() if len(where) > 1 for place in where}
    return sum((number, at - 1) not in places for number, at in places)


def measure(folder: Path) -> Figures:
    """Return the figures of the package below a checkout's folder."""
    figures = Figures()
    sources = sorted((folder / "up_samp").rglob("*.py"))
    trees = {}
    codes = []
    for path in sources:
        source = path.read_text(encoding="utf-8")
        name = ".".join(path.relative_to(folder).with_suffix("").parts)
        nodes = list(ast.walk(ast.parse(source)))
        trees[name.removesuffix(".__init__")] = nodes
        codes.append(measure_file(figures, nodes, source, path.relative_to(folder)))
    plain = {n for n in trees if not (folder / n.replace(".", "/")).is_dir()}
    figures.imports = {n: imported(t, plain) - {n} for n, t in trees.items() if n in plain}
    figures.circles = circles(figures.imports)
    whole = {n: imported(t, set(trees), types=True) - {n} for n, t in trees.items()}
    figures.type_circles = circles(whole)
    figures.said_twice = repeated(codes)
    return figures


def main() -> int:
    """Print the table."""
    folders = [Path(a) for a in sys.argv[1:]] or [ROOT]
    columns = [dict(measure(folder).rows()) for folder in folders]
    for name in columns[0]:
        print("|", name, "|", " | ".join(c[name] for c in columns), "|")
    return 0


if __name__ == "__main__":
    sys.exit(main())
