"""Every setting of the prior stage."""

from typing import Literal

from pydantic import Field

from hoi.settings import Settings


class PriorsConfig(Settings):
    """Which recorded answers are used, and how [paper 3.3]."""

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
    max_tokens: int = Field(default=64, ge=1, description="longest answer")
    samples: int = Field(
        default=1, ge=1, description="answers per question; their share is a probability"
    )
    timeout_seconds: float = Field(default=120.0, gt=0, description="per request")
    retries: int = Field(default=5, ge=0, description="after busy, server and connection errors")
