"""Content digests: of code, of files and of settings. Time stamps never count.

The digest of a stage's code is taken over the syntax trees of its module and of everything it
imports inside ``hoi``, so a comment, a docstring or a touched file changes nothing, and an edited
constant two imports away changes it.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import json
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import Any

_PACKAGE = "hoi"
_NUMERIC_LIBRARIES = (
    "ai-edge-litert", "numba", "numpy", "open3d", "opencv-python-headless",
    "scikit-image", "scikit-learn", "scipy", "torch", "trimesh",
)  # fmt: skip


def text_digest(text: str) -> str:
    """sha256 of a text, as hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()


def json_digest(value: Any) -> str:
    """sha256 of plain data; the order of keys does not count, their names and values do."""
    return text_digest(json.dumps(value, sort_keys=True, separators=(",", ":"), default=str))


def file_digest(path: Path | str) -> str:
    """sha256 of a file's content."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def files_digest(paths: Iterable[Path | str]) -> dict[str, str]:
    """File name -> sha256 of content. Folders are left out, so moving a tree changes nothing."""
    return {Path(path).name: file_digest(path) for path in sorted(map(str, paths))}


@functools.cache
def code_digest(*sources: str) -> str:
    """Digest of code and of its import closure inside this package.

    Args:
        sources: names of modules, or paths of scripts (ending in ``.py``).
    """
    closure: dict[str, str] = {}
    seen: set[str] = set()
    pending = list(sources)
    while pending:
        module = pending.pop()
        if module in seen:
            continue
        seen.add(module)
        path = Path(module) if module.endswith(".py") else _source(module)
        # a script counts by its name: where the checkout lies does not matter
        name = path.name if module.endswith(".py") else module
        text = path.read_text(encoding="utf-8")
        closure[name], imported = _read_code(text, name, path.name == "__init__.py")
        pending.extend(imported)
    return json_digest(closure)


@functools.cache
def _read_code(text: str, name: str, is_package: bool) -> tuple[str, frozenset[str]]:
    """Digest of one module's syntax tree, and what it imports of this package.

    Remembered by content: the closures of a workflow's thirty scripts share most modules.
    """
    tree = ast.parse(text)
    imported = frozenset(_imports(tree, name, is_package))
    return text_digest(ast.dump(_without_docstrings(tree))), imported


@functools.cache
def environment_digest() -> str:
    """Digest of the versions of the libraries that compute the numbers."""
    return json_digest({name: _version(name) for name in _NUMERIC_LIBRARIES})


def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return "absent"


def _source(module: str) -> Path:
    """The file of a module of this package, found without importing anything.

    Python's own search runs the packages above a name, and for a name such as
    ``hoi.body.model.BodyModel`` the module itself: every plan of a workflow then imported torch.
    """
    spec = importlib.util.find_spec(_PACKAGE)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(f"no source for package {_PACKAGE}")
    *folders, name = ["", *module.split(".")[1:]]
    place = Path(spec.origin).parent.joinpath(*folders)
    for path in (place / name / "__init__.py", place / f"{name}.py"):
        if path.is_file():
            return path
    raise ModuleNotFoundError(f"no source for module {module}")


@functools.cache
def _is_module(name: str) -> bool:
    try:
        _source(name)
    except ModuleNotFoundError:
        return False
    return True


def _imports(tree: ast.AST, module: str, is_package: bool) -> set[str]:
    """Modules of this package that `tree` imports anywhere, also inside functions."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = module.split(".")
                parts = parts[: len(parts) - node.level + (1 if is_package else 0)]
                base = ".".join([*parts, base] if base else parts)
            found.add(base)
            found.update(f"{base}.{alias.name}" for alias in node.names)
    inside = {name for name in found if name == _PACKAGE or name.startswith(_PACKAGE + ".")}
    # importing a.b.c also runs the __init__ of a and of a.b
    parents = {
        ".".join(name.split(".")[:n]) for name in inside for n in range(1, name.count(".") + 1)
    }
    return {name for name in inside | parents if _is_module(name)}


class _DocstringRemover(ast.NodeTransformer):
    def _strip(self, node: Any) -> Any:
        self.generic_visit(node)
        first = node.body[0] if node.body else None
        is_text = (
            isinstance(first, ast.Expr)
            and isinstance(first.value, ast.Constant)
            and isinstance(first.value.value, str)
        )
        if is_text:
            node.body = node.body[1:] or [ast.Pass()]
        return node

    visit_Module = visit_ClassDef = visit_FunctionDef = visit_AsyncFunctionDef = _strip


def _without_docstrings(tree: ast.Module) -> ast.Module:
    return _DocstringRemover().visit(tree)
