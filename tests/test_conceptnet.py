"""ConceptNet's dump -> action space: one pass, constant memory, damaged lines, the command."""

import gzip
import json
import tracemalloc

import numpy as np
import pytest

from hoi.actions import conceptnet
from hoi.actions.conceptnet import (
    ReadCount,
    _verb,
    person_verbs,
    read_dump,
    verbs_of,
    write_action_space,
)
from hoi.actions.space import DEFAULT_ACTION_SPACE, load_action_space
from hoi.cli import main
from hoi.errors import AssetError


def line(relation, start, end, weight=1.0, **changes):
    """One line as ConceptNet 5.7 writes it."""
    described = {
        "dataset": "/d/conceptnet/4/en",
        "license": "cc:by/4.0",
        "sources": [{"contributor": "/s/contributor/omcs/x"}],
        "weight": weight,
    } | changes
    uri = f"/a/[/r/{relation}/,{start}/,{end}/]"
    return f"{uri}\t/r/{relation}\t{start}\t{end}\t{json.dumps(described)}\n"


def write_dump(path, lines):
    with gzip.open(path, "wt", encoding="utf-8") as stream:
        stream.writelines(lines)
    return path


def edges(path, **changes):
    count = ReadCount()
    found = list(read_dump(path, ["chair", "tennis racket"], count, **changes))
    return found, count


def test_only_english_edges_of_wanted_nouns_and_relations_are_kept(tmp_path):
    path = write_dump(
        tmp_path / "dump.csv.gz",
        [
            line("AtLocation", "/c/en/chair", "/c/en/kitchen"),
            line("RelatedTo", "/c/en/sit", "/c/en/chair/n", 2.0),
            line("RelatedTo", "/c/en/sofa", "/c/en/table"),
            line("UsedFor", "/c/en/chair", "/c/en/sitting_on/v", 4.5),
            line("UsedFor", "/c/en/chair/n/wn/artifact", "/c/en/resting", 1.5),
            line("UsedFor", "/c/en/chair", "/c/fr/asseoir"),
            line("UsedFor", "/c/fr/chair", "/c/en/eating"),
            line("UsedFor", "/c/en/chair", "/c/en/standing", 0.5),
            line("UsedFor", "/c/en/chairman", "/c/en/leading"),
            line("UsedFor", "/c/en/sit", "/c/en/chair"),
            line("UsedFor", "/c/en/tennis_racket", "/c/en/play_tennis"),
        ],
    )
    found, count = edges(path)
    assert [(e.noun, e.relation, e.phrase, e.weight) for e in found] == [
        ("chair", "RelatedTo", "sit", 2.0),
        ("chair", "UsedFor", "sitting on", 4.5),
        ("chair", "UsedFor", "resting", 1.5),
        ("tennis racket", "UsedFor", "play tennis", 1.0),
    ]
    assert (count.lines, count.damaged) == (11, 0)


def test_the_table_can_be_used_as_an_action_space_and_repeats_itself(tmp_path):
    path = write_dump(
        tmp_path / "dump.csv.gz",
        [
            line("RelatedTo", "/c/en/chair", "/c/en/furniture", 9.0),
            line("UsedFor", "/c/en/chair", "/c/en/sitting", 4.5),
            line("UsedFor", "/c/en/chair", "/c/en/sitting", 3.0),
            line("UsedFor", "/c/en/chair", "/c/en/resting_your_feet", 2.0),
            line("UsedFor", "/c/en/keyboard", "/c/en/write_text", 2.0),
            line("UsedFor", "/c/en/armchair", "/c/en/to_take_a_nap", 2.0),
            line("UsedFor", "/c/en/chair", "/c/en/writing_on", 1.0),
        ],
    )
    outs = [tmp_path / name for name in ("a.tsv", "b.tsv")]
    for out in outs:
        write_action_space(path, out, nouns={"armchair": "chair"})
    assert outs[0].read_bytes() == outs[1].read_bytes()
    space = load_action_space(outs[0])
    assert space.actions_of("chair") == {"sit": 4.5, "rest": 2.0, "sleep": 2.0, "write": 1.0}
    # the reviewed list knows what writing text means with a keyboard
    assert space.actions_of("keyboard") == {"type": 2.0}
    assert {edge.noun for edge in space.edges} == {"chair", "armchair", "keyboard"}


def test_damaged_lines_are_counted_and_skipped(tmp_path):
    good = line("UsedFor", "/c/en/chair", "/c/en/sitting")
    path = tmp_path / "dump.csv"
    path.write_bytes(
        good.encode()
        + b"/a/[/r/UsedFor/,/c/en/chair/,\n"
        + b"/a/[/r/UsedFor/,x\t/r/UsedFor\t/c/en/chair\t/c/en/sit\t{broken\n"
        + b"/a/[/r/UsedFor/,x\t/r/UsedFor\t/c/en/chair\t/c/en/sit\t{}\n"
        + b'/a/[/r/UsedFor/,x\t/r/UsedFor\t/c/en/chair\t/c/en/sit\xff\t{"weight": 1}\n'
        + b'/a/[/r/UsedFor/,x\t/r/UsedFor\t/c/en/chair\t/c/en/sit\t{"weight": [1]}\n'
        + good.encode().rstrip(b"\n")
    )
    found, count = edges(path)
    assert [edge.phrase for edge in found] == ["sitting", "sitting"]
    assert (count.lines, count.damaged) == (7, 4)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"a,b\n1,2\n", "line 1: begins with b'a,b'"),
        (gzip.compress(line("UsedFor", "/c/en/chair", "/c/en/sit").encode() * 99)[:-30], "damaged"),
        (b"\x1f\x8bgarbage", "damaged"),
        (b"/a/[" + b"x" * (1 << 23), "a line of over"),
        (b"", "none of its 0 lines"),
    ],
)
def test_what_is_no_dump_is_named(tmp_path, content, message):
    path = tmp_path / "dump.csv.gz"
    path.write_bytes(content)
    with pytest.raises(AssetError, match=rf"dump\.csv\.gz.*{message}"):
        write_action_space(path, tmp_path / "out.tsv")
    assert not (tmp_path / "out.tsv").exists()
    with pytest.raises(AssetError, match="no such file"):
        write_action_space(tmp_path / "nowhere", tmp_path / "out.tsv")


def test_memory_does_not_grow_with_the_dump(tmp_path, monkeypatch):
    monkeypatch.setattr(conceptnet, "_CHUNK", 1 << 16)
    some = [line("RelatedTo", f"/c/fr/wort{n}", f"/c/de/mot{n}") for n in range(400)]
    peaks = []
    for times in (3, 15):
        path = write_dump(tmp_path / f"{times}.csv.gz", some * times)
        tracemalloc.start()
        assert edges(path)[1].lines == 400 * times
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.3 * peaks[0]


def test_the_command_writes_the_table_and_says_what_to_do_with_it(tmp_path, capsys):
    path = write_dump(tmp_path / "d.csv.gz", [line("UsedFor", "/c/en/chair", "/c/en/sitting")])
    out = tmp_path / "actions.tsv"
    assert main(["conceptnet", str(path), "--out", str(out)]) == 0
    assert f"assets.action_space: {out}" in capsys.readouterr().out
    assert load_action_space(out).default_action("chair", ["sit"]) == "sit"
    assert main(["conceptnet", str(path), "--out", str(out), "--noun", "armchair"]) == 1
    assert "expected noun=category" in capsys.readouterr().err
    assert main(["conceptnet", str(tmp_path / "no"), "--out", str(out)]) == 1
    assert "no such file" in capsys.readouterr().err


def test_verbs_of_people_are_known_beyond_the_reviewed_objects():
    edges = load_action_space(DEFAULT_ACTION_SPACE).edges
    alone = person_verbs()
    same = [alone.get(_verb(edge.phrase)) == edge.action for edge in edges]
    assert np.mean(same) > 0.8  # of the phrases that were read by hand
    verbs = verbs_of()
    assert (verbs["push"], verbs["open"], verbs[_verb("riding it")]) == ("push", "open", "ride")
    assert not {"kill", "rain", "wood", "furnitur"} & set(verbs)
