"""What of a package says in words what it assumes."""

import ast
from pathlib import Path


def assuming(package):
    """Return the functions and classes whose docstrings say what they assume."""
    found = set()
    for file in sorted(Path(package.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            kinds = (ast.FunctionDef, ast.ClassDef)
            if isinstance(node, kinds) and "Assumes:" in (ast.get_docstring(node) or ""):
                found.add(node.name)
    return found
