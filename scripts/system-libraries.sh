#!/usr/bin/env bash
# Open3D needs libusb-1.0, OpenMP, GL and X11 libraries that a bare Debian lacks. Install them when root, else say how.
set -eu
declare -A package=([libusb-1.0.so.0]=libusb-1.0-0 [libgomp.so.1]=libgomp1 [libGL.so.1]=libgl1 [libEGL.so.1]=libegl1 [libX11.so.6]=libx11-6)
missing=()
for library in "${!package[@]}"; do
  ldconfig -p 2>/dev/null | grep -q "$library" || missing+=("${package[$library]}")
done
[ ${#missing[@]} -eq 0 ] && exit 0
line="apt-get update && apt-get install -y --no-install-recommends ${missing[*]}"
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  echo "installing ${missing[*]}"
  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
else
  echo "doughdata needs ${missing[*]}; type: sudo sh -c '$line'" >&2
  exit 1
fi
