"""The ``hoi`` command."""

import importlib

import pytest

from hoi.cli import COMMANDS, main


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_subcommand_prints_its_help(name, capsys):
    with pytest.raises(SystemExit) as stop:
        main([name, "--help"])
    assert stop.value.code == 0
    assert f"usage: hoi {name}" in capsys.readouterr().out


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_subcommand_has_a_module_with_a_docstring(name):
    assert f"hoi {name}" in (importlib.import_module(COMMANDS[name][0]).__doc__ or "")


def test_an_unknown_subcommand_names_the_known_ones(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["fly"])
    assert stop.value.code == 2
    assert "show" in capsys.readouterr().err


def test_an_unreadable_table_is_named(tmp_path, capsys):
    assert main(["show", str(tmp_path / "none.csv")]) == 1
    assert "none.csv" in capsys.readouterr().err


def test_a_rating_sheet_is_written_once_and_never_over_another(tmp_path, capsys):
    sheet = tmp_path / "sheet.csv"
    assert main(["rating-sheet", str(sheet)]) == 0
    assert "contact,chair,sit,chair seat,butt,,," in sheet.read_text()
    assert "prior_study.ratings" in capsys.readouterr().out
    sheet.write_text("half filled")
    assert main(["rating-sheet", str(sheet)]) == 1
    assert "exists" in capsys.readouterr().err and sheet.read_text() == "half filled"
