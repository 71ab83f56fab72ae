"""The language model client against a stub server on this machine, and the two prompts."""

import json
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime

import pytest
from pydantic import ValidationError

from hoi.errors import AssetError, ConfigError
from hoi.priors.client import LanguageModel, LanguageModelError, MissingRecording
from hoi.priors.config import ClientConfig
from hoi.priors.interview import Interview, ask_contacts, ask_size
from hoi.priors.prompts import (
    CLOZES,
    NamedPair,
    contact_prompt,
    contact_schema,
    json_contact_prompt,
    parse_contacts,
    parse_length,
    read_json_contacts,
    read_json_size,
    size_prompt,
)
from hoi.priors.recordings import Answer, Question, Recordings, model_folder
from llm_stub import Stub

QUESTION = Question(api="completions", model="m", prompt="Length of a chair:", stop=("\n",))
SECRET = "sk-do-not-write-me-down"


@pytest.fixture
def stub():
    server = Stub()
    yield server
    server.close()


@pytest.fixture
def waits():
    return []


def model_at(url: str, folder, waits: list, **settings) -> LanguageModel:
    config = ClientConfig(**({"base_url": url, "model": "m", "mode": "record"} | settings))
    return LanguageModel(config, folder, sleep=waits.append)


def test_an_answer_is_asked_once_and_then_replayed_without_a_server(stub, tmp_path, waits):
    assert model_at(stub.url, tmp_path, waits).ask(QUESTION) == " 0.85m"
    assert model_at(stub.url, tmp_path, waits).ask(QUESTION) == " 0.85m"
    offline = model_at("http://127.0.0.1:9/v1", tmp_path, waits, mode="replay")
    assert offline.ask(QUESTION) == " 0.85m"
    assert len(stub.requests) == 1


def test_refresh_asks_again_and_equal_answers_give_equal_bytes(stub, tmp_path, waits):
    model_at(stub.url, tmp_path, waits).ask(QUESTION)
    before = Recordings(tmp_path).path(QUESTION).read_bytes()
    model_at(stub.url, tmp_path, waits, mode="refresh").ask(QUESTION)
    assert len(stub.requests) == 2
    assert Recordings(tmp_path).path(QUESTION).read_bytes() == before
    assert b"/home/me" not in before


def test_a_missing_recording_says_what_to_do(tmp_path, waits):
    with pytest.raises(MissingRecording, match="mode: record"):
        model_at("http://127.0.0.1:9/v1", tmp_path, waits, mode="replay").ask(QUESTION)


def test_a_busy_server_is_asked_again_after_the_time_it_names(stub, tmp_path, waits):
    stub.script = [(429, {"Retry-After": "3"}, "slow down"), (500, {}, "oops")]
    assert model_at(stub.url, tmp_path, waits).ask(QUESTION) == " 0.85m"
    assert len(stub.requests) == 3
    assert waits[0] == 3.0 and 0 < waits[1] <= 2.0


def test_a_retry_after_that_is_no_number_or_absurd_does_not_stop_the_run(stub, tmp_path, waits):
    soon = format_datetime(datetime.now(UTC) + timedelta(seconds=30), usegmt=True)
    stub.script = [(503, {"Retry-After": "soon"}, "x"), (503, {"Retry-After": "99999"}, "x"),
                   (503, {"Retry-After": "nan"}, "x"), (503, {"Retry-After": soon}, "x"),
                   (503, {"Retry-After": "Wed, 21 Oct 2020 07:28:00 GMT"}, "x")]  # fmt: skip
    model_at(stub.url, tmp_path, waits).ask(QUESTION)
    assert 0 < waits[0] <= 1.0 and waits[1] == 60.0 and 0 < waits[2] <= 4.0
    assert 20 < waits[3] <= 30 and waits[4] == 0


def test_a_server_that_is_too_slow_is_asked_again_and_then_given_up(stub, tmp_path, waits):
    stub.answering.clear()
    with pytest.raises(LanguageModelError, match=r"2 tries.*Timeout"):
        model_at(stub.url, tmp_path, waits, timeout_seconds=0.1, retries=1).ask(QUESTION)
    assert len(stub.requests) == 2 and not list(tmp_path.rglob("*.json"))


def test_the_rate_is_kept_for_retries_too(stub, tmp_path):
    now = [100.0]

    def sleep(seconds):
        now[0] += seconds

    config = ClientConfig(base_url=stub.url, model="m", mode="record", min_interval_seconds=7)
    model = LanguageModel(config, tmp_path, sleep=sleep, clock=lambda: now[0])
    stub.script = [(429, {"Retry-After": "1"}, "slow down")]
    model.ask(QUESTION)
    assert now[0] == pytest.approx(107.0)
    model.ask(QUESTION, sample=1)
    assert now[0] == pytest.approx(114.0)
    model.ask(QUESTION, sample=1)  # recorded: no request, no waiting
    assert now[0] == pytest.approx(114.0) and len(stub.requests) == 3


def test_a_refused_request_is_not_repeated(stub, tmp_path, waits):
    stub.script = [(400, {}, "bad model")]
    with pytest.raises(LanguageModelError, match="HTTP 400: bad model"):
        model_at(stub.url, tmp_path, waits).ask(QUESTION)
    assert len(stub.requests) == 1 and not list(tmp_path.rglob("*.json"))


def test_a_server_that_never_answers_is_given_up(tmp_path, waits):
    with pytest.raises(LanguageModelError, match="3 tries"):
        model_at("http://127.0.0.1:9/v1", tmp_path, waits, retries=2).ask(QUESTION)
    assert len(waits) == 2


@pytest.mark.parametrize(
    "reply",
    ["RAW<html>", "RAW[1]", 'RAW{"choices": []}', 'RAW{"text": "0.85m"}',
     'RAW{"choices": [{"text": null}]}'],
)  # fmt: skip
def test_a_reply_in_another_format_is_an_error_and_not_recorded(stub, tmp_path, waits, reply):
    stub.script = [(200, {}, reply)]
    with pytest.raises(LanguageModelError):
        model_at(stub.url, tmp_path, waits).ask(QUESTION)
    assert not list(tmp_path.rglob("*.json"))


def test_the_key_is_sent_and_written_nowhere(stub, tmp_path, waits, monkeypatch):
    monkeypatch.setenv("HOI_LLM_API_KEY", SECRET)
    stub.script = [(500, {}, "no"), (200, {}, " 0.85m"), (401, {}, f"wrong key {SECRET}")]
    model = model_at(stub.url, tmp_path, waits)
    model.ask(QUESTION)
    with pytest.raises(LanguageModelError, match="wrong key") as error:
        model.ask(QUESTION, sample=1)
    assert stub.headers[0]["Authorization"] == f"Bearer {SECRET}"
    recorded = "".join(path.read_text() for path in tmp_path.rglob("*") if path.is_file())
    for text in (recorded, str(error.value), repr(model.config), QUESTION.key()):
        assert SECRET not in text


def test_without_a_key_no_authorization_is_sent(stub, tmp_path, waits, monkeypatch):
    monkeypatch.delenv("HOI_LLM_API_KEY", raising=False)
    model_at(stub.url, tmp_path, waits).ask(QUESTION)
    assert "Authorization" not in stub.headers[0]


def test_a_recording_is_named_by_what_can_change_the_answer():
    changes = [{"prompt": "x"}, {"model": "n"}, {"temperature": 0.5}, {"stop": ()},
               {"json_schema": "{}"}, {"system": "s"}, {"max_tokens": 1}]  # fmt: skip
    keys = {QUESTION.key(), *(QUESTION.model_copy(update=change).key() for change in changes)}
    assert len(keys) == 1 + len(changes)
    assert QUESTION.model_copy(update={"template": "size"}).key() == QUESTION.key()


def test_a_damaged_recording_is_named(tmp_path):
    recordings = Recordings(tmp_path)
    recordings.put(QUESTION, Answer(answer="1m"))
    whole = recordings.path(QUESTION).read_text()
    for damaged in ("{", "[]", "{}", whole.replace('"answers"', '"replies"')):
        recordings.path(QUESTION).write_text(damaged)
        with pytest.raises(AssetError, match=QUESTION.key()):
            recordings.get(QUESTION)


def test_a_recording_whose_question_was_edited_is_refused(tmp_path):
    recordings = Recordings(tmp_path)
    recordings.put(QUESTION, Answer(answer="1m"))
    path = recordings.path(QUESTION)
    path.write_text(path.read_text().replace("chair", "stool"))
    with pytest.raises(AssetError, match="edited"):
        recordings.get(QUESTION)


def test_samples_and_second_tries_lie_in_one_file_in_order_however_they_came(tmp_path):
    one, other = Recordings(tmp_path / "one"), Recordings(tmp_path / "other")
    told = [(0, False), (1, False), (1, True), (2, False), (10, False)]
    for sample, again in told:
        one.put(QUESTION, Answer(answer=f"{sample} {again}"), sample, again)
    for sample, again in reversed(told):
        other.put(QUESTION, Answer(answer=f"{sample} {again}"), sample, again)
    assert one.path(QUESTION).read_bytes() == other.path(QUESTION).read_bytes()
    assert list(one.answers(QUESTION)) == ["0", "1", "1 again", "2", "10"]
    assert [path.name for path in tmp_path.rglob("*.json")] == [f"{QUESTION.key()}.json"] * 2
    assert [q for q, _ in one.of_model("m")] == [QUESTION] and not list(one.of_model("n"))


def test_a_recording_holds_no_address_and_no_time(stub, tmp_path, waits):
    model_at(stub.url, tmp_path, waits).ask(QUESTION)
    record = json.loads(Recordings(tmp_path).path(QUESTION).read_text())
    assert record == {
        "question": {"api": "completions", "model": "m", "prompt": "Length of a chair:",
                     "stop": ["\n"]},
        "answers": {"0": {"answer": " 0.85m", "finish_reason": "stop", "served_model": "m.gguf"}},
    }  # fmt: skip


def test_a_model_has_a_folder_that_any_file_system_takes():
    assert model_folder("Qwen/Qwen3:8b") == "qwen-qwen3-8b"
    assert model_folder("../..") == "unnamed" and model_folder("gpt-3.5") == "gpt-3.5"


@pytest.mark.parametrize(
    "url", ["https://me:secret@host/v1", "http://host/v1?key=secret", "ftp://host", "host/v1"]
)
def test_an_address_that_holds_a_secret_or_is_none_is_refused(url):
    with pytest.raises(ValidationError):
        ClientConfig(base_url=url)


def test_a_model_must_be_named(tmp_path):
    with pytest.raises(ConfigError, match="model"):
        LanguageModel(ClientConfig(), tmp_path)


def test_a_chat_model_gets_the_same_prompt_as_a_message(stub, tmp_path, waits):
    model = model_at(stub.url, tmp_path, waits, api="chat")
    assert ask_size(model, "chair") == 0.85
    path, body = stub.requests[0]
    assert path == "/v1/chat/completions"
    assert [message["role"] for message in body["messages"]] == ["system", "user"]
    assert body["messages"][1]["content"] == size_prompt("chair")


# ----------------------------------------------------------------------------- the prompts


def test_the_prompts_are_the_papers():
    assert size_prompt("chair") == (
        "This is an object length estimator.\n"
        "Length of a bike: 1.75m\n"
        "Height of a woman: 1.63m\n"
        "Length of a chair:"
    )
    prompt = contact_prompt("chair", "stand on")
    assert prompt.startswith(
        "This is a body-object contact generator.\n\nAction: ride\nObject: bike"
    )
    assert "Contacts: handlebar/hands, seat/butt, \n          paddle/foot\n" in prompt
    assert prompt.endswith("\n\nAction: stand on\nObject: chair\nContacts:")
    assert "ACTION" not in prompt and "OBJECT" not in prompt


@pytest.mark.parametrize("wording", CLOZES)
def test_every_wording_asks_about_this_object_and_action(wording):
    assert size_prompt("stool", wording).count("stool") == 1
    prompt = contact_prompt("stool", "stand next to", wording)
    assert prompt.count("stool") == 1 and prompt.count("stand next to") == 1
    for text in (size_prompt("stool", wording), prompt):
        assert "OBJECT" not in text and "ACTION" not in text and text == text.rstrip()


def test_a_malformed_answer_is_asked_for_once_more_and_both_are_recorded(stub, tmp_path, waits):
    stub.script = [(200, {}, " dunno"), (200, {}, " 0.9m")]
    model = model_at(stub.url, tmp_path, waits)
    assert ask_size(model, "chair") == 0.9
    first, second = (body for _, body in stub.requests)
    assert first["temperature"] == 0 and second["temperature"] > 0
    assert first["seed"] != second["seed"] and first["prompt"] == second["prompt"]
    offline = model_at("http://127.0.0.1:9/v1", tmp_path, waits, mode="replay")
    assert ask_size(offline, "chair") == 0.9 and len(stub.requests) == 2


def test_what_is_malformed_twice_is_shown_as_rejected(stub, tmp_path, waits):
    stub.script = [(200, {}, text) for text in (" seat and butt", " it depends", " seat/butt")]
    replies = Interview(model_at(stub.url, tmp_path, waits, samples=2)).contacts("chair", "sit")
    assert [said.pairs[0].object_part for said in replies.said] == ["seat"]
    (rejected,) = replies.rejected
    assert (rejected.template, rejected.sample) == ("contacts/paper", 0)
    assert rejected.answer == " it depends" and "it depends" in rejected.reason
    assert len(stub.requests) == 3


def test_no_readable_answer_at_all_is_an_error_that_says_why(stub, tmp_path, waits):
    stub.answer = lambda body: "as large as life"
    with pytest.raises(ValueError, match=r"size of 'chair'.*no length"):
        ask_size(model_at(stub.url, tmp_path, waits), "chair")


def test_refresh_asks_once_a_run_and_replaces_what_was_recorded(stub, tmp_path, waits):
    assert ask_size(model_at(stub.url, tmp_path, waits), "chair") == 0.85
    stub.answer = lambda body: " 0.7m"
    again = model_at(stub.url, tmp_path, waits, mode="refresh")
    assert ask_size(again, "chair") == 0.7 and ask_size(again, "chair") == 0.7
    assert len(stub.requests) == 2
    assert ask_size(model_at(stub.url, tmp_path, waits, mode="replay"), "chair") == 0.7


# ------------------------------------------------------------------------- the JSON prompts

PARTS = ("chair_seat", "chair_back")
SAID = {
    "contacts": [
        {"object_part": "chair_seat", "body_part": "butt", "side": "none"},
        {"object_part": "chair_back", "body_part": "hand", "side": "left"},
    ],
    "relation": "below",
    "facing": "same",
}


def test_the_schema_lists_the_labels_and_the_prompt_names_them():
    pair = contact_schema(PARTS)["properties"]["contacts"]["items"]
    assert pair["properties"]["object_part"]["enum"] == list(PARTS)
    assert "hand" in pair["properties"]["body_part"]["enum"]
    assert pair["additionalProperties"] is False and len(pair["required"]) == 3
    prompt = json_contact_prompt("chair", "sit", PARTS)
    assert "chair_seat, chair_back" in prompt and "forearm" in prompt
    assert not any(word in prompt for word in ("OBJECT", "ACTION", "PARTS"))


def test_a_json_question_sends_the_schema_and_its_answer_is_read(stub, tmp_path, waits):
    stub.answer = lambda body: json.dumps(SAID)
    model = model_at(stub.url, tmp_path, waits, api="chat")
    (said,) = Interview(model, "json").contacts("chair", "sit").said
    assert [(p.object_part, p.body_part, p.side) for p in said.pairs] == [
        ("chair_seat", "butt", ""), ("chair_back", "hand", "left")]  # fmt: skip
    assert (said.relation, said.facing) == ("below", "same")
    path, body = stub.requests[0]
    sent = body["response_format"]["json_schema"]
    assert path == "/v1/chat/completions" and sent["strict"] is True
    assert "chair_arm" in json.dumps(sent["schema"])


def test_a_server_that_knows_no_schemas_is_asked_without_them_from_then_on(stub, tmp_path, waits):
    stub.answer = lambda body: f"```json\n{json.dumps(SAID)}\n```"
    stub.script = [(400, {}, "response_format is not supported")]
    model = model_at(stub.url, tmp_path, waits, api="chat")
    for action in ("sit", "rest"):
        assert len(Interview(model, "json").contacts("chair", action).said) == 1
    assert ["response_format" in body for _, body in stub.requests] == [True, False, False]


def test_a_400_for_another_reason_is_not_taken_for_a_missing_schema(stub, tmp_path, waits):
    stub.script = [(400, {}, "no such model"), (400, {}, "no such model")]
    with pytest.raises(LanguageModelError, match="no such model"):
        Interview(model_at(stub.url, tmp_path, waits, api="chat"), "json").contacts("chair", "sit")


def test_a_json_prompt_needs_a_chat_server(tmp_path, waits):
    with pytest.raises(ConfigError, match="api: chat"):
        Interview(model_at("http://127.0.0.1:9/v1", tmp_path, waits), "json").size("chair")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"contacts": "none"}, "not a list"),
        ({"contacts": [{"object_part": "chair_seat"}]}, "not a contact"),
        ({"contacts": [SAID["contacts"][0] | {"object_part": "wing"}]}, "object_part: 'wing'"),
        ({"contacts": [SAID["contacts"][0] | {"body_part": "tail"}]}, "body_part: 'tail'"),
        ({"contacts": [SAID["contacts"][0] | {"side": "up"}]}, "side: 'up'"),
        ({"relation": "inside"}, "relation: 'inside'"),
        ({"mood": "good"}, "expected the keys"),
    ],
)
def test_an_answer_of_another_schema_is_refused_by_name(change, reason):
    with pytest.raises(ValueError, match=reason):
        read_json_contacts(json.dumps(SAID | change), PARTS)


@pytest.mark.parametrize("text", ["", "{", "[]", '"chair"', '{"contacts": []}'])
def test_an_answer_that_is_not_the_json_object_is_refused(text):
    with pytest.raises(ValueError):
        read_json_contacts(text, PARTS)


def test_no_contact_can_be_said_by_schema():
    said = read_json_contacts(json.dumps(SAID | {"contacts": []}), PARTS)
    assert said.pairs == () and said.relation == "below"


def test_ranges_of_size_are_read_and_checked():
    extent = {"low": 0.7, "typical": 0.9, "high": 1.1}
    size = {"height": extent, "width": extent, "depth": extent, "longest": 0.95}
    said = read_json_size(json.dumps(size))
    assert said.length == 0.95 and dict(said.extents)["height"] == (0.7, 0.9, 1.1)
    flat = {"low": 0.008, "typical": 0.012, "high": 0.02}  # scissors, as a model described them
    assert dict(read_json_size(json.dumps(size | {"height": flat})).extents)["height"][0] == 0.008
    for wrong, reason in [
        ({"height": {"low": 2, "typical": 1, "high": 3}}, "not in order"),
        ({"height": {"low": 1, "high": 3}}, "low, typical, high"),
        ({"width": 0.5}, "low, typical, high"),
        ({"longest": "1 m"}, "not a number"),
        ({"longest": True}, "not a number"),
        ({"longest": 85}, "no plausible size"),
        ({"longest": 0.008}, "no plausible size"),
    ]:
        with pytest.raises(ValueError, match=reason):
            read_json_size(json.dumps(size | wrong))


# ----------------------------------------------------------------------- the second prompt


def test_words_outside_the_alias_table_go_to_the_second_prompt_once(stub, tmp_path, waits):
    asked = {"upholstery": " chair_seat", "cat": " none", "posterior": " butt", "soul": " 42"}

    def answer(body):
        words = body["prompt"].rpartition("Part: ")[2].split("\n")[0]
        return asked[words]

    stub.answer = answer
    interview = Interview(model_at(stub.url, tmp_path, waits, temperature=0.8), map_by_model=True)

    def labels(*pair):
        return tuple(interview.label("chair", NamedPair(*pair)))

    assert labels("upholstery", "left hand") == ("chair_seat", "hand", "left")
    assert labels("seat", "posterior") == ("chair_seat", "butt", "")
    assert labels("cat", "hands") == ("", "hand", "")
    assert labels("seat", "soul") == ("chair_seat", "", "")  # asked twice, unreadable twice
    assert labels("upholstery", "palms") == ("chair_seat", "hand", "")
    assert len(stub.requests) == 5
    first = stub.requests[0][1]
    assert first["temperature"] == 0 and "chair_seat, chair_back" in first["prompt"]
    offline = Interview(model_at("http://127.0.0.1:9", tmp_path, waits, mode="replay",
                                 temperature=0.8), map_by_model=True)  # fmt: skip
    assert offline.label("chair", NamedPair("upholstery", "hand")).object_part == "chair_seat"


def test_without_the_second_prompt_unknown_words_stay_unlabelled(tmp_path, waits):
    interview = Interview(model_at("http://127.0.0.1:9", tmp_path, waits))
    assert interview.label("chair", NamedPair("upholstery", "soul")).parts == ("", "")


def test_the_share_of_answers_is_the_probability(stub, tmp_path, waits):
    stub.script = [(200, {}, " seat/butt, back/back"), (200, {}, " seat/butt"),
                   (200, {}, " Seat/Butt"), (200, {}, " none")]  # fmt: skip
    model = model_at(stub.url, tmp_path, waits, samples=4, temperature=0.8)
    assert ask_contacts(model, "chair", "sit") == {("seat", "butt"): 0.75, ("back", "back"): 0.25}
    assert [body["seed"] for _, body in stub.requests] == [0, 1, 2, 3]


def test_the_size_is_the_median_answer(stub, tmp_path, waits):
    stub.script = [(200, {}, " 0.9m"), (200, {}, " 80 cm"), (200, {}, " 2 m")]
    assert ask_size(model_at(stub.url, tmp_path, waits, samples=3), "chair") == 0.9


@pytest.mark.parametrize(
    ("answer", "metres"),
    [(" 0.85m", 0.85), ("85 cm", 0.85), ("0.8 - 1.0 m", 0.9), ("about 2 feet.", 0.6096), ("1", 1)],
)
def test_lengths_are_read_in_any_unit(answer, metres):
    assert parse_length(answer) == pytest.approx(metres)


@pytest.mark.parametrize("answer", ["", "it depends", "1800 m", "0.001 m", "3 parsecs"])
def test_what_is_no_plausible_length_is_refused(answer):
    with pytest.raises(ValueError):
        parse_length(answer)


def test_contacts_are_read_and_malformed_ones_refused():
    assert parse_contacts(" seat/butt, back/back.\n\nAction: x") == [
        ("seat", "butt"),
        ("back", "back"),
    ]
    assert parse_contacts("none") == []
    for answer in ("seat and butt", "seat/", "a/b/c", "", "  \n", "seat/" + 50 * "x"):
        with pytest.raises(ValueError):
            parse_contacts(answer)
