"""What the tree looks like in numbers, and which of its own limits it breaks: `python scripts/measure_code.py`.

Reads the source of the package with `ast`; runs none of it. Exits with 1 where a limit is broken. `--more` lists the
places behind the counts that have no limit of their own.
"""

import ast
import io
import pathlib
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator

PACKAGE = pathlib.Path(__file__).parents[1] / "agile_jax"
LONGEST_FUNCTION, LONGEST_FILE, MOST_MODULES, MOST_ANY = 60, 300, 14, 100

Function = ast.FunctionDef | ast.AsyncFunctionDef
Import = tuple[str, bool]  # the imported module, and whether it is loaded with the importing one


def functions(tree: ast.AST) -> Iterator[Function]:
    """Every function and method of a module."""
    return (node for node in ast.walk(tree) if isinstance(node, Function))


def length(function: Function) -> int:
    """Lines of a function without its docstring."""
    lines = (function.end_lineno or 0) - function.lineno + 1
    if ast.get_docstring(function) is not None:
        first = function.body[0]
        lines -= (first.end_lineno or 0) - first.lineno + 1
    return lines


def code_lines(text: str) -> int:
    """Lines with code: no blank lines, comments or docstrings."""
    skipped = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in skipped:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):  # docstrings, those of attributes too
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines -= set(range(node.lineno, (node.end_lineno or 0) + 1))
    return len(lines)


def module_name(path: pathlib.Path) -> str:
    """The dotted name of a file of the package."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(tree: ast.Module, modules: set[str]) -> set[str]:
    """The modules of the package that a module's text imports anywhere but for the type checker."""
    typing_only = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
        for inner in ast.walk(node)
    }
    found = set()
    for node in ast.walk(tree):
        if id(node) in typing_only:
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            submodules = {f"{node.module}.{alias.name}" for alias in node.names} & modules
            found |= submodules or {node.module}
    return found & modules


def cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """The strongly connected components with more than one module (Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in graph[name]:
            if other not in index:
                visit(other)
                low[name] = min(low[name], low[other])
            elif other in stack:
                low[name] = min(low[name], index[other])
        if low[name] == index[name]:
            component = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(component) > 1:
                found.append(sorted(component))

    for name in graph:
        if name not in index:
            visit(name)
    return found


def main() -> int:
    """Print the table; 1 where a limit is broken."""
    texts = {path: path.read_text() for path in sorted(PACKAGE.rglob("*.py"))}
    trees = {path: ast.parse(text) for path, text in texts.items()}
    names = {module_name(path): path for path in texts}
    graph = {name: imports(trees[path], set(names)) - {name} for name, path in names.items()}
    inside = PACKAGE.parent

    long_functions = sorted(
        (length(f), f"{path.relative_to(inside)}:{f.lineno} {f.name}") for path in trees for f in functions(trees[path])
    )
    folders = Counter(path.parent for path in texts)
    any_places = {path: len(re.findall(r"\bAny\b", text)) for path, text in texts.items()}
    inner_imports = [
        f"{path.relative_to(inside)}:{node.lineno}"
        for path, tree in trees.items()
        for function in functions(tree)
        for node in ast.walk(function)
        if isinstance(node, ast.Import | ast.ImportFrom)
    ]
    lines = {path: code_lines(text) for path, text in texts.items()}
    product = {path: n for path, n in lines.items() if path.relative_to(PACKAGE).parts[0] != "benchmark"}

    limits = [
        (
            f"functions over {LONGEST_FUNCTION} lines",
            [f"{n} {name}" for n, name in long_functions if n > LONGEST_FUNCTION],
        ),
        (
            f"files over {LONGEST_FILE} lines",
            [f"{n} {p.relative_to(inside)}" for p, t in texts.items() if (n := len(t.splitlines())) > LONGEST_FILE],
        ),
        (
            f"folders with more than {MOST_MODULES} modules",
            [f"{n} {folder.relative_to(inside)}" for folder, n in folders.items() if n > MOST_MODULES],
        ),
        ("import cycles", [" <-> ".join(component) for component in cycles(graph)]),
    ]
    broken = sum(len(found) for _, found in limits)
    for what, found in limits:
        print(f"{what}: {len(found)}")
        print("".join(f"    {line}\n" for line in found), end="")
    total_any = sum(any_places.values())
    print(f"`Any`: {total_any} (limit {MOST_ANY})")
    print(f"imports inside functions: {len(inner_imports)}")
    print(f"modules: {len(texts)}; functions: {len(long_functions)}, the longest {long_functions[-1][0]} lines")
    print(f"lines of code: {sum(lines.values())}, without benchmark/ {sum(product.values())}")
    if "--more" in sys.argv:
        print("\n".join(f"{n:4} Any {path.relative_to(inside)}" for path, n in any_places.items() if n))
        print("\n".join(inner_imports))
    return int(broken > 0 or total_any >= MOST_ANY)


if __name__ == "__main__":
    sys.exit(main())
