#!/usr/bin/env bash
# Peers for the tests in tests/lab that nobody here wrote; as root, on Debian. Tests whose peer is missing
# skip, and say so.
set -euo pipefail

PACKAGES=(
    # Modbus: a command-line client, and a C library for peers in both roles
    mbpoll libmodbus-dev gcc libc6-dev
    # V4L2: Debian's kernel in a virtual machine (tests/lab/vm)
    qemu-system-x86 mmdebstrap busybox-static kmod cpio e2fsprogs
    # GigE Vision: the library, what its Python side is built with, networks and a filter that loses packets
    gir1.2-aravis-0.8 libgirepository1.0-dev libcairo2-dev pkg-config gcc iproute2 nftables
)

apt-get update -qq
DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${PACKAGES[@]}"

# the extra `gige`, into the environment the tests run in
cd "$(dirname "$0")/../.."
if [ -x .venv/bin/python ]; then
    .venv/bin/python -m pip --disable-pip-version-check install --quiet -r requirements/gige.txt
    # a camera that sends packets again (tests/lab/test_gige_resend.py)
    .venv/bin/python -m pip --disable-pip-version-check install --quiet --no-deps viva-genicam==0.10.0
fi
