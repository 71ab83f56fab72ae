"""Ask a language model once, and keep its answers as recordings [paper 3.3].

A thin client for OpenAI-compatible servers (hosted ones, Ollama, llama.cpp, vLLM). An answer is
stored under the hash of the question: what can change the answer is in it (model, prompt,
sampling), what cannot is not (address, key, timeouts). A run replays recordings and needs no
network; only ``record`` and ``refresh`` ask. The key comes from the environment and is written
nowhere.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import time
from collections.abc import Callable
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from hoi.errors import AssetError, ConfigError, HoiError
from hoi.priors.config import ClientConfig
from hoi.settings import Settings

if TYPE_CHECKING:
    import httpx

_RETRIED = (408, 409, 425, 429)
_LONGEST_WAIT_SECONDS = 60.0
_COMPLETE = "Continue the text. Write only the continuation of the last line."


class LanguageModelError(HoiError):
    """The server refused, or did not answer after all retries."""


class MissingRecording(HoiError):
    """A question was asked in replay mode that nobody has recorded."""


class Question(Settings):
    """Everything that can change an answer."""

    api: Literal["completions", "chat"]
    model: str
    prompt: str
    system: str = ""
    temperature: float = 0.0
    max_tokens: int = 64
    stop: tuple[str, ...] = ()
    sample: int = Field(default=0, ge=0)
    template: str = ""  # where the prompt comes from, for people

    def key(self) -> str:
        """sha256 that names the recording; the template's name does not count."""
        content = self.model_dump(mode="json", exclude={"template"})
        text = json.dumps(content, sort_keys=True, ensure_ascii=False, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


class Recordings:
    """A folder of recorded answers, one JSON file per question, without time stamps."""

    def __init__(self, folder: Path | str):
        self.folder = Path(folder)

    def path(self, question: Question) -> Path:
        """Where the answer to a question is, or would be."""
        key = question.key()
        return self.folder / key[:2] / f"{key}.json"

    def get(self, question: Question) -> str | None:
        """The recorded answer, or None; raises AssetError when the file is damaged."""
        path = self.path(question)
        try:
            answer = json.loads(path.read_text(encoding="utf-8"))["answer"]
        except FileNotFoundError:
            return None
        except (ValueError, KeyError, TypeError) as error:
            raise AssetError(f"{path}: not a recorded answer: {error}") from error
        return str(answer)

    def put(self, question: Question, answer: str, served_model: str) -> None:
        """Record an answer; equal answers give equal bytes."""
        path = self.path(question)
        path.parent.mkdir(parents=True, exist_ok=True)
        record = {
            "question": question.model_dump(mode="json"),
            "answer": answer,
            # some servers name the model by the path of its file
            "served_model": PurePath(served_model).name,
        }
        partial = path.with_suffix(f".{os.getpid()}.partial")
        text = json.dumps(record, indent=1, sort_keys=True, ensure_ascii=False)
        partial.write_text(text + "\n", encoding="utf-8")
        partial.replace(path)


class LanguageModel:
    """Answers from recordings, or from a server when the mode allows it.

    Args:
        config: server, model and mode.
        folder: where the recordings are.
        sleep: how to wait; tests pass their own.
    """

    def __init__(
        self,
        config: ClientConfig,
        folder: Path | str,
        sleep: Callable[[float], None] = time.sleep,
    ):
        if not config.model:
            raise ConfigError("priors client: `model` is empty; name the model of your server")
        self.config = config
        self.recordings = Recordings(folder)
        self._sleep = sleep
        self._http: httpx.Client | None = None

    def question(
        self, prompt: str, stop: tuple[str, ...], template: str = "", sample: int = 0
    ) -> Question:
        """A question to this model; a chat model is told to continue the cloze text."""
        return Question(
            api=self.config.api,
            model=self.config.model,
            prompt=prompt,
            system=_COMPLETE if self.config.api == "chat" else "",
            temperature=self.config.temperature,
            max_tokens=self.config.max_tokens,
            stop=stop,
            sample=sample,
            template=template,
        )

    def ask(self, question: Question) -> str:
        """The answer to a question.

        Raises:
            MissingRecording: in replay mode, when the answer was never recorded.
            LanguageModelError: the server refused or did not answer.
        """
        answer = None if self.config.mode == "refresh" else self.recordings.get(question)
        if answer is not None:
            return answer
        if self.config.mode == "replay":
            raise MissingRecording(
                f"no recorded answer of {question.model} to the prompt ending in "
                f"{question.prompt[-50:]!r} (template {question.template or 'none'}); run once "
                "with mode: record and a server at base_url"
            )
        answer, served_model = self._post(question)
        self.recordings.put(question, answer, served_model)
        return answer

    def _post(self, question: Question) -> tuple[str, str]:
        path, body = _request(question)
        reply = self._reply(path, body)
        try:
            choice = reply["choices"][0]
            text = choice["text"] if question.api == "completions" else choice["message"]["content"]
        except (KeyError, IndexError, TypeError) as error:
            raise LanguageModelError(
                f"{self.config.base_url}: the reply is not in the OpenAI format ({error!r})"
            ) from None
        return str(text), str(reply.get("model", ""))

    def _reply(self, path: str, body: dict[str, Any]) -> dict[str, Any]:
        import httpx

        url = self.config.base_url.rstrip("/") + path
        problem = ""
        for attempt in range(self.config.retries + 1):
            wait = min(_LONGEST_WAIT_SECONDS, 2.0**attempt) * random.uniform(0.5, 1.0)
            try:
                response = self._client().post(url, json=body)
            except httpx.TransportError as error:
                problem = f"{type(error).__name__}: {error}"
            else:
                if response.status_code == 200:
                    return _json(url, response.text)
                problem = f"HTTP {response.status_code}: {response.text[:200]}"
                if response.status_code not in _RETRIED and response.status_code < 500:
                    raise LanguageModelError(f"{url}: {problem}")
                wait = _retry_after(response.headers.get("retry-after", ""), wait)
            if attempt < self.config.retries:
                self._sleep(wait)
        raise LanguageModelError(
            f"{url}: no answer after {self.config.retries + 1} tries; the last: {problem}"
        )

    def _client(self) -> httpx.Client:
        import httpx

        if self._http is None:
            key = os.environ.get(self.config.api_key_variable, "")
            headers = {"Authorization": f"Bearer {key}"} if key else {}
            self._http = httpx.Client(headers=headers, timeout=self.config.timeout_seconds)
        return self._http


def _request(question: Question) -> tuple[str, dict[str, Any]]:
    """Path and body of the HTTP request."""
    body: dict[str, Any] = {
        "model": question.model,
        "temperature": question.temperature,
        "max_tokens": question.max_tokens,
        "seed": question.sample,
    }
    if question.stop:
        body["stop"] = list(question.stop)
    if question.api == "completions":
        return "/completions", {**body, "prompt": question.prompt}
    messages = [{"role": "user", "content": question.prompt}]
    if question.system:
        messages.insert(0, {"role": "system", "content": question.system})
    return "/chat/completions", {**body, "messages": messages}


def _json(url: str, text: str) -> dict[str, Any]:
    try:
        return json.loads(text)
    except ValueError:
        raise LanguageModelError(f"{url}: the reply is not JSON: {text[:200]!r}") from None


def _retry_after(header: str, otherwise: float) -> float:
    """Seconds that the server asks to wait, within reason; dates are not understood."""
    try:
        return min(max(float(header), 0.0), _LONGEST_WAIT_SECONDS)
    except ValueError:
        return otherwise
