"""The loop every stage shares: memo, statuses, determinism."""

import pytest

from hoi.artifacts import Action, Detection
from hoi.chunks import Index, artifact_path, frame_seed, read_artifacts, run_chunk, write_chunk
from hoi.errors import ArtifactError, FrameFailure
from hoi.memo import Memo

FRAMES = ["a", "b", "c"]


@pytest.fixture
def chunk(tmp_path):
    """Three frames as a first stage wrote them, and a counter of stage calls."""
    memo = Memo(tmp_path / "memo")

    def write(contents=("one", "two", "three")):
        texts = dict(zip(FRAMES, contents, strict=True))

        def compute(frame_id):
            return Action(frame_id=frame_id, action=texts[frame_id], distance=1.0)

        keys = {frame_id: f"{frame_id}-{text}" for frame_id, text in texts.items()}
        return write_chunk(
            "source", Action, FRAMES, compute, keys, tmp_path / "in.json", tmp_path / "in.s", memo
        )

    write()
    calls = []

    def run(stage=None, identity="v1", seed=0, results="out", views=None):
        def make():
            def call(action, seed):
                calls.append(action.frame_id)
                return Action(frame_id=action.frame_id, action=action.action[0], distance=2.0)

            return stage or call

        return run_chunk(
            "stage",
            Action,
            make,
            {"action": (Action, tmp_path / "in.json")},
            tmp_path / results / "chunk.json",
            tmp_path / results / "chunk.seconds.json",
            memo,
            {"code": identity},
            seed,
            views,
        )

    return tmp_path, write, run, calls


def test_a_second_run_calls_nothing_even_after_results_are_deleted(chunk):
    path, _, run, calls = chunk
    first = run()
    assert calls == FRAMES
    again = run(results="elsewhere")
    assert calls == FRAMES and again == first
    assert artifact_path(path / "elsewhere" / "chunk.json", "a").exists()


def test_only_the_changed_frame_is_computed_again(chunk):
    _, write, run, calls = chunk
    run()
    write(("one", "changed", "three"))
    calls.clear()
    run()
    assert calls == ["b"]


def test_byte_identical_inputs_stop_the_chain(chunk):
    _, write, run, calls = chunk
    before = run()
    write(("other", "two", "three"))  # the stage keeps the first letter only
    calls.clear()
    after = run()
    assert calls == ["a"] and after == before


def test_a_frame_is_computed_again_when_what_the_stage_reads_of_it_changes(chunk):
    _, write, run, calls = chunk
    views = {"action": lambda action: action.model_copy(update={"action": action.action[:2]})}
    before = run(views=views)
    calls.clear()
    write(("once", "two", "ton"))
    after = run(views=views)
    assert calls == ["c"] and after == before

    def tell(action, seed):
        return Action(frame_id=action.frame_id, action=action.action, distance=2.0)

    told = run(stage=tell, identity="v2", views=views, results="told")
    assert set(told.frames) == set(FRAMES)
    path = chunk[0] / "told" / "chunk.json"
    assert [a.action for a in read_artifacts(Action, path)] == ["on", "tw", "to"]


@pytest.mark.parametrize("change", [{"identity": "v2"}, {"seed": 1}])
def test_new_code_settings_or_seed_compute_everything_again(chunk, change):
    _, _, run, calls = chunk
    run()
    calls.clear()
    run(**change)
    assert calls == FRAMES


def test_a_damaged_memo_entry_is_computed_again(chunk):
    path, _, run, calls = chunk
    run()
    calls.clear()
    payload = next(p for p in (path / "memo" / "payloads").rglob("*") if p.is_file())
    payload.write_bytes(b"damaged")
    run()
    assert len(calls) <= 1
    assert [a.status for a in read_artifacts(Action, path / "out" / "chunk.json")] == ["ok"] * 3


def test_a_failing_frame_becomes_a_status_and_the_others_go_on(chunk):
    path, _, run, _ = chunk

    def stage(action, seed):
        if action.frame_id == "b":
            raise FrameFailure("no_object_detected", "no chair above 0.2")
        return action

    index = run(stage)
    assert [entry.status for entry in index.frames.values()] == ["ok", "no_object_detected", "ok"]
    failed = Action.load(artifact_path(path / "out" / "chunk.json", "b"))
    assert (failed.failed_stage, failed.detail) == ("stage", "no chair above 0.2")


def test_a_frame_that_failed_upstream_keeps_its_first_cause(chunk):
    path, _, run, _ = chunk

    def fail(action, seed):
        raise FrameFailure("no_person_detected", "nobody there")

    run(fail)
    run_chunk(
        "later",
        Detection,
        lambda: pytest.fail("the stage must not be loaded"),
        {"action": (Action, path / "out" / "chunk.json")},
        path / "later" / "chunk.json",
        path / "later" / "chunk.s",
        Memo(path / "memo"),
        {},
        0,
    )
    later = Detection.load(artifact_path(path / "later" / "chunk.json", "a"))
    assert (later.status, later.failed_stage) == ("no_person_detected", "stage")


def test_a_bug_is_loud_and_names_the_frame(chunk):
    _, _, run, _ = chunk

    def stage(action, seed):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError) as caught:
        run(stage)
    assert "stage stage, frame a" in caught.value.__notes__[0]


def test_seeds_differ_by_frame_and_stage_only():
    assert frame_seed(0, "a", "joint") == frame_seed(0, "a", "joint")
    assert len({frame_seed(0, f, s) for f in "ab" for s in ("joint", "detect")}) == 4


def test_a_missing_artifact_is_named(chunk):
    path, *_ = chunk
    artifact_path(path / "in.json", "a").unlink()
    with pytest.raises(ArtifactError, match=r"a\.npz"):
        list(read_artifacts(Action, path / "in.json"))


def test_a_damaged_index_is_named(tmp_path):
    (tmp_path / "chunk.json").write_text("{")
    with pytest.raises(ArtifactError, match=r"chunk\.json"):
        Index.load(tmp_path / "chunk.json")
