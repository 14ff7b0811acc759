#!/usr/bin/env bash
# Write requirements.lock: exact versions of everything that setup, tests and checks use.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
pip="$folder/venv/bin/python -m pip --disable-pip-version-check"
$pip install -qq torch==2.13.0 # the CPU build; a looser range pulls gigabytes of CUDA
$pip install -qq -r requirements-dev.in ".[sim,render,mcap,train,view,serve,export]"
{
  echo "# Written by scripts/lock.sh (Python 3.11); do not edit."
  $pip freeze --exclude doughdata | sed -e 's/+cpu$//'
} > requirements.lock
