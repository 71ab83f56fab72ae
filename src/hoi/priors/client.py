"""Ask a language model once, and keep its answers as recordings [paper 3.3].

A thin client for OpenAI-compatible servers (hosted ones, Ollama, llama.cpp, vLLM), completion and
chat style. A run replays recordings and needs no network; only ``record`` and ``refresh`` ask. The
key comes from the environment and is written nowhere.
"""

from __future__ import annotations

import json
import os
import random
import time
from collections.abc import Callable
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hoi.errors import ConfigError, HoiError
from hoi.priors.config import ClientConfig
from hoi.priors.recordings import Answer, Question, Recordings

if TYPE_CHECKING:
    import httpx

_RETRIED = (408, 409, 425, 429)
_LONGEST_WAIT_SECONDS = 60.0
_COMPLETE = "Continue the text. Write only the continuation of the last line."
_TEMPERATURE_OF_SECOND_TRY = 0.5
_SEED_OF_SECOND_TRY = 1_000_000


class LanguageModelError(HoiError):
    """The server refused, or did not answer after all retries."""


class MissingRecording(HoiError):
    """A question was asked in replay mode that nobody has recorded."""


class LanguageModel:
    """Answers from recordings, or from a server when the mode allows it.

    Args:
        config: server, model and mode.
        folder: where the recordings are.
        sleep, clock: how to wait and to tell the time in seconds; tests pass their own.
    """

    def __init__(
        self,
        config: ClientConfig,
        folder: Path | str,
        sleep: Callable[[float], None] = time.sleep,
        clock: Callable[[], float] = time.monotonic,
    ):
        if not config.model:
            raise ConfigError("priors client: `model` is empty; name the model of your server")
        self.config = config
        self.recordings = Recordings(folder)
        self._sleep, self._clock = sleep, clock
        self._http: httpx.Client | None = None
        self._last_request = -float("inf")
        self._knows_schemas = True
        self._asked: set[tuple[str, int, bool]] = set()

    def question(self, prompt: str, stop: tuple[str, ...], template: str = "") -> Question:
        """A cloze question; a chat model is told to continue the text."""
        return Question(
            api=self.config.api,
            model=self.config.model,
            prompt=prompt,
            system=_COMPLETE if self.config.api == "chat" else "",
            temperature=self.config.temperature,
            max_tokens=self.config.max_tokens,
            stop=stop,
            template=template,
        )

    def json_question(self, prompt: str, schema: dict[str, Any], template: str = "") -> Question:
        """A question whose answer is JSON of a schema; raises ConfigError for a completion API."""
        if self.config.api != "chat":
            raise ConfigError(
                f"priors client: the JSON prompt {template!r} needs `api: chat`; completions take "
                "the cloze prompts"
            )
        return Question(
            api="chat",
            model=self.config.model,
            prompt=prompt,
            temperature=self.config.temperature,
            max_tokens=self.config.max_tokens_json,
            json_schema=json.dumps(schema, sort_keys=True, separators=(",", ":")),
            template=template,
        )

    def ask(self, question: Question, sample: int = 0, again: bool = False) -> str:
        """The answer to a question.

        Args:
            sample: number of the draw; each is recorded by itself.
            again: the second answer to a sample whose first could not be read. The server gets
                another seed and some temperature, or it would repeat itself.

        Raises:
            MissingRecording: in replay mode, when the answer was never recorded.
            LanguageModelError: the server refused or did not answer.
        """
        # refreshing asks once a run, not once a use
        told = (question.key(), sample, again)
        stale = self.config.mode == "refresh" and told not in self._asked
        answer = None if stale else self.recordings.get(question, sample, again)
        if answer is None:
            if self.config.mode == "replay":
                raise MissingRecording(
                    f"no recorded answer of {question.model} to the prompt ending in "
                    f"{question.prompt[-50:]!r} (template {question.template or 'none'}, sample "
                    f"{sample}{' again' if again else ''}); run once with mode: record and a "
                    "server at base_url"
                )
            answer = self._post(question, sample, again)
            self.recordings.put(question, answer, sample, again)
            self._asked.add(told)
        return answer.answer

    def _post(self, question: Question, sample: int, again: bool) -> Answer:
        path, body = _request(question, sample, again)
        if not self._knows_schemas:
            body.pop("response_format", None)
        try:
            reply = self._reply(path, body)
        except _Refused:
            if "response_format" not in body:
                raise
            # older servers do not know JSON schemas; the prompt describes the format, too
            reply = self._reply(path, {k: v for k, v in body.items() if k != "response_format"})
            self._knows_schemas = False
        try:
            choice = reply["choices"][0]
            text = choice["text"] if question.api == "completions" else choice["message"]["content"]
            if not isinstance(text, str):
                raise TypeError(f"the answer is {type(text).__name__}, not text")
        except (KeyError, IndexError, TypeError) as error:
            raise LanguageModelError(
                f"{self.config.base_url}: the reply is not in the OpenAI format ({error!r})"
            ) from None
        return Answer(
            answer=text,
            finish_reason=str(choice.get("finish_reason") or ""),
            served_model=str(reply.get("model") or ""),
        )

    def _reply(self, path: str, body: dict[str, Any]) -> dict[str, Any]:
        import httpx

        url = self.config.base_url.rstrip("/") + path
        problem = ""
        for attempt in range(self.config.retries + 1):
            self._keep_the_rate()
            wait = min(_LONGEST_WAIT_SECONDS, 2.0**attempt) * random.uniform(0.5, 1.0)
            try:
                response = self._client().post(url, json=body)
            except httpx.TransportError as error:
                problem = f"{type(error).__name__}: {error}"
            else:
                if response.status_code == 200:
                    return _json(url, response.text)
                problem = f"HTTP {response.status_code}: {self._without_key(response.text[:200])}"
                if response.status_code not in _RETRIED and response.status_code < 500:
                    refused = _Refused if response.status_code == 400 else LanguageModelError
                    raise refused(f"{url}: {problem}")
                wait = _retry_after(response.headers.get("retry-after", ""), wait)
            if attempt < self.config.retries:
                self._sleep(wait)
        raise LanguageModelError(
            f"{url}: no answer after {self.config.retries + 1} tries; the last: {problem}"
        )

    def _keep_the_rate(self) -> None:
        early = self._last_request + self.config.min_interval_seconds - self._clock()
        if early > 0:
            self._sleep(early)
        self._last_request = self._clock()

    def _client(self) -> httpx.Client:
        import httpx

        if self._http is None:
            headers = {"Authorization": f"Bearer {self._key()}"} if self._key() else {}
            self._http = httpx.Client(headers=headers, timeout=self.config.timeout_seconds)
        return self._http

    def _key(self) -> str:
        return os.environ.get(self.config.api_key_variable, "")

    def _without_key(self, text: str) -> str:
        """Some servers repeat a wrong key in their complaint."""
        return text.replace(self._key(), "(the key)") if self._key() else text


class _Refused(LanguageModelError):
    """HTTP 400: the server does not understand the request."""


def _request(question: Question, sample: int, again: bool) -> tuple[str, dict[str, Any]]:
    """Path and body of the HTTP request."""
    temperature = question.temperature
    body: dict[str, Any] = {
        "model": question.model,
        "temperature": max(temperature, _TEMPERATURE_OF_SECOND_TRY) if again else temperature,
        "max_tokens": question.max_tokens,
        "seed": sample + _SEED_OF_SECOND_TRY * again,
    }
    if question.stop:
        body["stop"] = list(question.stop)
    if question.api == "completions":
        return "/completions", {**body, "prompt": question.prompt}
    messages = [{"role": "user", "content": question.prompt}]
    if question.system:
        messages.insert(0, {"role": "system", "content": question.system})
    if question.json_schema:
        schema = {"name": "answer", "strict": True, "schema": json.loads(question.json_schema)}
        body["response_format"] = {"type": "json_schema", "json_schema": schema}
    return "/chat/completions", {**body, "messages": messages}


def _json(url: str, text: str) -> dict[str, Any]:
    try:
        reply = json.loads(text)
        if not isinstance(reply, dict):
            raise ValueError
        return reply
    except ValueError:
        raise LanguageModelError(f"{url}: the reply is not a JSON object: {text[:200]!r}") from None


def _retry_after(header: str, otherwise: float) -> float:
    """Seconds that the server asks to wait, as a number or a date, within reason."""
    try:
        seconds = float(header)
    except ValueError:
        try:
            seconds = (parsedate_to_datetime(header) - datetime.now(UTC)).total_seconds()
        except (ValueError, TypeError):
            return otherwise
    return min(max(seconds, 0.0), _LONGEST_WAIT_SECONDS) if seconds == seconds else otherwise
