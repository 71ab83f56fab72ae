"""What a code digest notices, and what it must not notice."""

import os
import sys
import textwrap

import pytest

from hoi import digest


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package `hoi` of its own: stage -> helper, and an unrelated module."""
    root = tmp_path / "hoi"
    root.mkdir()
    (root / "__init__.py").write_text("")
    (root / "stage.py").write_text("from hoi.helper import K\ndef run():\n    return K\n")
    (root / "helper.py").write_text("K = 1\n")
    (root / "other.py").write_text("X = 1\n")
    for name in [name for name in sys.modules if name == "hoi" or name.startswith("hoi.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(tmp_path))

    def read():
        digest.code_digest.cache_clear()
        return digest.code_digest("hoi.stage")

    yield root, read
    digest.code_digest.cache_clear()


def test_a_constant_two_imports_away_counts(package):
    root, read = package
    before = read()
    (root / "helper.py").write_text("K = 2\n")
    assert read() != before


def test_comments_docstrings_and_touches_do_not_count(package):
    root, read = package
    before = read()
    (root / "helper.py").write_text('"""What K is."""\n\n# why one\nK = 1  # one\n')
    os.utime(root / "stage.py", (1, 1))
    assert read() == before


def test_modules_that_are_not_imported_do_not_count(package):
    root, read = package
    before = read()
    (root / "other.py").write_text("X = 2\n")
    assert read() == before


def test_imports_inside_functions_and_relative_imports_count(package):
    root, read = package
    (root / "stage.py").write_text(
        textwrap.dedent("""
        def run():
            from . import lazy
            return lazy.K
        """)
    )
    (root / "lazy.py").write_text("K = 1\n")
    before = read()
    (root / "lazy.py").write_text("K = 3\n")
    assert read() != before


def test_names_inside_modules_are_told_from_modules_without_running_any(package):
    """For `from hoi.helper import K` it has to know whether `hoi.helper.K` is a module."""
    root, read = package
    (root / "helper.py").write_text("raise RuntimeError('imported')\nK = 1\n")
    (root / "deep").mkdir()
    (root / "deep" / "__init__.py").write_text("from hoi.helper import K\n")
    (root / "deep" / "inner.py").write_text("X = 1\n")
    (root / "stage.py").write_text("from hoi.deep.inner import X\n")
    before = read()
    (root / "deep" / "inner.py").write_text("X = 2\n")
    assert read() != before
    assert not {"hoi", "hoi.helper", "hoi.deep"} & set(sys.modules)


def test_a_script_counts_by_content_wherever_the_checkout_lies(package, tmp_path):
    root, _ = package
    first, second = tmp_path / "here" / "run.py", tmp_path / "there" / "run.py"
    for path in (first, second):
        path.parent.mkdir()
        path.write_text("from hoi.helper import K\n")
    assert digest.code_digest(str(first)) == digest.code_digest(str(second))
    before = digest.code_digest(str(first))
    (root / "helper.py").write_text("K = 5\n")
    digest.code_digest.cache_clear()
    assert digest.code_digest(str(first)) != before


def test_settings_swapped_between_names_differ():
    assert digest.json_digest({"a": 1, "b": 2}) != digest.json_digest({"a": 2, "b": 1})
    assert digest.json_digest({"a": 1, "b": 2}) == digest.json_digest({"b": 2, "a": 1})


def test_files_are_known_by_content_not_by_place_or_time(tmp_path):
    first, second = tmp_path / "x" / "data.bin", tmp_path / "y" / "data.bin"
    for path in (first, second):
        path.parent.mkdir()
        path.write_bytes(b"same")
    os.utime(second, (1, 1))
    assert digest.files_digest([first]) == digest.files_digest([second])
