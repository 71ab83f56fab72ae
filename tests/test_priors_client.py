"""The language model client against a stub server on this machine, and the two prompts."""

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from hoi.errors import AssetError, ConfigError
from hoi.priors.client import (
    LanguageModel,
    LanguageModelError,
    MissingRecording,
    Question,
    Recordings,
)
from hoi.priors.config import ClientConfig
from hoi.priors.prompts import (
    ask_contacts,
    ask_size,
    contact_prompt,
    parse_contacts,
    parse_length,
    size_prompt,
)

QUESTION = Question(api="completions", model="m", prompt="Length of a chair:", stop=("\n",))
SECRET = "sk-do-not-write-me-down"


class Stub:
    """Answers requests from a script: (status, headers, text); afterwards " 0.85m"."""

    def __init__(self):
        self.script, self.requests, self.headers = [], [], []
        stub = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                length = int(self.headers["content-length"])
                stub.requests.append((self.path, json.loads(self.rfile.read(length))))
                stub.headers.append(dict(self.headers))
                status, headers, text = stub.script.pop(0) if stub.script else (200, {}, " 0.85m")
                if status == 200 and not text.startswith("RAW"):
                    choice = {"text": text, "message": {"content": text}}
                    text = json.dumps({"model": "/home/me/models/m.gguf", "choices": [choice]})
                body = text.removeprefix("RAW").encode()
                self.send_response(status)
                for name, value in headers.items():
                    self.send_header(name, value)
                self.send_header("content-length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format, *args):
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}/v1"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


@pytest.fixture
def stub():
    server = Stub()
    yield server
    server.server.shutdown()
    server.server.server_close()


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
    stub.script = [(503, {"Retry-After": "Wed, 21 Oct 2026 07:28:00 GMT"}, "x"),
                   (503, {"Retry-After": "99999"}, "x")]  # fmt: skip
    model_at(stub.url, tmp_path, waits).ask(QUESTION)
    assert waits[0] <= 1.0 and waits[1] == 60.0


def test_a_refused_request_is_not_repeated(stub, tmp_path, waits):
    stub.script = [(400, {}, "bad model")]
    with pytest.raises(LanguageModelError, match="HTTP 400: bad model"):
        model_at(stub.url, tmp_path, waits).ask(QUESTION)
    assert len(stub.requests) == 1 and not list(tmp_path.rglob("*.json"))


def test_a_server_that_never_answers_is_given_up(tmp_path, waits):
    with pytest.raises(LanguageModelError, match="3 tries"):
        model_at("http://127.0.0.1:9/v1", tmp_path, waits, retries=2).ask(QUESTION)
    assert len(waits) == 2


@pytest.mark.parametrize("reply", ["RAW<html>", 'RAW{"choices": []}', 'RAW{"text": "0.85m"}'])
def test_a_reply_in_another_format_is_an_error_and_not_recorded(stub, tmp_path, waits, reply):
    stub.script = [(200, {}, reply)]
    with pytest.raises(LanguageModelError):
        model_at(stub.url, tmp_path, waits).ask(QUESTION)
    assert not list(tmp_path.rglob("*.json"))


def test_the_key_is_sent_and_written_nowhere(stub, tmp_path, waits, monkeypatch):
    monkeypatch.setenv("HOI_LLM_API_KEY", SECRET)
    stub.script = [(500, {}, "no"), (200, {}, " 0.85m"), (401, {}, "wrong key")]
    model = model_at(stub.url, tmp_path, waits)
    model.ask(QUESTION)
    with pytest.raises(LanguageModelError) as error:
        model.ask(QUESTION.model_copy(update={"sample": 1}))
    assert stub.headers[0]["Authorization"] == f"Bearer {SECRET}"
    recorded = "".join(path.read_text() for path in tmp_path.rglob("*") if path.is_file())
    for text in (recorded, str(error.value), repr(model.config), QUESTION.key()):
        assert SECRET not in text


def test_without_a_key_no_authorization_is_sent(stub, tmp_path, waits, monkeypatch):
    monkeypatch.delenv("HOI_LLM_API_KEY", raising=False)
    model_at(stub.url, tmp_path, waits).ask(QUESTION)
    assert "Authorization" not in stub.headers[0]


def test_a_recording_is_named_by_what_can_change_the_answer():
    changes = [{"prompt": "x"}, {"model": "n"}, {"sample": 1}, {"temperature": 0.5}, {"stop": ()}]
    keys = {QUESTION.key(), *(QUESTION.model_copy(update=change).key() for change in changes)}
    assert len(keys) == 1 + len(changes)
    assert QUESTION.model_copy(update={"template": "size"}).key() == QUESTION.key()


def test_a_damaged_recording_is_named(tmp_path):
    recordings = Recordings(tmp_path)
    recordings.put(QUESTION, "1m", "m")
    recordings.path(QUESTION).write_text("{")
    with pytest.raises(AssetError, match=QUESTION.key()):
        recordings.get(QUESTION)


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
    for answer in ("seat and butt", "seat/", "a/b/c"):
        with pytest.raises(ValueError):
            parse_contacts(answer)
