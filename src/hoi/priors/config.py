"""Every setting of the prior stage, and of asking a language model for priors."""

from typing import Literal
from urllib.parse import urlsplit

from pydantic import Field, field_validator, model_validator

from hoi.settings import Settings


class LookupConfig(Settings):
    """How answers become the prior of a frame [paper 3.3]."""

    answers: Literal["all", "paper"] = Field(
        default="all",
        description="paper: only what the paper prints; all: also the reviewed answers that fill "
        "its gaps. Every row of the tables says which it is",
    )
    size_axis: Literal["reviewed", "longest"] = Field(
        default="reviewed",
        description="the extent that a size measures. longest: always the longest side, as the "
        "prompt's word 'length' says; reviewed: what the number really is (0.85 m is the "
        "height of a chair)",
    )
    min_probability: float = Field(
        default=0.0, ge=0, le=1, description="contacts less probable than this are left out"
    )
    max_hypotheses: int = Field(
        default=3, ge=1, description="most interactions handed on for methods that try several"
    )
    min_hypothesis: float = Field(
        default=0.05, ge=0, le=1, description="a less probable interaction is not tried"
    )
    alternatives: Literal["none", "recorded", "answers"] = Field(
        default="recorded",
        description="other contact sets of the same action. none: the paper's single list; "
        "recorded: those of the tables; answers: the distinct answers of a simulated vote "
        "(`votes`, for the study of wrong answers)",
    )
    max_alternatives: int = Field(
        default=3, ge=1, description="at most so many sets, the most probable ones"
    )
    corrupt: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="for studies: share of the contact pairs that are replaced by wrong ones, "
        "drawn anew for every frame. [4.1] people judged 29 % of GPT-3's to be wrong",
    )
    votes: int = Field(
        default=1,
        ge=1,
        description="for studies: so many answers are drawn, each with its own wrong pairs, and "
        "every pair is weighted by the share of answers that name it, relative to the largest",
    )
    min_share: float = Field(
        default=0.4,
        ge=0,
        le=1,
        description="for studies: pairs that a smaller share of the `votes` names are left out. "
        "[4.1] fewer than 4 of 10: incorrect",
    )

    @property
    def studies_answers(self) -> bool:
        """Whether answers are made worse on purpose."""
        return self.corrupt > 0 or self.votes > 1


class ClientConfig(Settings):
    """How new answers are asked of an OpenAI-compatible server. Never used by the default run."""

    base_url: str = Field(
        default="http://127.0.0.1:11434/v1", description="server; the default is a local Ollama"
    )
    model: str = Field(default="", description="model name as the server knows it")
    api: Literal["completions", "chat"] = Field(
        default="completions", description="completions takes the paper's cloze prompts as they are"
    )
    api_key_variable: str = Field(
        default="HOI_LLM_API_KEY",
        description="environment variable that holds the key, if one is needed",
    )
    mode: Literal["replay", "record", "refresh"] = Field(
        default="replay",
        description="replay: recorded answers only, no network; record: ask for what is missing; "
        "refresh: ask again for everything",
    )
    temperature: float = Field(default=0.0, ge=0, description="sampling temperature")
    max_tokens: int = Field(default=64, ge=1, description="longest answer of a cloze prompt")
    max_tokens_json: int = Field(default=512, ge=1, description="longest answer of a JSON prompt")
    samples: int = Field(
        default=1, ge=1, description="answers per question; their share is a probability"
    )
    timeout_seconds: float = Field(default=120.0, gt=0, description="per request")
    retries: int = Field(default=5, ge=0, description="after busy, server and connection errors")
    min_interval_seconds: float = Field(
        default=0.0, ge=0, description="rate limit: at least so long between two requests"
    )

    @field_validator("base_url")
    @classmethod
    def _is_an_address_without_secrets(cls, url: str) -> str:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError(f"{parts.scheme or 'this'} is no http(s) address")
        if parts.username or parts.password or parts.query:
            raise ValueError("holds a user, password or query; the key comes from the environment")
        return url


#: How a server is reached: no part of any answer.
REACHING = frozenset(
    {"base_url", "api_key_variable", "mode", "timeout_seconds", "retries", "min_interval_seconds"}
)


class LanguageModelConfig(ClientConfig):
    """Which model's answers the priors are made of, when `priors.source` is llm."""

    prompt: Literal["paper", "question", "list", "json"] = Field(
        default="paper",
        description="paper: its two cloze prompts verbatim; question, list: the same asked in "
        "other words; json: a chat model answers by a schema whose words are the labels, and also "
        "says ranges of size, no contact, and where the object is",
    )
    recordings: str = Field(
        default="src/hoi/data/priors/recordings", description="folder of the recorded answers"
    )
    map_parts: Literal["aliases", "model"] = Field(
        default="model",
        description="part names that the alias table does not know. model: ask the model, by the "
        "second prompt; aliases: report them as unmapped",
    )
    gaps: Literal["stop", "recorded", "none"] = Field(
        default="stop",
        description="questions without a recorded or readable answer. stop: an unrecorded one "
        "stops the run, an unreadable one is none; recorded: the tables of the package answer, and "
        "the row says so; none: the frame ends as no_contact_prior or no_size_prior",
    )


class PriorsConfig(LookupConfig):
    """Where the priors come from, and how they are looked up."""

    source: Literal["recorded", "llm"] = Field(
        default="recorded",
        description="recorded: the reviewed tables of the package; llm: what the language model "
        "under `llm` answered, replayed from its recordings",
    )
    llm: LanguageModelConfig = LanguageModelConfig()

    @model_validator(mode="after")
    def _names_a_model(self):
        if self.source == "llm" and not self.llm.model:
            raise ValueError("llm.model: source is llm, so the model must be named")
        return self


class StudyConfig(Settings):
    """How answers are judged [paper 4.1]; results/priors.csv."""

    judges: tuple[LanguageModelConfig, ...] = Field(
        default=(), description="models whose recorded answers are compared"
    )
    ratings: tuple[str, ...] = Field(
        default=(), description="csv files of human ratings, see docs/priors.md"
    )
    correct_above: float = Field(
        default=0.6, ge=0, le=1, description="[4.1] correct: more than 6 of 10 votes"
    )
    incorrect_below: float = Field(
        default=0.4, ge=0, le=1, description="[4.1] incorrect: fewer than 4 of 10 votes"
    )
    size_tolerance: float = Field(
        default=0.25,
        gt=0,
        description="an answered size votes for a size that it differs from by at most this share",
    )
