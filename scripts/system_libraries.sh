#!/usr/bin/env bash
# open3d loads these shared libraries when it is imported. Install what is missing where we may,
# and otherwise say exactly which command does.
set -u
needed=(libusb-1.0.so.0:libusb-1.0-0 libgomp.so.1:libgomp1 libGL.so.1:libgl1 libEGL.so.1:libegl1
        libX11.so.6:libx11-6 libudev.so.1:libudev1)
packages=()
for pair in "${needed[@]}"; do
    library=${pair%%:*}
    ldconfig -p 2>/dev/null | grep -q "$library" || packages+=("${pair##*:}")
done
[ ${#packages[@]} -eq 0 ] && exit 0
command="apt-get update && apt-get install -y ${packages[*]}"
if command -v apt-get >/dev/null && [ "$(id -u)" = 0 ]; then
    echo "== Installing the system libraries that open3d loads: ${packages[*]}"
    apt-get update -qq && apt-get install -y -qq "${packages[@]}" >/dev/null && exit 0
    echo "That did not work. Please install them yourself, then run make again:" >&2
else
    echo "open3d needs system libraries that are not here. Please run, then make again:" >&2
fi
echo "    sudo sh -c '$command'" >&2
exit 1
