#!/usr/bin/env bash
# Install the pinned torch, without several GB of CUDA libraries where there is no GPU.
#   install_torch.sh <venv>/bin [index url of PyTorch's CPU wheels]
set -eu
bin=$1
index=${2:-}
version=$(sed -n 's/^torch==//p' requirements.lock)
"$bin/python" -m pip show -q "torch" 2>/dev/null &&
    [ "$("$bin/python" -c 'import importlib.metadata as m; print(m.version("torch").split("+")[0])')" = "$version" ] &&
    exit 0
if [ -n "$index" ]; then
    exec "$bin/python" -m pip install --quiet --index-url "$index" "torch==$version"
fi
if ! command -v nvidia-smi >/dev/null; then
    # ask, without installing anything, whether this index would bring CUDA along
    plan=$("$bin/python" -m pip install --dry-run --quiet --report - "torch==$version" 2>/dev/null || true)
    if printf %s "$plan" | grep -qE '"name": "(nvidia|cuda)-'; then
        echo "== Note: your package index offers torch only with CUDA (several GB), and no GPU is here."
        echo "==       To get the small CPU build, stop now and run make with"
        echo "==       TORCH_INDEX=<the CPU index that PyTorch's 'Get started' page names>."
    fi
fi
exec "$bin/python" -m pip install --quiet "torch==$version"
