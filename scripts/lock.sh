#!/usr/bin/env bash
# Write requirements.lock: exact versions of everything that setup, tests and checks use.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
pip="$folder/venv/bin/python -m pip --disable-pip-version-check"
$pip install -qq torch==2.13.0 # the CPU build; a looser range pulls gigabytes of CUDA
# pip's own resolver looks for minutes for a botocore that suits both s3fs and moto.
$pip install -qq uv
"$folder/venv/bin/uv" pip install -q --python "$folder/venv" -r requirements-dev.in ".[all]"
{
  echo "# Written by scripts/lock.sh (Python 3.11); do not edit."
  $pip freeze --exclude doughdata --exclude uv | sed -e 's/+cpu$//'
} > requirements.lock
