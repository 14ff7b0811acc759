#!/usr/bin/env bash
# The tests of the pages look at them in Chromium. Install it when it is missing and we are root, else say how.
set -eu
for name in chromium chromium-browser google-chrome; do
  command -v "$name" >/dev/null && exit 0
done
line="apt-get update && apt-get install -y --no-install-recommends chromium"
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  echo "installing chromium"
  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium >/dev/null
else
  echo "the tests of doughdata need chromium; type: sudo sh -c '$line'" >&2
  exit 1
fi
